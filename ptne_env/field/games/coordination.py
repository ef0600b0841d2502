"""Games with several equilibria, all of them known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game, merged_parameters
from ptne_env.games.family import GameFamily
from ptne_env.shared.arrays import BoolArray, FloatArray, frozen, ordered_sum, require_count, require_positive

SIDES = (1.0, 0.0, -1.0)
"""The solutions of y = tanh(β y)/tanh(β), in the order of the equilibria."""


class CoordinationGame(Game):
    """J_i(x) = ½ (x_i − p_i)² − s_i (x_i − p_i) h(m_i), h(y) = tanh(β y)/tanh(β), with exactly three equilibria.

    m_i = Σ_{j≠i} (x_j − p_j)/s_j/(N − 1) is the mean position of the others: players gain from taking the same side, in
    a game of strategic complements as in P. Milgrom and J. Roberts, "Rationalizability, learning, and equilibrium in
    games with strategic complementarities", Econometrica 58(6), 1990; the model is ours. With y_i = (x_i − p_i)/s_i an
    equilibrium satisfies y_i = h((Σ_j y_j − y_i)/(N − 1)). The right side falls in y_i, so all y_i are equal, and y =
    h(y) has the solutions 1, 0 and −1. Hence x* = p + s, p and p − s.

    Each J_i is strictly convex in x_i, and F is not monotone. Gradient play settles at p + s and p − s, which are
    stable as h'(±1) < 1, and leaves p, as h'(0) > 1. Distances are those to the nearest of the three.

    Args:
        middle: p, (N,) or (N, G).
        size: s > 0, (N,) or (N, G).
        steepness: β > 0.

    Raises:
        ValueError: when shapes disagree or a number is out of range.
    """

    def __init__(
        self,
        middle: npt.ArrayLike = (10.0, 15.0, 20.0, 25.0, 30.0),
        size: npt.ArrayLike = (4.0, 6.0, 8.0, 6.0, 4.0),
        steepness: float = 1.5,
    ) -> None:
        middles, sizes = np.asarray(middle, dtype=np.float64), np.asarray(size, dtype=np.float64)
        super().__init__((1,) * len(middles))
        middles, sizes = middles.reshape(len(middles), -1), sizes.reshape(len(sizes), -1)
        if middles.shape != sizes.shape:
            raise ValueError(
                f"CoordinationGame needs one middle and one size per player (and game), got {np.shape(middle)} and "
                f"{np.shape(size)}"
            )
        if not (np.isfinite(middles).all() and np.isfinite(sizes).all() and sizes.min() > 0):
            raise ValueError("CoordinationGame needs finite numbers, and size > 0")
        self.middle, self.size = frozen(middles), frozen(sizes)
        self.steepness = require_positive("steepness", steepness)

    @property
    def batch_size(self) -> int:
        """G."""
        return self.middle.shape[1]

    def _positions(self, strategies: FloatArray) -> FloatArray:
        """y, (n, B) to (n, B)."""
        return (strategies - self.middle) / self.size

    def _wanted(self, strategies: FloatArray) -> FloatArray:
        """h(m_i): (n, B) to (n, B)."""
        positions = self._positions(strategies)
        mean = (ordered_sum(positions) - positions) / (self.num_players - 1)
        return np.tanh(self.steepness * mean) / np.tanh(self.steepness)

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (N, B) to (N, B)."""
        moved = strategies - self.middle
        return moved * (moved / 2 - self.size * self._wanted(strategies))

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """x^i_i − p_i − s_i h(m_i(x^i)): (N, N, B) to (N, B)."""
        positions = (estimates - self.middle[:, None]) / self.size[:, None]
        own = np.einsum("iib->ib", positions)
        mean = (ordered_sum(positions) - own) / (self.num_players - 1)
        return self.size * (own - np.tanh(self.steepness * mean) / np.tanh(self.steepness))

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """I − diag(s) diag(h'(m)) (11ᵀ − I)/(N − 1) diag(s)⁻¹: (N, B) to (N, N, B)."""
        tangent = np.tanh(self.steepness)
        slope = self.steepness * (1 - (tangent * self._wanted(strategies)) ** 2) / tangent
        matrix = -(self.size * slope)[:, None] / self.size[None] / (self.num_players - 1)
        np.einsum("iib->ib", matrix)[...] = 1.0
        return matrix

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """p_i + s_i h(m_i): (N, B) to (N, B)."""
        return self.middle + self.size * self._wanted(strategies)

    def merged(self, fresh: Game, mask: BoolArray) -> Game:
        """The batch of games with those in ``mask`` (G,) replaced by those of ``fresh``, in order."""
        if fresh is self:
            return self
        parameters = merged_parameters(CoordinationGame, self, fresh, mask, ("middle", "size"))
        return CoordinationGame(steepness=self.steepness, **parameters)

    def _solve_nash_equilibria(self) -> FloatArray:
        return self.middle + SIDES[0] * self.size

    def _solve_other_equilibria(self) -> FloatArray:
        return np.stack([self.middle + side * self.size for side in SIDES[1:]])


class RandomCoordination(GameFamily):
    """Coordination games with p_i ~ U(middle) and s_i ~ U(size); every game has three equilibria.

    Args:
        players: N ≥ 2.
        middle: range of p_i.
        size: range of s_i, positive.
        steepness: β > 0.

    Raises:
        ValueError: when a number is out of range.
    """

    is_strongly_monotone = False

    def __init__(
        self,
        players: int = 5,
        middle: tuple[float, float] = (-10.0, 10.0),
        size: tuple[float, float] = (4.0, 8.0),
        steepness: float = 1.5,
    ) -> None:
        self.players, self.steepness = require_count("players", players, 2), steepness
        self._low, self._high = np.array([middle, size], dtype=np.float64).T[:, :, None]
        if not (np.isfinite([self._low, self._high]).all() and np.all(self._low < self._high) and size[0] > 0):
            raise ValueError(f"RandomCoordination needs finite ranges low < high, size > 0, got {middle!r}, {size!r}")
        self.representative = self.draw([np.random.default_rng(0)])

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One coordination game per generator."""
        unit = np.stack([generator.random((2, self.players)) for generator in generators], axis=-1)
        low, high = self._low[:, :, None], self._high[:, :, None]
        middle, size = low + (high - low) * unit
        return CoordinationGame(middle, size, self.steepness)
