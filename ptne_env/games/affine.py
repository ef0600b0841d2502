"""Games with an affine pseudo-gradient."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game, NoBestResponseError
from ptne_env.games.variational import solve_box
from ptne_env.shared.arrays import (
    FloatArray,
    array_namespace,
    frozen,
    is_numpy,
    ordered_sum,
    product,
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
        return frozen(array_namespace(self.matrix).where(same[:, :, None], self.matrix, 0.0))

    @cached_property
    def _own_inverse(self) -> FloatArray | None:
        """The inverses of the A_ii, or ``None`` where one is singular."""
        xp = array_namespace(self._own_blocks)
        blocks = xp.moveaxis(self._own_blocks, 2, 0)
        if is_numpy(blocks) and np.linalg.cond(blocks).max() > 1e12:
            return None
        return frozen(xp.moveaxis(xp.linalg.inv(blocks), 0, 2))

    @cached_property
    def _is_separable(self) -> bool:
        """Whether every A_ii is diagonal, so that each component has its own best response."""
        if self.dimension == self.num_players:
            return True
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
        return ordered_sum(array_namespace(values).where(own[:, :, None], values, 0.0), axis=1)

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """Block i is Σ_j A_ij x^i_j + b_i: (n, N, B) to (n, B)."""
        # One column per component, that of its owner; already so where all players have one component.
        columns = estimates if self.dimension == self.num_players else estimates[:, self.owners]
        gradients: FloatArray = array_namespace(columns).add.reduce(product(self.transposed, columns), axis=0)
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


def times(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """Matrix-vector products with the same order of additions for any B: (n, n, 1 or B) and (n, B) to (n, B)."""
    return ordered_sum(matrix * vectors[None], axis=1)
