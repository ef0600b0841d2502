"""The paper's static law (Theorem 1), and the same law without the time gain (Corollary 1)."""

from __future__ import annotations

from typing import Any

from ptne_env.laws.base import Law, consensus, step_length
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_non_negative, require_positive


def static_inputs(observation: Observation, kappa: Any, gradient_gain: Any = 1.0) -> FloatArray:
    """Return −g R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j), eq. (10) of the paper, shape (..., n)."""
    pull = consensus(observation.weights, observation.relative_estimates)
    inputs: FloatArray = kappa * pull - gradient_gain * observation.gradient
    return inputs


class Static(Law):
    """The static law of the paper (Theorem 1), :func:`static_inputs`.

    The dynamics of the environment supply the time gain c + 1/(T − t). With g ≠ 1 it is the law for the costs g J_i.

    Args:
        layout: the layout of the environment.
        kappa: κ ≥ 0.
        gradient_gain: g > 0.

    Raises:
        ValueError: for a gain out of range.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, gradient_gain: float = 1.0) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)
        self.gradient_gain = require_positive("gradient_gain", gradient_gain)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return static_inputs(observation, self.kappa, self.gradient_gain), memory


class CorollaryOne(Static):
    """The static law without the time gain (Corollary 1).

    u^i = (Δt_k/Θ_k) (−R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j)). The environment multiplies every input by Θ_k, so
    the law divides by it. Corollary 1 prints e^i − e^j where x^i − x^j is meant (docs/errata.md, 5). At κ = 1 it is
    the law of D. Gadjov and L. Pavel, "A passivity-based approach to Nash equilibrium seeking over networks", IEEE
    Transactions on Automatic Control 64(3), 2019 (arXiv:1705.02424).

    Args:
        layout: the layout of the environment.
        kappa: κ ≥ 0.

    Raises:
        ValueError: for a negative gain.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 10.0) -> None:
        super().__init__(layout, kappa)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        inputs, _ = super().inputs(observation, memory)
        return inputs * (observation.dt / step_length(observation)), memory
