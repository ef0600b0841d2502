"""Games with an affine pseudo-gradient: general, random strongly monotone, and merely monotone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game, NoBestResponseError
from ptne_env.games.family import GameFamily
from ptne_env.games.variational import solve_box
from ptne_env.shared.arrays import (
    FloatArray,
    frozen,
    ordered_sum,
    require_count,
    require_non_negative,
    require_positive,
)


class AffineGame(Game):
    """J_i(x) = ½ x_iᵀ A_ii x_i + x_iᵀ (Σ_{j≠i} A_ij x_j + b_i), so that F(x) = A x + b.

    Models with an affine pseudo-gradient subclass this: they define A and b, and may add terms to :meth:`costs` that
    depend on other players alone.

    Args:
        matrix: A, (n, n), or (n, n, G) for a batch; each A_ii is symmetric and positive semidefinite.
        offset: b, (n,) or (n, G).
        action_dims: n_i of each player; by default 1 for all.
        low: smallest strategies; see :class:`~ptne_env.games.Game`.
        high: largest strategies.

    Raises:
        ValueError: when shapes disagree, a number is not finite, some A_ii is not symmetric, or some J_i not convex in
            x_i.
    """

    is_affine = True
    parameters: ClassVar[tuple[str, ...]] = ("matrix", "offset")

    def __init__(
        self,
        matrix: npt.ArrayLike,
        offset: npt.ArrayLike,
        action_dims: Sequence[int] | None = None,
        low: npt.ArrayLike | None = None,
        high: npt.ArrayLike | None = None,
    ) -> None:
        name = type(self).__name__
        matrices, offsets = np.asarray(matrix, dtype=np.float64), np.asarray(offset, dtype=np.float64)
        matrices = matrices[:, :, None] if matrices.ndim == 2 else matrices
        offsets = offsets[:, None] if offsets.ndim == 1 else offsets
        super().__init__((1,) * len(offsets) if action_dims is None else tuple(action_dims), low, high)
        n, games = self.dimension, offsets.shape[-1]
        if matrices.shape != (n, n, games) or offsets.shape != (n, games):
            raise ValueError(
                f"{name}: the players have {n} components, so matrix is ({n}, {n}) and offset ({n},), with a last axis "
                f"for games where there are several; got {np.shape(matrix)} and {np.shape(offset)}"
            )
        if not (np.isfinite(matrices).all() and np.isfinite(offsets).all()):
            raise ValueError(f"{name} needs finite parameters")
        self.matrix, self.offset = frozen(matrices), frozen(offsets)
        scale = np.abs(matrices).max()
        if np.abs(self._own_blocks - self._own_blocks.transpose(1, 0, 2)).max() > 1e-12 * scale:
            raise ValueError(f"{name}: some A_ii is not symmetric, so A x + b is not the gradient of costs")
        smallest = np.linalg.eigvalsh(np.moveaxis(self._own_blocks, 2, 0)).min()
        if smallest < -1e-12 * scale:
            raise ValueError(f"{name}: some J_i is not convex in x_i, its A_ii has the eigenvalue {smallest:.3g}")

    @property
    def batch_size(self) -> int:
        """G."""
        return self.offset.shape[1]

    @cached_property
    def transposed(self) -> FloatArray:
        """A with its first two axes swapped, shape (n, n, G), contiguous."""
        return frozen(self.matrix.transpose(1, 0, 2))

    @cached_property
    def _own_blocks(self) -> FloatArray:
        """A with all blocks but the A_ii set to 0."""
        same = self.owners[:, None] == self.owners
        return frozen(np.where(same[:, :, None], self.matrix, 0.0))

    @cached_property
    def _own_inverse(self) -> FloatArray | None:
        """The inverses of the A_ii, or ``None`` where one is singular."""
        blocks = np.moveaxis(self._own_blocks, 2, 0)
        if np.linalg.cond(blocks).max() > 1e12:
            return None
        return frozen(np.moveaxis(np.linalg.inv(blocks), 0, 2))

    @cached_property
    def _is_separable(self) -> bool:
        """Whether every A_ii is diagonal, so that each component has its own best response."""
        return bool(np.all(self._own_blocks[~np.eye(self.dimension, dtype=bool)] == 0))

    def _pressure(self, strategies: FloatArray) -> FloatArray:
        """Σ_{j≠i} A_ij x_j + b_i: (n, B) to (n, B)."""
        return times(self.matrix - self._own_blocks, strategies) + self.offset

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (n, B) to (N, B)."""
        return self.summed(strategies * (times(self._own_blocks, strategies) / 2 + self._pressure(strategies)))

    def summed(self, values: FloatArray) -> FloatArray:
        """Sums over the components of each player: (n, B) to (N, B)."""
        own = self.owners == np.arange(self.num_players)[:, None]
        return ordered_sum(np.where(own[:, :, None], values, 0.0), axis=1)

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """Block i is Σ_j A_ij x^i_j + b_i: (n, N, B) to (n, B)."""
        # One column per component, that of its owner; already so where all players have one component.
        columns = estimates if self.dimension == self.num_players else estimates[:, self.owners]
        terms = np.multiply(self.transposed, columns, order="C")  # the order of reduce()'s additions depends on it
        gradients: FloatArray = np.add.reduce(terms, axis=0)
        gradients += self.offset
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """A, the same everywhere: (n, B) to (n, n, B)."""
        return np.broadcast_to(self.matrix, (*self.matrix.shape[:2], strategies.shape[1])).copy()

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """−A_ii⁻¹ (Σ_{j≠i} A_ij x_j + b_i), or the minimiser in the box: (n, B) to (n, B).

        Raises:
            NoBestResponseError: when some A_ii is singular.
        """
        if self._own_inverse is None:
            raise NoBestResponseError(f"{type(self).__name__}: some J_i has a flat direction, so no best response")
        pressure = self._pressure(strategies)
        response = -times(self._own_inverse, pressure)
        if self.low is None or self.high is None or self._is_separable:
            return self.project(response)
        blocks = np.broadcast_to(self._own_blocks, (*self._own_blocks.shape[:2], strategies.shape[1]))
        return solve_box(lambda x: times(blocks, x) + pressure, lambda _: blocks, self.low, self.high, response)

    def _with(self, **parameters: FloatArray) -> Game:
        return type(self)(**parameters, action_dims=self.action_dims, low=self.low, high=self.high)

    def _solve_nash_equilibria(self) -> FloatArray:
        if self.has_bounds:
            return super()._solve_nash_equilibria()
        stack, right = np.moveaxis(self.matrix, 2, 0), -self.offset.T[..., None]
        try:
            solution = np.linalg.solve(stack, right)
        except np.linalg.LinAlgError as error:
            raise ArithmeticError(
                f"{type(self).__name__}: A is singular, so there is no single Nash equilibrium"
            ) from error
        return np.asarray(solution[..., 0].T)


