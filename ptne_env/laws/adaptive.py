"""The paper's fully distributed law: adaptive gains per link (Theorem 3), also over switching graphs (Theorem 4)."""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import FloatArray, require_non_negative
from ptne_env.laws.base import (
    Condition,
    Law,
    ProblemConstants,
    consensus,
    decisive,
    lasting_connectivity,
    strong_monotonicity,
)
from ptne_env.observation import Observation, ObservationLayout


class Adaptive(Law):
    """u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j κ_ij a_ij (x^i − x^j), dκ_ij/dτ = γ a_ij ‖x^i − x^j‖².

    Eqs. PrescribedTimeAlgorithmAdaptive and PrescribedTimeAlgorithmAdaptiveSwitching: on a scenario whose graph
    switches, a_ij is the active graph's and this is the paper's switching law. The gains κ_ij are the law's memory, one
    per neighbour slot, and take an Euler step of Θ_k like the estimates. Both ends of a link see the same differences,
    so κ_ij = κ_ji needs no message.

    Args:
        layout: of the environment.
        gamma: γ_ij ≥ 0, the same on all links. The paper does not give it; 0.1 needs Θ ≲ 0.04 to stay stable.
        initial_gain: κ_ij(0) ≥ 0.

    Raises:
        ValueError: for a negative gain.
    """

    def __init__(self, layout: ObservationLayout, gamma: float = 0.01, initial_gain: float = 0.5) -> None:
        super().__init__(layout)
        self.gamma = require_non_negative("gamma", gamma)
        self.initial_gain = require_non_negative("initial_gain", initial_gain)

    def condition(self, constants: ProblemConstants) -> Condition:
        """ε > 0, and the graphs that act as s → ∞ are (jointly) connected (Theorems 3 and 4); γ > 0 on all links."""
        positive = Condition.above("the gains adapt: γ > 0", self.gamma, 0.0)
        return decisive(positive, lasting_connectivity(constants), strong_monotonicity(constants))

    def gains(self, memory: FloatArray) -> FloatArray:
        """κ_ij of every link, in both directions."""
        neighbours = np.array(self.layout.neighbours)
        return np.asarray(memory[neighbours != np.arange(len(neighbours))[:, None]])

    def _initial_memory(self, rows: int) -> FloatArray:
        return np.full((rows, self.layout.slots), self.initial_gain)

    def _inputs(self, reading: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        inputs = consensus(memory * reading.weights, reading.relative_estimates) - reading.gradient
        squared = np.einsum("rdn,rdn->rd", reading.relative_estimates, reading.relative_estimates)
        growth = self.gamma * reading.weights * squared * reading.unit**2
        return inputs, memory + reading.theta * growth


class AveragingIntegral(Adaptive):
    """u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j k_ij a_ij (x^i − x^j), dk_ij/dτ = γ a_ij ‖x^i − x^j‖², k_ij(0) = 0.

    C. De Persis and S. Grammatico, "Distributed averaging integral Nash equilibrium seeking on networks", Automatica,
    2019, in effective time: integral controllers tune the weights of the links, so neither λ2 nor ι is needed. The
    paper's adaptive law is this one in its own time, and here they are one law; only the initial gains differ.

    Args:
        layout: of the environment.
        gamma: γ > 0, the same on all links.
        initial_gain: k_ij(0) ≥ 0.
    """

    def __init__(self, layout: ObservationLayout, gamma: float = 0.01, initial_gain: float = 0.0) -> None:
        super().__init__(layout, gamma, initial_gain)
