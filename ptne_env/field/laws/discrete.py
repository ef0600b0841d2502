"""Laws of discrete time: iterations that mix with the neighbours and then take a projected gradient step.

An iteration evaluates the gradient at the mixed estimates, while an environment shows gradients at the present ones. So
an iteration takes two steps of the environment, a mixing step and a descent step, and is then exact. The deadline plays
no part: these laws move their estimates to the next iterate within the step, u = Δx/Θ, as far as the input limit lets
them.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.perception.observation import Interface, LayoutError, Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, frozen, require_count, require_positive


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


def aggregate_tracking_inputs(
    observation: Observation,
    memory: FloatArray,
    layout: ObservationLayout,
    step: float,
    power: float,
    mixing: float,
    warm_up: int,
) -> tuple[FloatArray, FloatArray]:
    """v̂_i = Σ_j w_ij v_j; x_i ← x_i − α_k ∂J_i/∂x_i(x_i, N v̂_i); v_i ← v̂_i + (new x_i − old x_i), v_i(0) = x_i(0).

    J. Koshal, A. Nedić and U. V. Shanbhag, "Distributed algorithms for aggregative games on graphs", Operations
    Research 64(3), 2016: the synchronous algorithm, with α_k = α/(k + 1)^p and W = I − h L. On a topology whose modes
    are disjoint pairs and with h = ½/a_ij it is their gossip.

    The estimate v_i of the average strategy is the mean of player i's estimates x^i_j over j, so estimates carry the
    aggregate and not the others' strategies: the error of the strategies vanishes, that of the estimates does not.

    With α = ``step``, p = ``power``, h = ``mixing``, and ``warm_up`` steps spent on v_i(0) = x_i(0). The memory is the
    number of steps done, shape (R, 1).
    """
    rows, players = len(observation.player), layout.num_players
    own = layout.own_mask[observation.player]
    blocks = layout.own_components[observation.player]
    place = np.arange(layout.dimension) % layout.action_dims[0]  # of each component in its block

    def everywhere(block: FloatArray) -> FloatArray:
        """A vector per player, (R, m), repeated for all players, (R, n)."""
        return block[:, place]

    strategies = np.take_along_axis(observation.own_estimate, blocks, axis=1)
    start = everywhere(strategies) - observation.own_estimate

    pulls = consensus(observation.weights, observation.relative_estimates).reshape(rows, players, -1)
    drift = everywhere(np.einsum("rjm->rm", pulls)) * (mixing / (players - 1))
    mixed = np.where(own, 0.0, drift)

    iteration = (memory - warm_up) // 2
    alpha = step / (np.maximum(iteration, 0) + 1) ** power
    gradients = np.take_along_axis(observation.gradient, blocks, axis=1)
    descent = -alpha * everywhere(gradients)  # of all components, so that the mean follows the strategy

    descends = (memory - warm_up) % 2 == 1
    displacement = np.where(memory < warm_up, start, np.where(descends, descent, mixed))
    return per_step(displacement, observation), memory + 1


class ProjectedGradient(Law):
    """Bianchi and Grammatico's projected gradient with consensus, :func:`projected_gradient_inputs`.

    Args:
        layout: of the environment; ``physical`` when strategies are bounded.
        step: α > 0.
        mixing: h > 0 with h Σ_j a_ij < 1 for every player, so that W is doubly stochastic.
        lower, upper: box Π_i, a number or an entry per component, shape (n,); no projection if left out.

    Raises:
        ValueError: for a parameter out of range, or bounds under ``local``, where strategies are not observed.
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
            raise LayoutError("bounds need the own strategy, which 'local' does not show; use the interface 'physical'")

    def initial_memory(self, rows: int) -> FloatArray:
        """Number of steps done: 0, shape (R, 1)."""
        return np.zeros((rows, 1))

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        box = (self.lower, self.upper) if self._is_bounded else None
        return projected_gradient_inputs(observation, memory, self.layout, self.step, self.mixing, box)


class AggregateTracking(Law):
    """Koshal, Nedić and Shanbhag's aggregate tracking, :func:`aggregate_tracking_inputs`.

    Where the input limit lets the warm-up end early, the average stays biased.

    Args:
        layout: of the environment, interface ``physical``, all players of the same dimension.
        step: α > 0.
        power: p ≥ 0; p in (½, 1] makes Σ α_k infinite and Σ α_k² finite, 0 keeps the step.
        mixing: h > 0.
        warm_up: steps before the first iteration.

    Raises:
        ValueError: for a parameter out of range, another interface, or players of different dimensions.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)
    interface: ClassVar[Interface] = Interface(estimates="coded")

    def __init__(
        self, layout: ObservationLayout, step: float = 0.5, power: float = 0.6, mixing: float = 0.3, warm_up: int = 4
    ) -> None:
        super().__init__(layout)
        if len(set(layout.action_dims)) != 1:
            raise LayoutError(f"AggregateTracking adds strategies up: equal dimensions, got {layout.action_dims}")
        self.step = require_positive("step", step)
        self.mixing = require_positive("mixing", mixing)
        self.warm_up = require_count("warm_up", warm_up, 0)
        if not 0 <= power < np.inf:
            raise ValueError(f"power must be a finite number of at least 0, got {power!r}")
        self.power = float(power)

    def initial_memory(self, rows: int) -> FloatArray:
        """Number of steps done: 0, shape (R, 1)."""
        return np.zeros((rows, 1))

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        return aggregate_tracking_inputs(
            observation, memory, self.layout, self.step, self.power, self.mixing, self.warm_up
        )
