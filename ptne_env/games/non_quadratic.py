"""Example 2 of the paper: five players with non-quadratic costs."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np

from ptne_env.games.base import Game
from ptne_env.shared.arrays import FloatArray, array_namespace
from ptne_env.shared.names import require_name
from ptne_env.shared.parts import checked


class NonQuadraticGame(Game):
    """J1 = x1²/2 + x1 Σ_{j≥2} x_j, J2 = e^{x2/2}/2 + x2 x4, J3 = x3²/2 + x1³, J5 = x5² − 5 x5 + x1³ x2 + x3 x4⁴.

    J4 = w x4 + x4² + x3³, where w = 1 as printed (ln e^{x4}) and w = 4 in the corrected variant, the only one with
    the equilibrium that the paper prints (docs/errata.md, 1). F is neither strongly monotone nor globally
    Lipschitz, and J2 has no minimiser in x2 where x4 ≥ 0 (it is unbounded below where x4 > 0), so there is no best
    response.

    Attributes:
        variant: ``"corrected"`` or ``"printed"``; any other is a ``ValueError``.
    """

    variant: Literal["printed", "corrected"] = checked(require_name, ("printed", "corrected"), default="corrected")
    action_dims = (1,) * 5

    @cached_property
    def _slope(self) -> float:
        """The number w."""
        return 1.0 if self.variant == "printed" else 4.0

    def costs(self, strategies: FloatArray) -> FloatArray:
        xp, (x1, x2, x3, x4, x5) = array_namespace(strategies), strategies
        return xp.stack(
            [
                x1**2 / 2 + x1 * (x2 + x3 + x4 + x5),
                xp.exp(x2 / 2) / 2 + x2 * x4,
                x3**2 / 2 + x1**3,
                self._slope * x4 + x4**2 + x3**3,
                x5**2 - 5 * x5 + x1**3 * x2 + x3 * x4**4,
            ]
        )

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """(Σ_j x^1_j, e^{x^2_2/2}/4 + x^2_4, x^3_3, w + 2 x^4_4, 2 x^5_5 − 5): (5, 5, B) to (5, B)."""
        xp = array_namespace(estimates)
        return xp.stack(
            [
                xp.add.reduce(estimates[:, 0], axis=0),
                xp.exp(estimates[1, 1] / 2) / 4 + estimates[3, 1],
                estimates[2, 2],
                self._slope + 2 * estimates[3, 3],
                2 * estimates[4, 4] - 5,
            ]
        )

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """dF(x): (5, B) to (5, 5, B)."""
        matrix = np.zeros((5, 5, strategies.shape[1]))
        matrix[0] = 1
        matrix[1, 1] = np.exp(strategies[1] / 2) / 8
        matrix[1, 3] = 1
        matrix[2, 2] = 1
        matrix[3, 3] = 2
        matrix[4, 4] = 2
        return matrix

    def _solve_nash_equilibria(self) -> FloatArray:
        x4 = -self._slope / 2
        x2 = 2 * np.log(-4 * x4)
        return np.array([[-(x2 + x4 + 2.5)], [x2], [0.0], [x4], [2.5]])
