"""Engineering variants of the paper's static law: locally implicit steps, and a capped time gain."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ptne_env.laws.base import Law, step_length
from ptne_env.laws.static import Static, static_inputs
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_non_negative, require_positive


def locally_implicit_inputs(
    observation: Observation, layout: ObservationLayout, kappa: float, damping: float, curvature: float
) -> FloatArray:
    """(1 + Θ D^i) u^i = −R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j), D^i = δ κ Σ_j a_ij + m R_i^T R_i.

    The static law with an implicit step on the diagonal: every player solves for its own next estimates alone, with its
    own degree, and with m in place of its own curvature, which it does not observe. As Θ → 0 it is the static law, its
    equilibria are the same, and however long the step, the estimates move by no more than D⁻¹ times the static input.

    For affine games on a fixed graph the sampled loop is x ← x − (1/Θ + D)⁻¹ M (x − 1⊗x*). Consensus alone (no game) is
    stable for every sequence of steps when δ ≥ 1, because L ⪯ 2 diag(Σ_j a_ij) makes 𝐱ᵀ L 𝐱 a Lyapunov function.
    With κ = ``kappa``, δ = ``damping`` and m = ``curvature``.
    """
    degree = np.einsum("rd->r", observation.weights)[:, None]
    own = layout.own_mask[observation.player]
    return static_inputs(observation, kappa) / (1 + observation.theta * (damping * kappa * degree + curvature * own))


def capped_gain_inputs(observation: Observation, kappa: float, largest_gain: float) -> FloatArray:
    """u^i = min(1, G Δt_k/Θ_k) times the static input: the time gain g(t) = c + 1/λ'(s), capped at G in 1/s.

    No velocity exceeds G‖u‖. It is Corollary 1 in the time ∫ min(g, G) dt ≤ τ: for the paper's λ,
    cT + 1 + ln((G − c)T) instead of τ → ∞, so convergence is no longer exact at T. At G = 1 it is
    :func:`~ptne_env.laws.static.corollary_one_inputs`.
    """
    share = np.minimum(1.0, largest_gain * observation.dt / step_length(observation))
    return static_inputs(observation, kappa) * share


class LocallyImplicit(Law):
    """The static law with locally implicit steps, :func:`locally_implicit_inputs`.

    Args:
        layout: of the environment.
        kappa: κ ≥ 0.
        damping: δ ≥ 1.
        curvature: m > 0; at least the largest own curvature ∂²J_i/∂x_i² of the game.

    Raises:
        ValueError: for a parameter out of range.
    """

    def __init__(
        self, layout: ObservationLayout, kappa: float = 2.0, damping: float = 1.0, curvature: float = 3.0
    ) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)
        self.damping = require_positive("damping", damping)
        self.curvature = require_positive("curvature", curvature)
        if self.damping < 1:
            raise ValueError(f"damping must be at least 1, got {damping!r}")

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return locally_implicit_inputs(observation, self.layout, self.kappa, self.damping, self.curvature), memory


class CappedGain(Static):
    """The static law with a capped time gain, :func:`capped_gain_inputs`.

    Args:
        layout: of the environment, action mode ``input``.
        kappa: κ ≥ 0.
        largest_gain: G > 0 in 1/s.

    Raises:
        ValueError: for a parameter out of range.
    """

    acts_through_gains: ClassVar[bool] = False

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, largest_gain: float = 200.0) -> None:
        super().__init__(layout, kappa)
        self.largest_gain = require_positive("largest_gain (G, in 1/s)", largest_gain)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return capped_gain_inputs(observation, self.kappa, self.largest_gain), memory
