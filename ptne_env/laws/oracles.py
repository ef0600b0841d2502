"""Oracles, laws that use information players lack: real strategies, best responses, consensus errors two links away."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_non_negative, require_positive


def centralised_inputs(observation: Observation, gradient_gain: float) -> FloatArray:
    """u^i = (x − x^i)/Θ − g F(x): pseudo-gradient play dx/dτ = −g F(x) on the real strategies x.

    Every player knows the real strategies and moves its estimates onto them within the step.
    """
    return per_step(observation.relative_strategies, observation) - gradient_gain * observation.pseudo_gradient


def best_response_inputs(observation: Observation, relaxation: float) -> FloatArray:
    """x_i ← x_i + ω (BR_i(x_{−i}) − x_i): all players at once, with relaxation ω; ω = 1 is best-response play.

    T. Başar and G. J. Olsder, "Dynamic Noncooperative Game Theory", SIAM 1999, chapter 4. The estimates are moved onto
    the new strategies within the step.
    """
    return per_step(observation.relative_strategies + relaxation * observation.best_response, observation)


def fixed_time_inputs(
    observation: Observation, gain: float, near: float, far: float, largest_step: float
) -> FloatArray:
    """dx/dτ = −k F(x) (‖F(x)‖^{−ξ1} + ‖F(x)‖^{−ξ2}), ξ1 in (0, 1), ξ2 < 0: fixed-time pseudo-gradient play.

    J. I. Poveda, M. Krstić and T. Başar, "Fixed-time Nash equilibrium seeking in time-varying networks", IEEE
    Transactions on Automatic Control 68(4), 2023: the first-order law.

    With F ε-strongly monotone, d‖F‖/dτ ≤ −k ε (‖F‖^{1−ξ1} + ‖F‖^{1−ξ2}), so F = 0 from τ = (1/ξ1 + 1/|ξ2|)/(k ε) on,
    from every start. The factor of F is infinite at F = 0 and grows with F, so a sampled step limits it:
    Θ·factor ≤ ``largest_step``, within which the law is pseudo-gradient play with that step.

    With k = ``gain``, ξ1 = ``near`` and ξ2 = ``far``.
    """
    norm = np.sqrt(np.einsum("rn,rn->r", observation.pseudo_gradient, observation.pseudo_gradient))[:, None]
    with np.errstate(divide="ignore"):
        factor = gain * (norm**-near + norm**-far)
    step = np.minimum(observation.theta * factor, largest_step)
    return per_step(observation.relative_strategies - step * observation.pseudo_gradient, observation)


def node_adaptive_inputs(observation: Observation, memory: FloatArray, gamma: float) -> tuple[FloatArray, FloatArray]:
    """u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j a_ij (k_i ρ^i − k_j ρ^j), dk_i/dτ = γ ‖ρ^i‖², ρ^i = Σ_j a_ij (x^i − x^j).

    M. Bianchi and S. Grammatico, "Continuous-time fully distributed generalized Nash equilibrium seeking for
    multi-integrator agents", Automatica, 2021: their controller with adaptive gains of the nodes, for single
    integrators, without constraints and in effective time. There neighbours send each other k_j ρ^j, which holds
    estimates from two links away; no message of this environment carries them.

    The memory is k_i and the k_j of the neighbours, which follow from ρ^j, shape (R, 1 + D); it takes an Euler step of
    Θ_k.
    """
    error = -consensus(observation.weights, observation.relative_estimates)
    errors = np.concatenate([error[:, None], observation.neighbour_errors], axis=1)  # (R, 1 + D, n), the own one first
    weighted = memory[:, :, None] * errors
    inputs = consensus(observation.weights, weighted[:, 1:] - weighted[:, :1]) - observation.gradient
    growth = gamma * np.einsum("rdn,rdn->rd", errors, errors)
    return inputs, memory + observation.theta * growth


class Oracle(Law):
    """A law that uses information players lack.

    It needs the interface ``full``, which ``parallel_env`` refuses, and every table marks it. The input limit is that
    of every policy.
    """

    needs_full_information: ClassVar[bool] = True
    interface: ClassVar[Interface] = Interface("full")


class CentralisedOracle(Oracle):
    """Pseudo-gradient play with full information, :func:`centralised_inputs`.

    Args:
        layout: with :attr:`interface`.
        gradient_gain: g > 0.

    Raises:
        ValueError: for another interface, or a gain that is not positive.
    """

    def __init__(self, layout: ObservationLayout, gradient_gain: float = 1.0) -> None:
        super().__init__(layout)
        self.gradient_gain = require_positive("gradient_gain", gradient_gain)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return centralised_inputs(observation, self.gradient_gain), memory


class BestResponseOracle(Oracle):
    """Best-response play, :func:`best_response_inputs`. Players lack the others' real strategies.

    Args:
        layout: with :attr:`interface`.
        relaxation: ω in (0, 1].

    Raises:
        ValueError: for another interface, or a relaxation out of range.
    """

    needs: ClassVar[tuple[str, ...]] = ("best_response",)
    interface: ClassVar[Interface] = Interface("full", best_response=True)

    def __init__(self, layout: ObservationLayout, relaxation: float = 1.0) -> None:
        super().__init__(layout)
        self.relaxation = require_positive("relaxation", relaxation)
        if self.relaxation > 1:
            raise ValueError(f"relaxation must be at most 1, got {relaxation!r}")

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return best_response_inputs(observation, self.relaxation), memory


class FixedTimeOracle(Oracle):
    """Fixed-time pseudo-gradient play, :func:`fixed_time_inputs`. Players lack the norm of all gradients.

    Args:
        layout: with :attr:`interface`.
        gain: k > 0.
        near: ξ1 in (0, 1).
        far: ξ2 < 0.
        largest_step: > 0; below 2ε/ι_F² the limited steps contract.

    Raises:
        ValueError: for another interface, or a parameter out of range.
    """

    def __init__(
        self,
        layout: ObservationLayout,
        gain: float = 1.0,
        near: float = 0.5,
        far: float = -0.5,
        largest_step: float = 0.3,
    ) -> None:
        super().__init__(layout)
        self.gain = require_positive("gain", gain)
        self.largest_step = require_positive("largest_step", largest_step)
        if not (0 < near < 1 and -np.inf < far < 0):
            raise ValueError(f"FixedTimeOracle needs near in (0, 1) and far < 0, got {near!r} and {far!r}")
        self.near, self.far = float(near), float(far)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return fixed_time_inputs(observation, self.gain, self.near, self.far, self.largest_step), memory


class NodeAdaptiveOracle(Oracle):
    """Bianchi and Grammatico's adaptive gains of the nodes, :func:`node_adaptive_inputs`.

    Args:
        layout: with :attr:`interface`.
        gamma: γ ≥ 0.
        initial_gain: k_i(0) ≥ 0.

    Raises:
        ValueError: for another interface, or a negative gain.
    """

    needs: ClassVar[tuple[str, ...]] = ("neighbour_errors",)
    interface: ClassVar[Interface] = Interface("full", neighbour_errors=True)

    def __init__(self, layout: ObservationLayout, gamma: float = 0.001, initial_gain: float = 0.5) -> None:
        super().__init__(layout)
        self.gamma = require_non_negative("gamma", gamma)
        self.initial_gain = require_non_negative("initial_gain", initial_gain)

    def initial_memory(self, rows: int) -> FloatArray:
        """k_i(0) of the player and of its neighbours, shape (R, 1 + D)."""
        return np.full((rows, 1 + self.layout.slots), self.initial_gain)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        return node_adaptive_inputs(observation, memory, self.gamma)
