"""Bianchi and Grammatico's law of discrete time, which takes projected gradient steps."""

from __future__ import annotations

import numpy as np

from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive


class ProjectedGradient(Law):
    """A law of discrete time that mixes with the neighbours, and then takes a projected gradient step.

    x̂^i = Σ_j w_ij x^j, then x^i_i ← Π_i[x̂^i_i − α ∂J_i/∂x_i(x̂^i)] and x^i_j ← x̂^i_j, with W = I − h L. M. Bianchi
    and S. Grammatico, "Fully distributed Nash equilibrium seeking over time-varying communication networks with linear
    convergence rate", IEEE Control Systems Letters 5(2), 2021.

    An iteration evaluates the gradient at the mixed estimates, while an environment shows gradients at the present
    ones. So an iteration takes two steps, a mixing step and a descent step. The environment projects the strategy into
    its box after each, and the iteration after the second only. So the iterates are the same where mixing does not lead
    out of the box, as when all copies start in it. The deadline plays no part: the law moves its estimates to the next
    iterate within the step, as far as the input limit lets it. The memory is the number of steps done, shape (R, 1).

    Args:
        layout: the layout of the environment.
        step: α > 0.
        mixing: h > 0 with h Σ_j a_ij < 1 for every player, so that W is doubly stochastic.

    Raises:
        ValueError: for a parameter out of range.
    """

    def __init__(self, layout: ObservationLayout, step: float = 0.1, mixing: float = 0.3) -> None:
        super().__init__(layout)
        self.step, self.mixing = require_positive("step", step), require_positive("mixing", mixing)

    def initial_memory(self, rows: int) -> FloatArray:
        """Return the number of steps done, which is 0, shape (R, 1)."""
        return np.zeros((rows, 1))

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        mixed = self.mixing * consensus(observation.weights, observation.relative_estimates)
        descent = -self.step * observation.gradient
        return per_step(np.where(memory % 2 == 1, descent, mixed), observation), memory + 1
