"""Laws of discrete time: iterations that mix with the neighbours and then take a projected gradient step.

An iteration evaluates the gradient at the mixed estimates, while an environment shows gradients at the present ones. So
an iteration takes two steps of the environment, a mixing step and a descent step, and is then exact. The deadline plays
no part: these laws move their estimates to the next iterate within the step, u = Δx/Θ, as far as the input limit lets
them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.perception.observation import LayoutError, Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, frozen, require_positive


def projected_gradient_inputs(
    observation: Observation,
    memory: FloatArray,
    layout: ObservationLayout,
    step: float,
    mixing: float,
    box: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """x̂^i = Σ_j w_ij x^j, then x^i_i ← Π_i[x̂^i_i − α ∂J_i/∂x_i(x̂^i)] and x^i_j ← x̂^i_j, with W = I − h L.

    M. Bianchi and S. Grammatico, "Fully distributed Nash equilibrium seeking over time-varying communication networks
    with linear convergence rate", IEEE Control Systems Letters 5(2), 2021.
    With α = ``step`` and h = ``mixing``; ``box`` holds the lower and upper bounds of Π, shape (n,) each. The memory is
    the number of steps done, shape (R, 1).
    """
    mixed = mixing * consensus(observation.weights, observation.relative_estimates)
    descent = -step * observation.gradient
    if box is not None:
        target = np.clip(observation.own_estimate + descent, *box)
        descent = np.where(layout.own_mask[observation.player], target - observation.own_estimate, 0.0)
    descends = memory % 2 == 1
    return per_step(np.where(descends, descent, mixed), observation), memory + 1


class ProjectedGradient(Law):
    """Bianchi and Grammatico's projected gradient with consensus, :func:`projected_gradient_inputs`.

    Args:
        layout: of the environment; ``physical`` when strategies are bounded.
        step: α > 0.
        mixing: h > 0 with h Σ_j a_ij < 1 for every player, so that W is doubly stochastic.
        lower, upper: box Π_i, a number or an entry per component, shape (n,); no projection if left out.

    Raises:
        ValueError: for a parameter out of range, or bounds under ``scaled``, where strategies are not observed.
    """

    def __init__(
        self,
        layout: ObservationLayout,
        step: float = 0.1,
        mixing: float = 0.3,
        lower: npt.ArrayLike = -np.inf,
        upper: npt.ArrayLike = np.inf,
    ) -> None:
        super().__init__(layout)
        self.step = require_positive("step", step)
        self.mixing = require_positive("mixing", mixing)
        self.lower, self.upper = (frozen(np.broadcast_to(bound, layout.dimension)) for bound in (lower, upper))
        if not np.all(self.lower < self.upper):
            raise ValueError("ProjectedGradient needs lower < upper for every component")
        self._is_bounded = bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())
        if self._is_bounded and "own_estimate" not in layout.slices:
            raise LayoutError(
                "bounds need the own strategy, which 'scaled' does not show; use the interface 'physical'"
            )

    def initial_memory(self, rows: int) -> FloatArray:
        """Number of steps done: 0, shape (R, 1)."""
        return np.zeros((rows, 1))

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        box = (self.lower, self.upper) if self._is_bounded else None
        return projected_gradient_inputs(observation, memory, self.layout, self.step, self.mixing, box)
