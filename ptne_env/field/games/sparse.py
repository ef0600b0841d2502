"""Games of many players, each of which is affected by few others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game, merged_parameters
from ptne_env.games.family import GameFamily
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, frozen, require_count, require_positive


class SparseGame(Game):
    """J_i(x) = ½ a_i x_i² + x_i (Σ_d c_id x_{p(i, d)} + b_i), one strategy per player, with k partners p(i, d) each.

    F(x) = A x + b with k + 1 entries per row of A; it costs N (k + 1) operations instead of N². The game is given by
    its equilibrium x*, b = −A x*, which is therefore exact.

    Args:
        curvature: a_i > 0, (N,) or (N, G).
        partners: p(i, d), players other than i, each at most once, (k, N) or (k, N, G).
        coupling: c_id, of the same shape.
        equilibrium: x*, (N,) or (N, G).

    Raises:
        ValueError: when shapes disagree, a partner is not another player or is named twice, or a_i ≤ 0.
    """

    is_affine = True

    def __init__(
        self,
        curvature: npt.ArrayLike,
        partners: npt.ArrayLike,
        coupling: npt.ArrayLike,
        equilibrium: npt.ArrayLike,
    ) -> None:
        equilibria, own = np.asarray(equilibrium, dtype=np.float64), np.asarray(curvature, dtype=np.float64)
        equilibria, own = equilibria.reshape(len(equilibria), -1), own.reshape(len(own), -1)
        super().__init__((1,) * len(equilibria))
        who, weights = np.asarray(partners, dtype=np.int64), np.asarray(coupling, dtype=np.float64)
        who, weights = who.reshape(*who.shape[:2], -1), weights.reshape(*weights.shape[:2], -1)
        expected = (len(who), *equilibria.shape)
        if own.shape != equilibria.shape or who.shape != expected or weights.shape != expected:
            raise ValueError(
                f"SparseGame: {self.num_players} players need curvature and equilibrium (N,), partners and coupling "
                f"(k, N), each with a last axis for games where there are several; got {np.shape(curvature)}, "
                f"{np.shape(equilibrium)}, {np.shape(partners)} and {np.shape(coupling)}"
            )
        all_of = np.sort(np.concatenate([who, np.broadcast_to(self.owners[None, :, None], (1, *own.shape))]), axis=0)
        if all_of[0].min() < 0 or all_of[-1].max() >= self.num_players or not np.all(np.diff(all_of, axis=0)):
            raise ValueError(f"partners are other players, 0 to {self.num_players - 1}, each at most once")
        if not own.min() > 0:
            raise ValueError(f"SparseGame needs curvature > 0, got {own.min()}")
        self.curvature, self.coupling, self.equilibrium = frozen(own), frozen(weights), frozen(equilibria)
        self.partners: IntArray = who.copy()
        self.partners.flags.writeable = False
        self.offset = frozen(-own * equilibria - self._pressure(equilibria))

    @property
    def batch_size(self) -> int:
        """G."""
        return self.equilibrium.shape[1]

    def _pressure(self, strategies: FloatArray) -> FloatArray:
        """Σ_d c_id x_{p(i, d)}: (N, B) to (N, B)."""
        total = np.zeros(strategies.shape)
        for partner, weight in zip(self.partners, self.coupling, strict=True):
            total += weight * strategies[partner, np.arange(strategies.shape[1])]
        return total

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (N, B) to (N, B)."""
        return strategies * (self.curvature * strategies / 2 + self._pressure(strategies) + self.offset)

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """a_i x^i_i + Σ_d c_id x^i_{p(i, d)} + b_i: (N, N, B) to (N, B)."""
        players, batch = np.arange(self.num_players)[:, None], np.arange(estimates.shape[2])
        gradients = self.curvature * estimates[players, players, batch]
        for partner, weight in zip(self.partners, self.coupling, strict=True):
            gradients += weight * estimates[partner, players, batch]
        gradients += self.offset
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """A, the same everywhere: (N, B) to (N, N, B)."""
        matrix = np.zeros((self.num_players, *strategies.shape))
        players, batch = np.arange(self.num_players)[:, None], np.arange(strategies.shape[1])
        matrix[players, players, batch] = self.curvature
        matrix[players, self.partners, batch] = self.coupling
        return matrix

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """−(Σ_d c_id x_{p(i, d)} + b_i)/a_i: (N, B) to (N, B)."""
        return -(self._pressure(strategies) + self.offset) / self.curvature

    def merged(self, fresh: Game, mask: BoolArray) -> Game:
        """The batch of games with those in ``mask`` (G,) replaced by those of ``fresh``, in order."""
        if fresh is self:
            return self
        names = ("curvature", "partners", "coupling", "equilibrium")
        return SparseGame(**merged_parameters(SparseGame, self, fresh, mask, names))

    def _solve_nash_equilibria(self) -> FloatArray:
        return self.equilibrium


class RandomSparse(GameFamily):
    """Sparse games on a random circle: each player is affected by the h players before and after it.

    The circle is drawn per game, and has nothing to do with the graph of communication. a_i ~ U(1, 2), c_id ~
    U(−c, c)/(2h) and x* ~ U(−scale, scale). By Gershgorin's theorem F is strongly monotone with ε ≥ 1 − c.

    Args:
        players: N > 2h.
        reach: h ≥ 1.
        coupling: c, in (0, 1).
        scale: half-width of the box of equilibria, above 0.

    Raises:
        ValueError: for a number out of range.
    """

    is_strongly_monotone = True

    def __init__(self, players: int = 50, reach: int = 2, coupling: float = 0.8, scale: float = 10.0) -> None:
        self.reach = require_count("reach", reach, 1)
        self.players = require_count("players", players, 2 * self.reach + 1)
        self.coupling, self.scale = require_positive("coupling", coupling), require_positive("scale", scale)
        if self.coupling >= 1:
            raise ValueError(f"coupling must be below 1, so that F is strongly monotone, got {coupling!r}")
        self.representative = self.draw([np.random.default_rng(0)])

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One sparse game per generator."""
        links = 2 * self.reach
        circle = np.stack([generator.permutation(self.players) for generator in generators], axis=-1)
        unit = np.stack([generator.random((links + 2, self.players)) for generator in generators], axis=-1)
        partners = np.empty((links, *circle.shape), dtype=np.int64)
        for place, shift in enumerate([*range(-self.reach, 0), *range(1, self.reach + 1)]):
            np.put_along_axis(partners[place], circle, np.roll(circle, shift, axis=0), axis=0)
        coupling = self.coupling * (2 * unit[:links] - 1) / links
        return SparseGame(1 + unit[links], partners, coupling, self.scale * (2 * unit[links + 1] - 1))
