"""Engineering variants of the paper's static law: locally implicit steps, and a capped time gain."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from ptne_env.arrays import FloatArray, require_non_negative, require_positive
from ptne_env.laws.base import Condition, Law, ProblemConstants, consensus, decisive
from ptne_env.laws.static import Static
from ptne_env.observation import Observation, ObservationLayout


class LocallyImplicit(Law):
    """(1 + Θ D^i) u^i = −R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j), D^i = δ κ Σ_j a_ij + m R_i^T R_i.

    The static law with an implicit step on the diagonal: every player solves for its own next estimates alone, with its
    own degree, and with m in place of its own curvature, which it does not observe. As Θ → 0 it is the static law, its
    equilibria are the same, and however long the step, the estimates move by no more than D⁻¹ times the static input.

    For affine games on a fixed graph the sampled loop is x ← x − (1/Θ + D)⁻¹ M (x − 1⊗x*). It contracts in the norm of
    1/Θ + D for *every* constant Θ where Mᵀ D⁻¹ M ≺ M + Mᵀ, which is :meth:`condition`: that norm changes by
    −eᵀ(M + Mᵀ)e + eᵀMᵀ(1/Θ + D)⁻¹Me. This needs M + Mᵀ ≻ 0, so a κ that satisfies :class:`FixedGain`'s condition is
    enough for that half; for other κ, for graphs that switch and steps that vary it proves nothing. Consensus alone
    (no game) is stable for every sequence of steps when δ ≥ 1, for L ⪯ 2 diag(Σ_j a_ij) makes 𝐱ᵀ L 𝐱 a Lyapunov
    function.

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

    def implicit_diagonal(self, constants: ProblemConstants, laplacian: FloatArray) -> FloatArray:
        """The diagonal of D in the paper's stacking col(x^1 … x^N), shape (Nn,)."""
        own = constants.owners == np.arange(constants.num_players)[:, None]
        return np.ravel(self.damping * self.kappa * laplacian.diagonal()[:, None] + self.curvature * own)

    def condition(self, constants: ProblemConstants) -> Condition:
        """Stable for every constant Θ: the largest generalised eigenvalue of (Mᵀ D⁻¹ M, M + Mᵀ) is below 1."""
        fixed = Condition.below("the graph is fixed: number of modes < 2", len(constants.laplacians), 2.0)
        laplacian, value = constants.laplacians[0], np.inf
        matrix, diagonal = constants.loop(laplacian, self.kappa), self.implicit_diagonal(constants, laplacian)
        symmetric = matrix + matrix.T
        if diagonal.min() > 0 and np.linalg.eigvalsh(symmetric)[0] > 0:
            value = float(linalg.eigh(matrix.T @ (matrix / diagonal[:, None]), symmetric, eigvals_only=True)[-1])
        name = "stable for every Θ: λ_max(Mᵀ D⁻¹ M, M + Mᵀ) < 1"
        return decisive(fixed, Condition.below(name, value, 1.0, exact=constants.exact))

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        inputs = self.kappa * consensus(reading.weights, reading.relative_estimates) - reading.gradient
        degree = np.einsum("rd->r", reading.weights)[:, None]
        own = self.layout.own_mask[reading.player]
        inputs /= 1 + reading.theta * (self.damping * self.kappa * degree + self.curvature * own)
        return inputs, memory


class CappedGain(Static):
    """The static law with the time gain g(t) = c + 1/λ'(s) capped: dx^i/dt = min(g(t), G) u^i.

    The environment multiplies every input by Θ_k, so the law asks for u·min(1, G Δt_k/Θ_k). No velocity exceeds G‖u‖,
    and what acts is Corollary 1 in the time ∫ min(g, G) dt ≤ τ: for the paper's λ, cT + 1 + ln((G − c)T) instead of
    τ → ∞, so convergence is no longer exact at T. At G = 1 it is :class:`~ptne_env.laws.CorollaryOne`.

    Args:
        layout: of the environment, action mode ``input``.
        kappa: κ ≥ 0.
        largest_gain: G > 0 in 1/s.

    Raises:
        ValueError: for a parameter out of range.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, largest_gain: float = 200.0) -> None:
        super().__init__(layout, kappa)
        self.largest_gain = require_positive("largest_gain (G, in 1/s)", largest_gain)

    def condition(self, constants: ProblemConstants) -> Condition:
        """The static law's, and G > c, below which even the constant part of the gain is cut."""
        constant = Condition.above("the cap leaves c: G > c", self.largest_gain, constants.gain)
        return decisive(constant, super().condition(constants))

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        inputs, memory = super()._inputs(reading, memory)
        over = reading.theta == 0  # the terminal observation, from which nobody acts
        inputs *= np.minimum(1.0, self.largest_gain * reading.dt / np.where(over, 1.0, reading.theta))
        return inputs, memory

    def _acts_through_gains(self) -> bool:
        return False
