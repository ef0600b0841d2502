"""Example 1 of the paper: energy consumption of heating, ventilation and air conditioning (HVAC)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ptne_env.arrays import FloatArray, frozen, ordered_sum
from ptne_env.games.base import Game


class EnergyGame(Game):
    """J_i(x) = a_i (x_i − b_i)² + (c Σ_j x_j + d) x_i, one strategy per player (Example 1).

    The paper writes c both for this coupling and for the constant part of the prescribed-time gain; they are
    different things.

    Args:
        curvature: a_i > 0 of each player, or one number for all.
        target: b_i, the consumption that player i would like; its length sets N.
        coupling: c ≥ 0, how the price rises with total consumption.
        base_price: d.

    Raises:
        ValueError: when a_i ≤ 0, c < 0, lengths differ or a number is not finite.
    """

    is_affine = True

    def __init__(
        self,
        curvature: float | Sequence[float] = 1.0,
        target: Sequence[float] = (10.0, 15.0, 20.0, 25.0, 30.0),
        coupling: float = 0.1,
        base_price: float = 10.0,
    ) -> None:
        targets = np.asarray(target, dtype=np.float64)
        if targets.ndim != 1:
            raise ValueError(f"target must list one number per player, got the shape {targets.shape}")
        super().__init__((1,) * targets.size)
        curvatures = np.asarray(curvature, dtype=np.float64)
        if curvatures.shape not in ((), targets.shape):
            raise ValueError(f"curvature needs one number or {targets.size}, got the shape {curvatures.shape}")
        curvatures = np.broadcast_to(curvatures, targets.shape)
        if not np.all(np.isfinite([*targets, *curvatures, coupling, base_price])):
            raise ValueError("EnergyGame needs finite parameters")
        if curvatures.min() <= 0 or coupling < 0:
            raise ValueError(f"EnergyGame needs curvature > 0 and coupling ≥ 0, got {curvature!r} and {coupling!r}")
        self.curvature = frozen(curvatures[:, None])
        self.target = frozen(targets[:, None])
        self.coupling = float(coupling)
        self.base_price = float(base_price)

    @cached_property
    def _slope(self) -> FloatArray:
        return frozen(2 * self.curvature + self.coupling)

    @cached_property
    def _intercept(self) -> FloatArray:
        return frozen(self.base_price - 2 * self.curvature * self.target)

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (N, B) to (N, B)."""
        price = self.coupling * ordered_sum(strategies) + self.base_price
        return self.curvature * (strategies - self.target) ** 2 + price * strategies

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """2 a_i (x^i_i − b_i) + c Σ_j x^i_j + d + c x^i_i: (N, N, B) to (N, B)."""
        gradients = np.add.reduce(estimates, axis=0)
        gradients *= self.coupling
        gradients += self._slope * np.einsum("iib->ib", estimates)
        gradients += self._intercept
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """diag(2 a_i + c) + c 11ᵀ, the same everywhere: (N, B) to (N, N, B)."""
        matrix = np.diag(self._slope[:, 0]) + self.coupling
        return np.repeat(matrix[:, :, None], strategies.shape[1], axis=2)

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """(2 a_i b_i − d − c Σ_{j≠i} x_j) / (2 (a_i + c)): (N, B) to (N, B)."""
        others = ordered_sum(strategies) - strategies
        return -(self._intercept + self.coupling * others) / (2 * (self.curvature + self.coupling))

    def _solve_nash_equilibrium(self) -> FloatArray:
        """Sherman–Morrison on (diag(2a + c) + c 11ᵀ) x = 2ab − d."""
        free = -self._intercept[:, 0] / self._slope[:, 0]
        total = free.sum() / (1 + self.coupling * (1 / self._slope[:, 0]).sum())
        return free - self.coupling * total / self._slope[:, 0]
