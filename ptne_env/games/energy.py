"""Example 1 of the paper, energy consumption of heating, ventilation and air conditioning (HVAC); and random ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game, GameFamily
from ptne_env.shared.arrays import FloatArray, array_namespace, freeze, ordered_sum, require_count, with_games
from ptne_env.shared.parts import checked


class EnergyGame(Game):
    """J_i(x) = a_i (x_i − b_i)² + (c Σ_j x_j + d) x_i, one strategy per player (Example 1).

    The paper writes c both for this coupling and for the constant part of the prescribed-time gain; they are
    different things.

    Attributes:
        curvature: a_i > 0 of each player, (N,), or one number for all.
        target: b_i, the consumption that player i prefers, (N,); its length sets N.
        coupling: c ≥ 0, the increase of the price with total consumption.
        base_price: d.

    For a batch of G games, curvature and target have the shape (N, G) and coupling (G,).

    Raises:
        ValueError: when a_i ≤ 0, c < 0, shapes disagree or a number is not finite.
    """

    is_affine = True
    parameters: ClassVar[Mapping[str, int]] = {"curvature": 1, "target": 1, "coupling": 0}

    curvature: npt.ArrayLike = 1.0
    target: npt.ArrayLike = (10.0, 15.0, 20.0, 25.0, 30.0)
    coupling: npt.ArrayLike = 0.1
    base_price: float = 10.0

    def __post_init__(self) -> None:
        if np.ndim(self.target) not in (1, 2):
            raise ValueError(f"target must list one number per player, got the shape {np.shape(self.target)}")
        super().__post_init__()
        if np.shape(self.curvature) not in ((), np.shape(self.target)):
            raise ValueError(
                f"EnergyGame: the numbers of curvature {np.shape(self.curvature)} do not fit target "
                f"{np.shape(self.target)}; give one number for all, or one per player (and game)"
            )
        if not (np.isfinite(self.slope).all() and np.isfinite(self.intercept).all()):
            raise ValueError("EnergyGame needs finite parameters")
        curvature, coupling = self.curvatures.min(), self.couplings.min()
        if curvature <= 0 or coupling < 0:
            raise ValueError(
                f"EnergyGame needs curvature > 0 and coupling ≥ 0, got a minimum of {curvature} and {coupling}"
            )

    @cached_property
    def action_dims(self) -> tuple[int, ...]:
        """The dimension of every player, 1."""
        return (1,) * len(self.targets)

    @cached_property
    def targets(self) -> FloatArray:
        """The preferred consumptions b_i, shape (N, G), read-only."""
        return with_games(self.target, 1)

    @cached_property
    def curvatures(self) -> FloatArray:
        """The curvatures a_i, shape (N, G), read-only."""
        curvatures = freeze(self.curvature)
        return curvatures if self.is_batch else freeze(np.broadcast_to(curvatures, len(self.targets))[:, None])

    @cached_property
    def couplings(self) -> FloatArray:
        """The couplings c, shape (G,), read-only."""
        return with_games(self.coupling, 0)

    @cached_property
    def slope(self) -> FloatArray:
        """2 a_i + c, shape (N, G)."""
        return freeze(2 * self.curvatures + self.couplings)

    @cached_property
    def intercept(self) -> FloatArray:
        """d − 2 a_i b_i, shape (N, G)."""
        return freeze(self.base_price - 2 * self.curvatures * self.targets)

    def costs(self, strategies: FloatArray) -> FloatArray:
        price = self.couplings * ordered_sum(strategies) + self.base_price
        return self.curvatures * (strategies - self.targets) ** 2 + price * strategies

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """2 a_i (x^i_i − b_i) + c Σ_j x^i_j + d + c x^i_i: (N, N, B) to (N, B)."""
        gradients: FloatArray = array_namespace(estimates).add.reduce(estimates, axis=0)
        gradients *= self.couplings
        players, batch = self.num_players, estimates.shape[2]
        gradients += self.slope * estimates.reshape(-1, batch)[:: players + 1]  # the diagonal x^i_i
        gradients += self.intercept
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """diag(2 a_i + c) + c 11ᵀ, the same everywhere: (N, B) to (N, N, B)."""
        matrix = np.zeros((self.num_players, *strategies.shape))
        matrix += self.couplings
        np.einsum("iib->ib", matrix)[...] += self.slope
        return matrix

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """(2 a_i b_i − d − c Σ_{j≠i} x_j) / (2 (a_i + c)): (N, B) to (N, B)."""
        others = ordered_sum(strategies) - strategies
        return -(self.intercept + self.couplings * others) / (2 * (self.curvatures + self.couplings))

    def _solve_nash_equilibria(self) -> FloatArray:
        """Sherman–Morrison on (diag(2a + c) + c 11ᵀ) x = 2ab − d."""
        free = -self.intercept / self.slope
        total = ordered_sum(free) / (1 + self.couplings * ordered_sum(1 / self.slope))
        return free - self.couplings * total / self.slope


class RandomEnergy(GameFamily):
    """Energy games with a_i ~ U(0.5, 2), b_i ~ U(5, 35), c ~ U(0.05, 0.3) and d = 10, independently.

    F is strongly monotone for every draw: dF = diag(2a + c) + c 11ᵀ is positive definite.

    Attributes:
        players: N ≥ 2.
        curvature: range of a_i, positive.
        target: range of b_i.
        coupling: range of c, not negative.
        base_price: d.

    Raises:
        ValueError: when a range is empty or contains parameters that :class:`EnergyGame` refuses.
    """

    players: int = checked(require_count, 2, default=5)
    curvature: tuple[float, float] = (0.5, 2.0)
    target: tuple[float, float] = (5.0, 35.0)
    coupling: tuple[float, float] = (0.05, 0.3)
    base_price: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("curvature", "target", "coupling"):
            low, high = getattr(self, name)
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ValueError(f"RandomEnergy needs a finite range low < high for {name}, got {(low, high)!r}")
        self._game(np.zeros(2 * self.players + 1))  # refuses extreme parameters now instead of during a run

    @cached_property
    def representative(self) -> Game:
        """The game in the middle of the ranges."""
        return self._game(np.full(2 * self.players + 1, 0.5))

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        return self._game(np.stack([generator.random(2 * self.players + 1) for generator in generators], axis=-1))

    def columns(self, unit: FloatArray) -> dict[str, FloatArray]:
        """Return the parameters of games by name, made from U(0, 1), (2 N + 1,) or (2 N + 1, G)."""
        players, games = self.players, unit.shape[1:]
        ranges = np.array([self.curvature] * players + [self.target] * players + [self.coupling], dtype=np.float64)
        low, high = ranges.T.reshape(2, -1, *(1 for _ in games))
        numbers = low + (high - low) * unit
        return {"curvature": numbers[:players], "target": numbers[players:-1], "coupling": numbers[-1]}

    def _game(self, unit: FloatArray) -> EnergyGame:
        return EnergyGame(**self.columns(unit), base_price=self.base_price)
