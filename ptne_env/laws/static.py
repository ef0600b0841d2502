"""The paper's static law (Theorem 1) and the same law without the time gain (Corollary 1)."""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import Float32Array, FloatArray, require_non_negative, require_positive
from ptne_env.laws.base import Condition, Law, ProblemConstants, consensus
from ptne_env.observation import CONSENSUS_GAIN, GAIN_OCTAVES, Observation, ObservationLayout


class Static(Law):
    """u^i = −R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j) (eq. PrescribedTimeAlgorithm, Theorem 1).

    The environment's dynamics supply the gain c + 1/(T − t). Through action mode ``gains`` it asks for its two gains,
    which must lie within a factor 8 of 1 and of 2.

    Args:
        layout: of the environment.
        kappa: κ ≥ 0.
        gradient_gain: factor on the own gradient; other than 1 it is the same law for scaled costs.

    Raises:
        ValueError: for a negative gain, or one out of reach in action mode ``gains``.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, gradient_gain: float = 1.0) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)
        self.gradient_gain = require_positive("gradient_gain", gradient_gain)
        if layout.interface.action_mode == "gains":
            wanted = np.array([self.gradient_gain, self.kappa / CONSENSUS_GAIN])
            with np.errstate(divide="ignore"):  # κ = 0 is out of reach and refused below
                self._gain_action = np.log2(wanted) / GAIN_OCTAVES
            if np.abs(self._gain_action).max() > 1:
                raise ValueError(
                    f"action mode 'gains' reaches gradient gains in [1/8, 8] and kappa in [1/4, 16], got "
                    f"{gradient_gain} and {kappa}"
                )

    def condition(self, constants: ProblemConstants) -> Condition:
        """κ > (ι²/ε + ι)/λ2 (eq. GainCondition), for scaled costs with κ divided by the gradient gain."""
        return _gain_condition(self.kappa / self.gradient_gain, constants)

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        inputs = consensus(reading.weights, reading.relative_estimates)
        inputs *= self.kappa
        inputs -= self.gradient_gain * reading.gradient
        return inputs, memory

    def _actions(self, inputs: FloatArray, reading: Observation) -> Float32Array:
        if self.layout.interface.action_mode == "gains":
            return np.tile(self._gain_action.astype(np.float32), (len(inputs), 1))
        return super()._actions(inputs, reading)

    def _acts_through_gains(self) -> bool:
        return True


class FixedGain(Static):
    """u^i = −R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j) with Bianchi and Grammatico's condition on κ.

    M. Bianchi and S. Grammatico, "Continuous-time fully distributed generalized Nash equilibrium seeking for
    multi-integrator agents", Automatica, 2021: their controller with a fixed gain for single integrators, without
    constraints and in effective time. It is the static law; their condition is weaker than eq. GainCondition.

    It holds exactly where the bound [[ε/N, −(ι_F + ι)/(2√N)], [·, κ λ2 − ι]] of the loop on consensus and
    disagreement is positive definite, and then (𝐱 − 1⊗x*)ᵀ M (𝐱 − 1⊗x*) > 0.
    """

    def condition(self, constants: ProblemConstants) -> Condition:
        """κ > ((ι_F + ι)²/(4ε) + ι)/λ2, with κ divided by the gradient gain."""
        bound = np.inf
        if constants.epsilon > 0 and constants.connectivity > 0:
            total = constants.iota_strategies + constants.iota_estimates
            bound = (total**2 / (4 * constants.epsilon) + constants.iota_estimates) / constants.connectivity
        kappa = self.kappa / self.gradient_gain
        return Condition.above("κ > ((ι_F + ι)²/(4ε) + ι)/λ2", kappa, bound, exact=constants.exact)


class CorollaryOne(Law):
    """dx^i/dt = −R_i^T ∂J_i/∂x_i(x^i) − κ Σ_j a_ij (x^i − x^j): the static law without the time gain (Corollary 1).

    The paper prints e^i − e^j where x^i − x^j is meant (docs/errata.md, 5). At κ = 1 it is Gadjov and Pavel's law.
    The environment multiplies every input by Θ_k, so the law undoes that gain: it asks for u·Δt_k/Θ_k.

    Args:
        layout: of the environment.
        kappa: κ ≥ 0.

    Raises:
        ValueError: for a negative gain.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 10.0) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)

    def condition(self, constants: ProblemConstants) -> Condition:
        """κ > (ι²/ε + ι)/λ2 (eq. GainCondition); convergence is asymptotic, not by the deadline."""
        return _gain_condition(self.kappa, constants)

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        inputs = self.kappa * consensus(reading.weights, reading.relative_estimates) - reading.gradient
        over = reading.theta == 0  # the terminal observation, from which nobody acts
        inputs *= np.where(over, 0.0, reading.dt / np.where(over, 1.0, reading.theta))
        return inputs, memory


def gain_bound(epsilon: float, iota: float, connectivity: float) -> float:
    """(ι²/ε + ι)/λ2, which κ must exceed in Theorem 1 (eq. GainCondition); infinite when ε or λ2 is not positive."""
    return (iota**2 / epsilon + iota) / connectivity if epsilon > 0 and connectivity > 0 else np.inf


def _gain_condition(kappa: float, constants: ProblemConstants) -> Condition:
    bound = gain_bound(constants.epsilon, constants.iota, constants.connectivity)
    return Condition.above("κ > (ι²/ε + ι)/λ2", kappa, bound, exact=constants.exact)
