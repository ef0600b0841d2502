"""Rules of the field that need more than a player observes: best responses, norms of F, gains two links away."""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import FloatArray, require_non_negative, require_positive
from ptne_env.laws.base import (
    Condition,
    Law,
    ProblemConstants,
    consensus,
    decisive,
    per_step,
    strong_monotonicity,
)
from ptne_env.observation import Interface, Observation, ObservationLayout


class BestResponseOracle(Law):
    """x_i ← x_i + ω (BR_i(x_{−i}) − x_i): all players at once, with relaxation ω; ω = 1 is best-response play.

    An oracle: a player would need its cost function and everybody's real strategies. Estimates are set to them within
    the step. See T. Başar and G. J. Olsder, "Dynamic Noncooperative Game Theory", SIAM 1999, chapter 4.

    Args:
        layout: with :attr:`interface`.
        relaxation: ω in (0, 1].

    Raises:
        ValueError: for another interface, or a relaxation out of range.
    """

    needs_full_information = True
    needs = ("best_response",)
    interface = Interface("full", best_response=True)

    def __init__(self, layout: ObservationLayout, relaxation: float = 1.0) -> None:
        super().__init__(layout)
        self.relaxation = require_positive("relaxation", relaxation)
        if self.relaxation > 1:
            raise ValueError(f"relaxation must be at most 1, got {relaxation!r}")

    def condition(self, constants: ProblemConstants) -> Condition:
        """ρ(I − ω D⁻¹ dF) < 1 with D the own blocks of dF: for affine games, exactly where it converges."""
        own = constants.owners[:, None] == constants.owners
        matrix = np.linalg.solve(np.where(own, constants.jacobian, 0.0), constants.jacobian)
        radius = np.abs(np.linalg.eigvals(np.eye(len(own)) - self.relaxation * matrix)).max()
        return Condition.below("ρ(I − ω D⁻¹ dF) < 1", radius, 1.0, exact=constants.exact)

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        return per_step(reading.relative_strategies + self.relaxation * reading.best_response, reading), memory


class FixedTimeOracle(Law):
    """dx/dτ = −k F(x) (‖F(x)‖^{−ξ1} + ‖F(x)‖^{−ξ2}), ξ1 in (0, 1), ξ2 < 0: fixed-time pseudo-gradient play.

    J. I. Poveda, M. Krstić and T. Başar, "Fixed-time Nash equilibrium seeking in time-varying networks", IEEE
    Transactions on Automatic Control 68(4), 2023: the first-order world. An oracle: the norm is that of everybody's
    gradients at the real strategies, onto which the estimates are moved within the step.

    With F ε-strongly monotone, d‖F‖/dτ ≤ −k ε (‖F‖^{1−ξ1} + ‖F‖^{1−ξ2}), so F = 0 from τ = (1/ξ1 + 1/|ξ2|)/(k ε) on,
    wherever the start is. The factor of F is infinite at F = 0 and grows with F, so a sampled step limits it:
    Θ·factor ≤ ``largest_step``, within which the law is pseudo-gradient play with that step.

    Args:
        layout: with the interface ``full``.
        gain: k > 0.
        near: ξ1.
        far: ξ2.
        largest_step: > 0; below 2ε/ι_F² the limited steps contract.

    Raises:
        ValueError: for another interface, or a parameter out of range.
    """

    needs_full_information = True
    interface = Interface("full")

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

    def settling_bound(self, epsilon: float) -> float:
        """(1/ξ1 + 1/|ξ2|)/(k ε), in effective time."""
        return (1 / self.near - 1 / self.far) / (self.gain * epsilon) if epsilon > 0 else np.inf

    def condition(self, constants: ProblemConstants) -> Condition:
        """ε > 0, limited steps that contract, and a settling bound within the episode."""
        contracts = 2 * constants.epsilon / constants.iota_strategies**2
        return decisive(
            strong_monotonicity(constants),
            Condition.below("limited steps contract: largest step < 2ε/ι_F²", self.largest_step, contracts),
            Condition.below(
                "(1/ξ1 + 1/|ξ2|)/(k ε) < τ_K",
                self.settling_bound(constants.epsilon),
                constants.effective_time,
                exact=constants.exact,
            ),
        )

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        norm = np.sqrt(np.einsum("rn,rn->r", reading.pseudo_gradient, reading.pseudo_gradient))[:, None]
        with np.errstate(divide="ignore"):
            factor = self.gain * (norm**-self.near + norm**-self.far)
        step = np.minimum(reading.theta * factor, self.largest_step)
        return per_step(reading.relative_strategies - step * reading.pseudo_gradient, reading), memory


class NodeAdaptiveOracle(Law):
    """u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j a_ij (k_i ρ^i − k_j ρ^j), dk_i/dτ = γ ‖ρ^i‖², ρ^i = Σ_j a_ij (x^i − x^j).

    M. Bianchi and S. Grammatico, "Continuous-time fully distributed generalized Nash equilibrium seeking for
    multi-integrator agents", Automatica, 2021: their controller with adaptive gains of the nodes, for single
    integrators, without constraints and in effective time. There neighbours tell each other k_j ρ^j, and ρ^j holds
    estimates from two links away, which no player here hears: an oracle. The neighbours' gains k_j follow from ρ^j and
    are memory like the own one.

    Args:
        layout: with :attr:`interface`.
        gamma: γ ≥ 0.
        initial_gain: k_i(0) ≥ 0.

    Raises:
        ValueError: for another interface, or a negative gain.
    """

    needs_full_information = True
    needs = ("neighbour_errors",)
    interface = Interface("full", neighbour_errors=True)

    def __init__(self, layout: ObservationLayout, gamma: float = 0.001, initial_gain: float = 0.5) -> None:
        super().__init__(layout)
        self.gamma = require_non_negative("gamma", gamma)
        self.initial_gain = require_non_negative("initial_gain", initial_gain)

    def condition(self, constants: ProblemConstants) -> Condition:
        """γ > 0, ε > 0 and every graph connected; neither ι nor λ2 need be known."""
        positive = Condition.above("the gains adapt: γ > 0", self.gamma, 0.0)
        connected = Condition.above("every graph is connected: λ2 > 0", constants.connectivity, 0.0)
        return decisive(positive, connected, strong_monotonicity(constants))

    def _initial_memory(self, rows: int) -> FloatArray:
        return np.full((rows, 1 + self.layout.slots), self.initial_gain)

    def _inputs(self, reading: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        error = -consensus(reading.weights, reading.relative_estimates)
        errors = np.concatenate([error[:, None], reading.neighbour_errors], axis=1)  # (R, 1 + D, n), the own one first
        weighted = memory[:, :, None] * errors
        inputs = consensus(reading.weights, weighted[:, 1:] - weighted[:, :1]) - reading.gradient
        growth = self.gamma * np.einsum("rdn,rdn->rd", errors, errors)
        return inputs, memory + reading.theta * growth
