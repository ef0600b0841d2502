"""Example 1 of the paper: energy consumption of heating, ventilation and air conditioning (HVAC)."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import Game
from ptne_env.shared.arrays import FloatArray, array_namespace, frozen, ordered_sum


class EnergyGame(Game):
    """J_i(x) = a_i (x_i − b_i)² + (c Σ_j x_j + d) x_i, one strategy per player (Example 1).

    The paper writes c both for this coupling and for the constant part of the prescribed-time gain; they are
    different things.

    Args:
        curvature: a_i > 0 of each player, (N,), or one number for all.
        target: b_i, the consumption that player i prefers, (N,); its length sets N.
        coupling: c ≥ 0, the increase of the price with total consumption.
        base_price: d.

    For a batch of G games, curvature and target have the shape (N, G) and coupling (G,).

    Raises:
        ValueError: when a_i ≤ 0, c < 0, shapes disagree or a number is not finite.
    """

    is_affine = True
    parameters: ClassVar[tuple[str, ...]] = ("curvature", "target", "coupling")

    def __init__(
        self,
        curvature: npt.ArrayLike = 1.0,
        target: npt.ArrayLike = (10.0, 15.0, 20.0, 25.0, 30.0),
        coupling: npt.ArrayLike = 0.1,
        base_price: float = 10.0,
    ) -> None:
        targets, curvatures, couplings = (
            np.asarray(value, dtype=np.float64) for value in (target, curvature, coupling)
        )
        if targets.ndim not in (1, 2):
            raise ValueError(f"target must list one number per player, got the shape {targets.shape}")
        targets = targets.reshape(len(targets), -1)
        super().__init__((1,) * len(targets))
        try:
            curvatures = np.broadcast_to(curvatures[:, None] if curvatures.ndim == 1 else curvatures, targets.shape)
            couplings = np.broadcast_to(couplings, targets.shape[1:])
        except ValueError as error:
            raise ValueError(
                f"EnergyGame: curvature {np.shape(curvature)} and coupling {np.shape(coupling)} do not fit target "
                f"{np.shape(target)}; give one number for all, or one per player (and game)"
            ) from error
        if not all(np.isfinite(values).all() for values in (targets, curvatures, couplings, base_price)):
            raise ValueError("EnergyGame needs finite parameters")
        if curvatures.min() <= 0 or couplings.min() < 0:
            raise ValueError(
                f"EnergyGame needs curvature > 0 and coupling ≥ 0, got a minimum of {curvatures.min()} and "
                f"{couplings.min()}"
            )
        self.curvature = frozen(curvatures)
        self.target = frozen(targets)
        self.coupling = frozen(couplings)
        self.base_price = float(base_price)

    @property
    def batch_size(self) -> int:
        """G."""
        return self.target.shape[1]

    @cached_property
    def slope(self) -> FloatArray:
        """2 a_i + c, shape (N, G)."""
        return frozen(2 * self.curvature + self.coupling)

    @cached_property
    def intercept(self) -> FloatArray:
        """d − 2 a_i b_i, shape (N, G)."""
        return frozen(self.base_price - 2 * self.curvature * self.target)

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (N, B) to (N, B)."""
        price = self.coupling * ordered_sum(strategies) + self.base_price
        return self.curvature * (strategies - self.target) ** 2 + price * strategies

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """2 a_i (x^i_i − b_i) + c Σ_j x^i_j + d + c x^i_i: (N, N, B) to (N, B)."""
        gradients: FloatArray = array_namespace(estimates).add.reduce(estimates, axis=0)
        gradients *= self.coupling
        players, batch = self.num_players, estimates.shape[2]
        gradients += self.slope * estimates.reshape(-1, batch)[:: players + 1]  # the diagonal x^i_i
        gradients += self.intercept
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """diag(2 a_i + c) + c 11ᵀ, the same everywhere: (N, B) to (N, N, B)."""
        matrix = np.zeros((self.num_players, *strategies.shape))
        matrix += self.coupling
        np.einsum("iib->ib", matrix)[...] += self.slope
        return matrix

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """(2 a_i b_i − d − c Σ_{j≠i} x_j) / (2 (a_i + c)): (N, B) to (N, B)."""
        others = ordered_sum(strategies) - strategies
        return -(self.intercept + self.coupling * others) / (2 * (self.curvature + self.coupling))

    def _with(self, **parameters: FloatArray) -> EnergyGame:
        return type(self)(**parameters, base_price=self.base_price)

    def _solve_nash_equilibria(self) -> FloatArray:
        """Sherman–Morrison on (diag(2a + c) + c 11ᵀ) x = 2ab − d."""
        free = -self.intercept / self.slope
        total = ordered_sum(free) / (1 + self.coupling * ordered_sum(1 / self.slope))
        return free - self.coupling * total / self.slope
