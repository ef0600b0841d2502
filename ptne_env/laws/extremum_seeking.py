"""Nash seeking from payoffs alone."""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import FloatArray, require_non_negative, require_positive
from ptne_env.laws.base import Condition, Law, ProblemConstants, decisive, per_step
from ptne_env.laws.grounded import grounded_error
from ptne_env.observation import Interface, Observation, ObservationLayout


class ExtremumSeeking(Law):
    """x_i = x̂_i + μ_i, dx̂_i/dτ = −k μ_i (J_i(x) − η_i), μ_i = a sin ω_i τ, dη_i/dτ = ω_h (J_i − η_i).

    P. Frihauf, M. Krstić and T. Başar, "Nash equilibrium seeking in noncooperative games", IEEE Transactions on
    Automatic Control 57(5), 2012, for costs instead of payoffs and in effective time. A player probes with a sinusoid
    and correlates it with its own cost, so on average dx̂_i/dτ = −(k a²/2) ∂J_i/∂x_i. It observes neither gradient nor
    strategies; the interface has ``own_payoff``. η is a washout of the cost's mean (ω_h = 0: none).

    Frequencies ω_c = ω (1 + (c + 1)/(n + 1)) per component c lie strictly between ω and 2ω and are all different, so
    ω_i ≠ ω_j, 2ω_i ≠ ω_j and ω_i ≠ ω_j + ω_k. They depend on the player's number: whoever is relabelled probes
    otherwise. x̂, μ, η and the time are memory. The estimates of the others play no part in the strategies; they follow
    the neighbours as in :class:`~ptne_env.laws.Grounded`, for those who measure them.

    Args:
        layout: of the environment, with :attr:`interface` or ``local`` and ``own_payoff``.
        amplitude: a > 0.
        gain: k > 0.
        frequency: ω > 0 in 1/τ.
        washout: ω_h ≥ 0 in 1/τ.
        kappa: consensus gain of the estimates, ≥ 0.

    Raises:
        ValueError: for a parameter out of range, or a layout without ``own_payoff``.
    """

    needs = ("own_payoff",)
    interface = Interface(own_payoff=True)

    def __init__(
        self,
        layout: ObservationLayout,
        amplitude: float = 1.0,
        gain: float = 0.2,
        frequency: float = 9.0,
        washout: float = 3.0,
        kappa: float = 2.0,
    ) -> None:
        super().__init__(layout)
        self.amplitude = require_positive("amplitude", amplitude)
        self.gain = require_positive("gain", gain)
        self.frequency = require_positive("frequency", frequency)
        self.washout = require_non_negative("washout", washout)
        self.kappa = require_non_negative("kappa", kappa)
        n = layout.dimension
        self.frequencies = self.frequency * (1 + (np.arange(n) + 1) / (n + 1))

    def condition(self, constants: ProblemConstants) -> Condition:
        """DF strictly diagonally dominant, and steps that resolve the cost's fastest ripple: Θ 4ω < π.

        For quadratic games on continuous time the first is the paper's assumption, under which the averaged loop is
        exponentially stable; the strategies then stay within O(a + 1/ω) of the equilibrium.
        """
        jacobian = constants.jacobian
        off = np.abs(jacobian).sum(axis=1) - np.abs(jacobian.diagonal())
        dominance = (jacobian.diagonal() - off).min()
        return decisive(
            Condition.below("Θ resolves the probing: 4 ω Θ < π", 4 * self.frequency * constants.largest_step, np.pi),
            Condition.above(
                "dF is diagonally dominant: min_i (F_ii − Σ_j |F_ij|) > 0", dominance, 0.0, exact=constants.exact
            ),
        )

    def _initial_memory(self, rows: int) -> FloatArray:
        # τ, η (NaN before the first cost), then μ per component.
        return np.hstack([np.zeros((rows, 1)), np.full((rows, 1), np.nan), np.zeros((rows, self.layout.dimension))])

    def _inputs(self, reading: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        time, mean, dither = memory[:, :1], memory[:, 1:2], memory[:, 2:]
        own = self.layout.own_mask[reading.player]
        cost = reading.own_payoff
        mean = np.where(np.isnan(mean), cost, mean) if self.washout else np.zeros_like(cost)
        descent = -reading.theta * self.gain * dither * (cost - mean)
        later = time + reading.theta
        next_dither = np.where(own, self.amplitude * np.sin(self.frequencies * later), 0.0)
        # The washout's exact step under a held cost is stable for every Θ.
        next_mean = mean - np.expm1(-self.washout * reading.theta) * (cost - mean)
        moves = per_step(descent + next_dither - dither, reading) / reading.unit
        followed = self.kappa * grounded_error(self.layout, reading)
        return np.where(own, moves, followed), np.hstack([later, next_mean, next_dither])