class RandomAffine(GameFamily):
    """Affine games F(x) = A x + b with an exact monotonicity constant ε and a chosen asymmetry.

    A = ε I + Q diag(λ) Qᵀ + a K with Q a random orthogonal matrix, λ_k ~ U(0, spread) and one λ_k = 0, and K a random
    skew-symmetric matrix with ‖K‖₂ = 1, so that F is ε-strongly monotone with the largest possible constant ε, and
    potential for a = 0. The skew part is 0 within players' own blocks, which are Hessians. x* ~ U(−scale, scale), and
    b = −A x*. For ε = 0 and a > 0, F is monotone and not strongly: it rotates without pull in the direction in which
    λ_k = 0. x* is unique then too, almost surely.

    Args:
        players: N ≥ 2.
        epsilon: ε ≥ 0, and above 0 where the asymmetry is 0.
        asymmetry: a ≥ 0.
        spread: ≥ 0; dF + dFᵀ has eigenvalues in [2ε, 2(ε + spread)].
        scale: half-width of the box of equilibria, above 0.
        action_dim: n_i, one number for all or one per player.
        low: smallest strategy of all players; ``None`` for no bound. In a box x* solves the variational inequality.
        high: largest strategy.

    Raises:
        ValueError: for a number out of range.
    """

    def __init__(
        self,
        players: int = 5,
        epsilon: float = 1.0,
        asymmetry: float = 1.0,
        spread: float = 2.0,
        scale: float = 10.0,
        action_dim: int | Sequence[int] = 1,
        low: float | None = None,
        high: float | None = None,
    ) -> None:
        count = require_count("players", players, 2)
        dims = tuple(action_dim) if isinstance(action_dim, Sequence) else (action_dim,) * count
        if len(dims) != count:
            raise ValueError(f"action_dim is one number for all, or one per player ({count}), got {action_dim!r}")
        self.action_dims = tuple(require_count("action_dim", dim, 1) for dim in dims)
        self.asymmetry = require_non_negative("asymmetry", asymmetry)
        self.epsilon = (require_non_negative if self.asymmetry else require_positive)("epsilon", epsilon)
        if self.epsilon == 0:
            self.is_strongly_monotone = False
        self.spread = require_non_negative("spread", spread)
        self.scale = require_positive("scale", scale)
        self.bounds = low, high
        self.representative = self.draw([np.random.default_rng(0)])

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One affine game per generator."""
        n = sum(self.action_dims)
        owners = np.repeat(np.arange(len(self.action_dims)), self.action_dims)
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
        return AffineGame(matrix, -times(matrix, equilibrium), self.action_dims, *self.bounds)


class WeaklyMonotoneGame(AffineGame):
    """J_i(x) = (x_i − x̄)² N/(N−1) + c_i(x) − d_i x_i up to terms of others, x̄ the mean of all strategies.

    The first player leads and the others follow, c_1 = a x_1 Σ_{j>1} x_j and c_i = −a x_i x_1. So
    dF = 2 (I − 11ᵀ/N) + a K with K skew-symmetric: each J_i is strictly convex in x_i and F is monotone, but not
    strongly: no cost depends on the mean alone, so 1ᵀ dF 1 = 0 and Assumption 4 fails. Yet dF is regular and the
    equilibrium unique.

    Args:
        demand: d_i, which sets N.
        rotation: a > 0.

    Raises:
        ValueError: when ``rotation`` is not positive or a number is not finite.
    """

    def __init__(self, demand: Sequence[float] = (1.0, 2.0, 3.0, 4.0, 5.0), rotation: float = 0.5) -> None:
        demands = np.asarray(demand, dtype=np.float64)
        players = demands.size
        follow = np.zeros((players, players))
        follow[0, 1:], follow[1:, 0] = 1.0, -1.0
        agree = 2 * (np.eye(players) - 1 / players)
        super().__init__(agree + require_positive("rotation", rotation) * follow, -demands)


def times(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """Matrix-vector products with the same order of additions for any B: (n, n, 1 or B) and (n, B) to (n, B)."""
    return ordered_sum(matrix * vectors[None], axis=1)
