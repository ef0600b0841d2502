"""Games with an affine pseudo-gradient."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game, GameFamily, NoBestResponseError
from ptne_env.games.variational import solve_box
from ptne_env.shared.arrays import (
    FloatArray,
    array_namespace,
    freeze,
    is_numpy,
    ordered_sum,
    product,
    require_count,
    require_non_negative,
    require_positive,
    with_games,
)
from ptne_env.shared.parts import checked


class AffineGame(Game):
    """J_i(x) = ½ x_iᵀ A_ii x_i + x_iᵀ (Σ_{j≠i} A_ij x_j + b_i), so that F(x) = A x + b.

    The base class of models with an affine pseudo-gradient. They define A and b, each as a field or a cached property,
    and may add terms to :meth:`costs` that depend on other players alone. :class:`QuadraticGame` takes A and b as they
    are. Every player has one component where a model defines no ``action_dims``.

    Raises:
        ValueError: when shapes disagree, a number is not finite, some A_ii is not symmetric, or some J_i not convex in
            x_i.
    """

    is_affine = True

    def __post_init__(self) -> None:
        super().__post_init__()
        name, n, games = type(self).__name__, self.dimension, self.offsets.shape[-1]
        if self.matrices.shape != (n, n, games) or self.offsets.shape != (n, games):
            raise ValueError(
                f"{name}: the players have {n} components, so matrix is ({n}, {n}) and offset ({n},), with a last axis "
                f"for games where there are several; got {np.shape(self.matrix)} and {np.shape(self.offset)}"
            )
        if not (np.isfinite(self.matrices).all() and np.isfinite(self.offsets).all()):
            raise ValueError(f"{name} needs finite parameters")
        scale = np.abs(self.matrices).max()
        if np.abs(self._own_blocks - self._own_blocks.transpose(1, 0, 2)).max() > 1e-12 * scale:
            raise ValueError(f"{name}: some A_ii is not symmetric, so A x + b is not the gradient of costs")
        smallest = np.linalg.eigvalsh(np.moveaxis(self._own_blocks, 2, 0)).min()
        if smallest < -1e-12 * scale:
            raise ValueError(f"{name}: some J_i is not convex in x_i, its A_ii has the eigenvalue {smallest:.3g}")

    @cached_property
    def matrix(self) -> npt.ArrayLike:
        """A, shape (n, n), or (n, n, G) for a batch; each A_ii is symmetric and positive semidefinite."""
        raise NotImplementedError(f"{type(self).__name__} defines no matrix; QuadraticGame(matrix, offset) takes any")

    @cached_property
    def offset(self) -> npt.ArrayLike:
        """The vector b, shape (n,), or (n, G) for a batch."""
        raise NotImplementedError(f"{type(self).__name__} defines no offset; QuadraticGame(matrix, offset) takes any")

    @cached_property
    def action_dims(self) -> tuple[int, ...]:
        """The dimensions n_i of the players; 1 where a model says nothing else."""
        return (1,) * len(self.offsets)

    @cached_property
    def matrices(self) -> FloatArray:
        """A of every game, shape (n, n, G), read-only."""
        return with_games(self.matrix, 2)

    @cached_property
    def offsets(self) -> FloatArray:
        """The vector b of every game, shape (n, G), read-only."""
        return with_games(self.offset, 1)

    @cached_property
    def transposed(self) -> FloatArray:
        """A with its first two axes swapped, shape (n, n, G), contiguous."""
        return freeze(self.matrices.transpose(1, 0, 2))

    @cached_property
    def _own_blocks(self) -> FloatArray:
        """A with all blocks but the A_ii set to 0."""
        same = self.owners[:, None] == self.owners
        return freeze(array_namespace(self.matrices).where(same[:, :, None], self.matrices, 0.0))

    @cached_property
    def _own_inverse(self) -> FloatArray | None:
        """The inverses of the A_ii, or ``None`` where one is singular."""
        xp = array_namespace(self._own_blocks)
        blocks = xp.moveaxis(self._own_blocks, 2, 0)
        if is_numpy(blocks) and np.linalg.cond(blocks).max() > 1e12:
            return None
        return freeze(xp.moveaxis(xp.linalg.inv(blocks), 0, 2))

    @cached_property
    def _is_separable(self) -> bool:
        """Whether every A_ii is diagonal, so that each component has its own best response."""
        if self.dimension == self.num_players:
            return True
        return bool(np.all(self._own_blocks[~np.eye(self.dimension, dtype=bool)] == 0))

    def _pressure(self, strategies: FloatArray) -> FloatArray:
        """Σ_{j≠i} A_ij x_j + b_i: (n, B) to (n, B)."""
        return times(self.matrices - self._own_blocks, strategies) + self.offsets

    def costs(self, strategies: FloatArray) -> FloatArray:
        return self.summed(strategies * (times(self._own_blocks, strategies) / 2 + self._pressure(strategies)))

    def summed(self, values: FloatArray) -> FloatArray:
        """Add the components of each player: (n, B) to (N, B)."""
        own = self.owners == np.arange(self.num_players)[:, None]
        return ordered_sum(array_namespace(values).where(own[:, :, None], values, 0.0), axis=1)

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """Block i is Σ_j A_ij x^i_j + b_i: (n, N, B) to (n, B)."""
        # One column per component, that of its owner; already so where all players have one component.
        columns = estimates if self.dimension == self.num_players else estimates[:, self.owners]
        gradients: FloatArray = array_namespace(columns).add.reduce(product(self.transposed, columns), axis=0)
        gradients += self.offsets
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """A, the same everywhere: (n, B) to (n, n, B)."""
        return np.broadcast_to(self.matrices, (*self.matrices.shape[:2], strategies.shape[1])).copy()

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """−A_ii⁻¹ (Σ_{j≠i} A_ij x_j + b_i), or the minimiser in the box: (n, B) to (n, B).

        Raises:
            NoBestResponseError: when some A_ii is singular.
        """
        if self._own_inverse is None:
            raise NoBestResponseError(f"{type(self).__name__}: some J_i has a flat direction, so no best response")
        pressure = self._pressure(strategies)
        response = -times(self._own_inverse, pressure)
        if self.box is None or self._is_separable:
            return self.project(response)
        blocks = np.broadcast_to(self._own_blocks, (*self._own_blocks.shape[:2], strategies.shape[1]))
        return solve_box(lambda x: times(blocks, x) + pressure, lambda _: blocks, *self.box, response)

    def _require_minima(self, points: FloatArray) -> None:
        """Check nothing: costs are convex by construction."""

    def _solve_nash_equilibria(self) -> FloatArray:
        if self.box is not None:
            return super()._solve_nash_equilibria()
        stack, right = np.moveaxis(self.matrices, 2, 0), -self.offsets.T[..., None]
        try:
            solution = np.linalg.solve(stack, right)
        except np.linalg.LinAlgError as error:
            raise ArithmeticError(
                f"{type(self).__name__}: A is singular, so there is no single Nash equilibrium"
            ) from error
        return np.asarray(solution[..., 0].T)


class QuadraticGame(AffineGame):
    """The affine game with a given A and b; see :class:`AffineGame`.

    Attributes:
        matrix: A, (n, n), or (n, n, G) for a batch; each A_ii is symmetric and positive semidefinite.
        offset: b, (n,), or (n, G) for a batch.
        action_dims: n_i of each player; by default 1 for all.
        low: smallest strategies, one number for all or (n,); ``None`` for no bound.
        high: largest strategies, likewise.
    """

    parameters: ClassVar[Mapping[str, int]] = {"matrix": 2, "offset": 1}

    matrix: npt.ArrayLike
    offset: npt.ArrayLike
    action_dims: tuple[int, ...] = ()
    low: npt.ArrayLike | None = None
    high: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        vars(self)["action_dims"] = self.action_dims or (1,) * len(self.offsets)
        super().__post_init__()


class RandomAffine(GameFamily):
    """Affine games F(x) = A x + b with an exact monotonicity constant ε and a chosen asymmetry.

    A = ε I + Q diag(λ) Qᵀ + a K with Q a random orthogonal matrix, λ_k ~ U(0, spread) and one λ_k = 0, and K a random
    skew-symmetric matrix with ‖K‖₂ = 1, so that F is ε-strongly monotone with the largest possible constant ε, and
    potential for a = 0. The skew part is 0 within players' own blocks, which are Hessians. x* ~ U(−scale, scale), and
    b = −A x*. For ε = 0 and a > 0, F is monotone and not strongly: it rotates without pull in the direction in which
    λ_k = 0. x* is unique then too, almost surely.

    Attributes:
        players: N ≥ 2.
        epsilon: ε ≥ 0, and above 0 where the asymmetry is 0.
        asymmetry: a ≥ 0.
        spread: ≥ 0; dF + dFᵀ has eigenvalues in [2ε, 2(ε + spread)].
        scale: half-width of the box of equilibria, ≥ 0; 0 puts them all at 0.
        action_dim: n_i, one number for all or one per player.
        low: smallest strategy of all players; ``None`` for no bound. In a box x* solves the variational inequality.
        high: largest strategy.

    Raises:
        ValueError: for a number out of range.
    """

    players: int = checked(require_count, 2, default=5)
    epsilon: float = checked(require_non_negative, default=1.0)
    asymmetry: float = checked(require_non_negative, default=1.0)
    spread: float = checked(require_non_negative, default=2.0)
    scale: float = checked(require_non_negative, default=10.0)
    action_dim: int | Sequence[int] = 1
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.asymmetry == 0:
            require_positive("epsilon", self.epsilon)
        for dim in self.action_dims:
            require_count("action_dim", dim, 1)
        vars(self)["is_strongly_monotone"] = None if self.epsilon else False
        _ = self.representative  # refuses an empty box

    @cached_property
    def action_dims(self) -> tuple[int, ...]:
        """The dimensions n_i of the players."""
        dims = self.action_dim
        if not isinstance(dims, Sequence):
            return (dims,) * self.players
        if len(dims) != self.players:
            raise ValueError(
                f"action_dim is one number for all, or one per player ({self.players}), got {tuple(dims)!r}"
            )
        return tuple(dims)

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        owners = np.repeat(np.arange(self.players), self.action_dims)
        n = owners.size
        normal = np.stack([generator.normal(size=(2, n, n)) for generator in generators])
        unit = np.stack([generator.random((2, n)) for generator in generators])
        orthogonal = np.linalg.qr(normal[:, 0])[0].transpose(1, 2, 0)
        eigenvalues = self.spread * unit[:, 0].T
        eigenvalues[0] = 0.0
        root = orthogonal * np.sqrt(eigenvalues)
        symmetric = ordered_sum(root[:, None] * root[None], axis=2)
        skew = np.where((owners[:, None] == owners)[:, :, None], 0.0, normal[:, 1].transpose(1, 2, 0))
        skew = skew - skew.transpose(1, 0, 2)
        skew /= np.linalg.norm(np.moveaxis(skew, 2, 0), 2, axis=(1, 2))
        matrix = self.epsilon * np.eye(n)[:, :, None] + symmetric + self.asymmetry * skew
        equilibrium = self.scale * (2 * unit[:, 1].T - 1)
        return QuadraticGame(matrix, -times(matrix, equilibrium), self.action_dims, self.low, self.high)


def times(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """Multiply matrices and vectors, (n, n, 1 or B) and (n, B) to (n, B), adding in the same order for any B."""
    return ordered_sum(matrix * vectors[None], axis=1)
