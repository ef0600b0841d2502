"""Ye and Hu's laws, grounded in the neighbours' real strategies: a fixed gain (2017), and adaptive gains (2021)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ptne_env.laws.base import Law, consensus
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, array_namespace, require_non_negative, require_positive


def grounded_error(observation: Observation, leaders: BoolArray) -> FloatArray:
    """Return −ξ^i_j = Σ_k a_ik (x^k_j − x^i_j) + a_ij (x^j_j − x^i_j) of leader–follower consensus, shape (..., n).

    Player j, the owner of a component, leads the estimates of it.

    Args:
        observation: the observation of the players.
        leaders: whether the neighbour in a slot owns a component, shape (..., D, n).
    """
    error = consensus(observation.weights, observation.relative_estimates)
    error += consensus(observation.weights, observation.relative_estimates * leaders)
    return error


def grounded_inputs(
    observation: Observation, own: BoolArray, leaders: BoolArray, kappa: Any, gradient_gain: Any = 1.0
) -> FloatArray:
    """Return −δ ∂J_i/∂x_i(x^i) in the own components, and −κ ξ^i_j (:func:`grounded_error`) in others; (..., n)."""
    error = kappa * grounded_error(observation, leaders)
    inputs: FloatArray = array_namespace(error).where(own, -gradient_gain * observation.gradient, error)
    return inputs


class Grounded(Law):
    """Ye and Hu's law with a fixed gain, in effective time.

    u^i_i = −δ ∂J_i/∂x_i(x^i) and u^i_j = −κ ξ^i_j for j ≠ i, with :func:`grounded_error`: a strategy follows its own
    gradient alone. M. Ye and G. Hu, "Distributed Nash equilibrium seeking by a consensus based approach", IEEE
    Transactions on Automatic Control 62(9), 2017. There a player also estimates its own strategy, in whose place it
    stands itself here, and κ is 1 and δ small, while here κ may be large, too.

    Over graphs that are only jointly connected, where Theorem 4 of the paper is false (docs/errata.md, 2), a small δ
    suffices: X. He and J. Huang, "A distributed approach to seek Nash equilibrium over jointly strongly connected
    switching networks", Chinese Control Conference, 2022, pp. 6905–6909. By its abstract, which is all that we have
    read, estimates converge exponentially if F is strongly monotone and Lipschitz. Here it holds for every κ > 0 and
    all δ below some bound, by small gain: while strategies rest, the errors of the estimates vanish at a rate that does
    not depend on δ, and strategies move in proportion to δ.

    Args:
        layout: the layout of the environment.
        kappa: κ ≥ 0.
        gradient_gain: δ > 0.

    Raises:
        ValueError: for a gain out of range.
    """

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, gradient_gain: float = 1.0) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)
        self.gradient_gain = require_positive("gradient_gain", gradient_gain)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        player = observation.player
        own, leaders = self.layout.own_mask[player], self.layout.neighbour_components[player]
        return grounded_inputs(observation, own, leaders, self.kappa, self.gradient_gain), memory


class AdaptiveGrounded(Law):
    """Ye and Hu's law with adaptive gains, in effective time: the node-based law.

    u^i_i = −∂J_i/∂x_i(x^i), and for a component c of another player, u^i_c = −θ^i_c ξ^i_c and dθ^i_c/dτ = γ (ξ^i_c)².
    M. Ye and G. Hu, "Adaptive approaches for fully distributed Nash equilibrium seeking in networked games",
    Automatica, 2021, where strategies are numbers. Every player tunes the gains of its own consensus errors, so no gain
    must be known. (The edge-based law of that paper is of the kind of :class:`~ptne_env.laws.Adaptive`.) The memory is
    θ^i_c, shape (R, n), in natural units, and takes an Euler step of Θ_k.

    Args:
        layout: the layout of the environment.
        gamma: γ ≥ 0, the rate of adaptation.
        initial_gain: every gain at t = 0, ≥ 0.

    Raises:
        ValueError: for a negative number.
    """

    has_gains: ClassVar[bool] = True

    def __init__(self, layout: ObservationLayout, gamma: float = 0.01, initial_gain: float = 0.5) -> None:
        super().__init__(layout)
        self.gamma = require_non_negative("gamma", gamma)
        self.initial_gain = require_non_negative("initial_gain", initial_gain)

    def initial_memory(self, rows: int) -> FloatArray:
        """Return θ^i_c(0), shape (R, n)."""
        return np.full((rows, self.layout.dimension), self.initial_gain)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        error = grounded_error(observation, self.layout.neighbour_components[observation.player])
        own = self.layout.own_mask[observation.player]
        growth = self.gamma * error**2 * observation.unit**2
        inputs = np.where(own, -observation.gradient, memory * error)
        return inputs, memory + observation.theta * np.where(own, 0.0, growth)
