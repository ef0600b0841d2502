"""Nash equilibrium seeking from payoffs alone."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ptne_env.laws.base import Law, per_step
from ptne_env.laws.grounded import grounded_error
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_non_negative, require_positive


def extremum_seeking_inputs(
    observation: Observation,
    memory: FloatArray,
    layout: ObservationLayout,
    amplitude: float,
    gain: float,
    frequencies: FloatArray,
    washout: float,
    kappa: float,
) -> tuple[FloatArray, FloatArray]:
    """x_i = x̂_i + μ_i, dx̂_i/dτ = −k μ_i (J_i(x) − η_i), μ_i = a sin ω_i τ, dη_i/dτ = ω_h (J_i − η_i).

    P. Frihauf, M. Krstić and T. Başar, "Nash equilibrium seeking in noncooperative games", IEEE Transactions on
    Automatic Control 57(5), 2012, for costs instead of payoffs and in effective time. A player probes with a sinusoid
    and correlates it with its own cost, so on average dx̂_i/dτ = −(k a²/2) ∂J_i/∂x_i. η is a washout of the cost's
    mean. The strategies use neither gradients nor estimates; the estimates of the other strategies follow the
    neighbours as in :func:`~ptne_env.laws.grounded.grounded_inputs`, for metrics that measure them.

    With a = ``amplitude``, k = ``gain``, ω_c = ``frequencies`` per component in 1/τ, shape (n,), and ω_h = ``washout``
    in 1/τ, 0 for none. The memory is τ, η (NaN before the first cost) and μ per component, shape (R, 2 + n).
    """
    time, mean, dither = memory[:, :1], memory[:, 1:2], memory[:, 2:]
    own = layout.own_mask[observation.player]
    cost = observation.own_payoff
    mean = np.where(np.isnan(mean), cost, mean) if washout else np.zeros_like(cost)
    descent = -observation.theta * gain * dither * (cost - mean)
    later = time + observation.theta
    next_dither = np.where(own, amplitude * np.sin(frequencies * later), 0.0)
    # The washout's exact step under a held cost is stable for every Θ.
    next_mean = mean - np.expm1(-washout * observation.theta) * (cost - mean)
    moves = per_step(descent + next_dither - dither, observation) / observation.unit
    followed = kappa * grounded_error(observation, layout)
    return np.where(own, moves, followed), np.hstack([later, next_mean, next_dither])


class ExtremumSeeking(Law):
    """Frihauf, Krstić and Başar's extremum seeking, :func:`extremum_seeking_inputs`.

    Frequencies ω_c = ω (1 + (c + 1)/(n + 1)) per component c lie strictly between ω and 2ω and are all different, so
    ω_i ≠ ω_j, 2ω_i ≠ ω_j and ω_i ≠ ω_j + ω_k. They depend on the player's number, so relabelling players changes them.

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

    needs: ClassVar[tuple[str, ...]] = ("own_payoff",)
    interface: ClassVar[Interface] = Interface(own_payoff=True)

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

    def initial_memory(self, rows: int) -> FloatArray:
        """τ = 0, η = NaN and μ = 0, shape (R, 2 + n)."""
        return np.hstack([np.zeros((rows, 1)), np.full((rows, 1), np.nan), np.zeros((rows, self.layout.dimension))])

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        return extremum_seeking_inputs(
            observation, memory, self.layout, self.amplitude, self.gain, self.frequencies, self.washout, self.kappa
        )
