"""The paper's law with adaptive gains per link (Theorem 3), also over switching graphs (Theorem 4)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptne_env.laws.base import Law, consensus
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, array_namespace, require_non_negative


def adaptive_inputs(observation: Observation, gains: FloatArray, gamma: Any) -> tuple[FloatArray, FloatArray]:
    """Return the inputs (..., n) of the adaptive law, and the next gains κ_ij (..., D) after an Euler step.

    u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j κ_ij a_ij (x^i − x^j) and dκ_ij/dτ = γ a_ij ‖x^i − x^j‖², eqs. (36) and (47).
    """
    differences = observation.relative_estimates
    inputs = consensus(gains * observation.weights, differences) - observation.gradient
    squared = array_namespace(differences).einsum("...dn,...dn->...d", differences, differences)
    growth = gamma * observation.weights * squared * observation.unit**2
    return inputs, gains + observation.theta * growth


class AdaptiveLaw(Law):
    """A law that remembers gains, which adapt.

    Args:
        layout: the layout of the environment.
        gamma: γ ≥ 0, the rate of adaptation. The paper does not give it; 0.1 needs Θ ≲ 0.04 to stay stable.
        initial_gain: every gain at t = 0, ≥ 0.

    Raises:
        ValueError: for a negative number.
    """

    def __init__(self, layout: ObservationLayout, gamma: float = 0.01, initial_gain: float = 0.5) -> None:
        super().__init__(layout)
        self.gamma = require_non_negative("gamma", gamma)
        self.initial_gain = require_non_negative("initial_gain", initial_gain)


class Adaptive(AdaptiveLaw):
    """The adaptive law of the paper (Theorem 3; over switching graphs, Theorem 4), :func:`adaptive_inputs`.

    On a switching topology a_ij is that of the active graph. The gains take an Euler step of Θ_k like the estimates.
    Both ends of a link see the same differences, so κ_ij = κ_ji needs no message. The memory is κ_ij per neighbour
    slot, shape (R, D), in natural units; γ is the same on all links.
    """

    def initial_memory(self, rows: int) -> FloatArray:
        """Return κ_ij(0) per neighbour slot, shape (R, D)."""
        return np.full((rows, self.layout.slots), self.initial_gain)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        return adaptive_inputs(observation, memory, self.gamma)

    def gains(self, memory: FloatArray) -> FloatArray:
        """Return κ_ij of every link, in both directions."""
        neighbours = np.array(self.layout.neighbours)
        return np.asarray(memory[neighbours != np.arange(len(neighbours))[:, None]])
