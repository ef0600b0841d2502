"""Ye & Hu's laws, grounded in the neighbours' real strategies: a fixed gain (2017), and gains that adapt (2021)."""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import FloatArray, require_non_negative
from ptne_env.laws.base import Condition, Law, ProblemConstants, consensus, decisive, strong_monotonicity
from ptne_env.observation import Observation, ObservationLayout


class Grounded(Law):
    """e^i_i = 0; for j ≠ i, e^i_j = −κ [Σ_k a_ik (x^i_j − x^k_j) + a_ij (x^i_j − x^j_j)].

    M. Ye and G. Hu, "Distributed Nash equilibrium seeking by a consensus based approach", IEEE Transactions on
    Automatic Control 62(9), 2017, in effective time. A strategy follows its own gradient alone, and the estimates of it
    are leader–follower consensus with the player itself as the leader.

    Args:
        layout: of the environment.
        kappa: κ ≥ 0.

    Raises:
        ValueError: for a negative gain.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)

    def condition(self, constants: ProblemConstants) -> Condition:
        """κ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ, with λ the smallest eigenvalue of the grounded Laplacians.

        The paper proves that a large enough κ exists (there 1/δ). This one is enough, for d/dτ ½(‖x − x*‖² + ‖y‖²), y
        being the estimates minus what they estimate, is at most −ε a² + (ι + √(N−1) ι_F) a b − (κ λ − √(N−1) ι) b²
        with a = ‖x − x*‖ and b = ‖y‖.
        """
        grounded, bound = _grounded_connectivity(constants), np.inf
        if constants.epsilon > 0 and grounded > 0:
            others = np.sqrt(constants.num_players - 1)
            cross = constants.iota_estimates + others * constants.iota_strategies
            bound = (cross**2 / (4 * constants.epsilon) + others * constants.iota_estimates) / grounded
        name = "κ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ"
        return Condition.above(name, self.kappa, bound, exact=constants.exact)

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        own = self.layout.own_mask[reading.player]
        return np.where(own, -reading.gradient, self.kappa * grounded_error(self.layout, reading)), memory


class AdaptiveGrounded(Law):
    """e^i_j = −θ_ij ξ_ij, dθ_ij/dτ = γ ‖ξ_ij‖² with ξ_ij = Σ_k a_ik (x^i_j − x^k_j) + a_ij (x^i_j − x^j_j); e^i_i = 0.

    M. Ye and G. Hu, "Adaptive approaches for fully distributed Nash equilibrium seeking in networked games",
    Automatica, 2021: the node-based law, in effective time. Every player tunes the weights of its own consensus
    errors, one per component, so no gain must be known. The gains are memory and take Euler steps of Θ_k. (The
    edge-based law of that paper is of the kind of :class:`~ptne_env.laws.Adaptive`.)

    Args:
        layout: of the environment.
        gamma: γ ≥ 0.
        initial_gain: θ_ij(0) ≥ 0.

    Raises:
        ValueError: for a negative gain.
    """

    def __init__(self, layout: ObservationLayout, gamma: float = 0.01, initial_gain: float = 0.5) -> None:
        super().__init__(layout)
        self.gamma = require_non_negative("gamma", gamma)
        self.initial_gain = require_non_negative("initial_gain", initial_gain)

    def condition(self, constants: ProblemConstants) -> Condition:
        """γ > 0, ε > 0 and every graph connected: with H the grounded Laplacian, V = ½‖x − x*‖² + ½ yᵀ H y + gains."""
        positive = Condition.above("the gains adapt: γ > 0", self.gamma, 0.0)
        grounded = Condition.above("every graph is connected: λ2 > 0", constants.connectivity, 0.0)
        return decisive(positive, grounded, strong_monotonicity(constants))

    def gains(self, memory: FloatArray) -> FloatArray:
        """θ_ij of every player and component that it does not own."""
        return np.asarray(memory[~self.layout.own_mask])

    def _initial_memory(self, rows: int) -> FloatArray:
        return np.full((rows, self.layout.dimension), self.initial_gain)

    def _inputs(self, reading: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        error = grounded_error(self.layout, reading)
        own = self.layout.own_mask[reading.player]
        growth = self.gamma * error**2 * reading.unit**2
        inputs = np.where(own, -reading.gradient, memory * error)
        return inputs, memory + reading.theta * np.where(own, 0.0, growth)


def grounded_error(layout: ObservationLayout, reading: Observation) -> FloatArray:
    """−ξ_ij per component, shape (R, n)."""
    error = consensus(reading.weights, reading.relative_estimates)
    leaders = layout.neighbour_components[reading.player]
    error += np.einsum("rd,rdn,rdn->rn", reading.weights, reading.relative_estimates, leaders)
    return error


def _grounded_connectivity(constants: ProblemConstants) -> float:
    """The smallest eigenvalue of H_j = L without row and column j, plus diag(a_ij), over players j and modes."""
    if constants.connectivity == 0:
        return 0.0
    smallest = np.inf
    for laplacian in constants.laplacians:
        for leader in range(len(laplacian)):
            others = np.arange(len(laplacian)) != leader
            matrix = laplacian[np.ix_(others, others)] - np.diag(laplacian[others, leader])
            smallest = min(smallest, float(np.linalg.eigvalsh(matrix)[0]))
    return smallest
