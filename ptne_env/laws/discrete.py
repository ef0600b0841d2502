"""Laws of discrete time: iterations that first mix with the neighbours and then take a projected gradient step.

One iteration evaluates the gradient at what was mixed, while an environment shows gradients at what it holds. So an
iteration takes two steps of the environment, one that mixes and one that descends, and is then exact.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import FloatArray, frozen, require_count, require_positive
from ptne_env.laws.base import (
    Condition,
    Law,
    ProblemConstants,
    consensus,
    decisive,
    lasting_connectivity,
    per_step,
    strong_monotonicity,
)
from ptne_env.observation import Interface, Observation, ObservationLayout


class ProjectedGradient(Law):
    """x̂^i = Σ_j w_ij x^j, then x^i_i ← Π_i[x̂^i_i − α ∂J_i/∂x_i(x̂^i)] and x^i_j ← x̂^i_j, with W = I − h L.

    M. Bianchi and S. Grammatico, "Fully distributed Nash equilibrium seeking over time-varying communication networks
    with linear convergence rate", IEEE Control Systems Letters 5(2), 2021. The deadline plays no part: the law moves
    its estimates by what it wants within the step, u = Δx/Θ, as long as the input limit lets it.

    Args:
        layout: of the environment; ``physical`` when strategies are bounded.
        step: α > 0.
        mixing: h > 0 with h Σ_j a_ij < 1 for every player, so that W is doubly stochastic.
        lower, upper: box Π_i, a number or one per component, shape (n,); no projection if left out.

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
            raise ValueError("bounds need the own strategy, which 'local' does not show; use the interface 'physical'")

    def contraction(self, constants: ProblemConstants) -> FloatArray:
        """The matrix of :meth:`condition`, shape (2, 2): how (‖consensus error‖, ‖disagreement‖)² grow at most."""
        alpha, players = self.step, constants.num_players
        epsilon, iota_strategies, iota = constants.epsilon, constants.iota_strategies, constants.iota_estimates
        sigma = max(mixing_norm(laplacian, self.mixing) for laplacian in constants.laplacians)
        mean = 1 - 2 * alpha * epsilon / players + (alpha * iota_strategies) ** 2 / players
        cross = alpha * sigma * (iota + iota_strategies + alpha * iota * iota_strategies) / np.sqrt(players)
        return np.array([[mean, cross], [cross, sigma**2 * (1 + alpha * iota) ** 2]])

    def condition(self, constants: ProblemConstants) -> Condition:
        """ρ = λ_max(M_α) < 1: every iteration then shrinks ‖𝐱 − 1⊗x*‖ by √ρ at least, on every sequence of modes.

        M_α = [[1 − 2αε/N + α²ι_F²/N, ασ(ι + ι_F + αιι_F)/√N], [·, σ²(1 + αι)²]] with σ the largest ‖W − 11ᵀ/N‖ over
        the modes, which is 1 as soon as one of them is disconnected.
        """
        if constants.epsilon <= 0:
            return strong_monotonicity(constants)
        largest = float(np.linalg.eigvalsh(self.contraction(constants))[-1])
        return Condition.below("λ_max(M_α) < 1", largest, 1.0, exact=constants.exact)

    def _initial_memory(self, rows: int) -> FloatArray:
        return np.zeros((rows, 1))

    def _inputs(self, reading: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        mixed = self.mixing * consensus(reading.weights, reading.relative_estimates)
        descent = -self.step * reading.gradient
        if self._is_bounded:
            own = self.layout.own_mask[reading.player]
            target = np.clip(reading.own_estimate + descent, self.lower, self.upper)
            descent = np.where(own, target - reading.own_estimate, 0.0)
        descends = memory % 2 == 1
        return per_step(np.where(descends, descent, mixed), reading), memory + 1


class AggregateTracking(Law):
    """v̂_i = Σ_j w_ij v_j; x_i ← x_i − α_k ∂J_i/∂x_i(x_i, N v̂_i); v_i ← v̂_i + (new x_i − old x_i), v_i(0) = x_i(0).

    J. Koshal, A. Nedić and U. V. Shanbhag, "Distributed algorithms for aggregative games on graphs", Operations
    Research 64(3), 2016: the synchronous algorithm, with α_k = α/(k + 1)^p and W = I − h L. On a topology whose modes are
    disjoint pairs and with h = ½/a_ij it is their gossip.

    The estimate v_i of the average strategy is the mean of player i's estimates x^i_j over j, so estimates carry the
    aggregate and not the others' strategies: the error of the strategies is what counts, and the error of the estimates
    does not vanish. The law spends ``warm_up`` steps on v_i(0) = x_i(0); where the input limit lets these not
    suffice, the average stays biased.

    Args:
        layout: of the environment, interface ``physical``, all players of the same dimension.
        step: α > 0.
        power: p ≥ 0; p in (½, 1] makes Σ α_k infinite and Σ α_k² finite, 0 keeps the step.
        mixing: h > 0.
        warm_up: steps before the first iteration.

    Raises:
        ValueError: for a parameter out of range, another interface, or players of different dimensions.
    """

    needs = ("own_estimate",)
    interface = Interface("physical")

    def __init__(
        self, layout: ObservationLayout, step: float = 0.5, power: float = 0.6, mixing: float = 0.3, warm_up: int = 4
    ) -> None:
        super().__init__(layout)
        if len(set(layout.action_dims)) != 1:
            raise ValueError(f"AggregateTracking adds strategies up: equal dimensions, got {layout.action_dims}")
        self.step = require_positive("step", step)
        self.mixing = require_positive("mixing", mixing)
        self.warm_up = require_count("warm_up", warm_up, 0)
        if not 0 <= power < np.inf:
            raise ValueError(f"power must be a finite number of at least 0, got {power!r}")
        self.power = float(power)

    def condition(self, constants: ProblemConstants) -> Condition:
        """An aggregative game, ε > 0, W stochastic, Σ α_k = ∞ and Σ α_k² < ∞, graphs that stay connected."""
        return decisive(
            Condition.below("aggregative: spread of ∂²J_i/∂x_i∂x_j over j ≠ i", _spread(constants), 1e-9),
            Condition.below(
                "W = I − h L is stochastic: h max Σ_j a_ij < 1", self.mixing * constants.largest_degree, 1.0
            ),
            Condition.above("Σ α_k² is finite: p > 1/2", self.power, 0.5),
            Condition.below("Σ α_k is infinite: p ≤ 1", self.power, np.nextafter(1.0, 2.0)),
            lasting_connectivity(constants),
            strong_monotonicity(constants),
        )

    def _initial_memory(self, rows: int) -> FloatArray:
        return np.zeros((rows, 1))

    def _inputs(self, reading: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        rows, players = len(reading.player), self.layout.num_players
        own = self.layout.own_mask[reading.player]
        place = np.arange(self.layout.dimension) % self.layout.action_dims[0]  # of each component in its block
        blocks = self.layout.own_components[reading.player]

        def everywhere(block: FloatArray) -> FloatArray:
            """A vector per player, (R, m), repeated for all players, (R, n)."""
            return block[:, place]

        strategies = np.take_along_axis(reading.own_estimate, blocks, axis=1)
        start = everywhere(strategies) - reading.own_estimate

        pulls = consensus(reading.weights, reading.relative_estimates).reshape(rows, players, -1)
        drift = everywhere(np.einsum("rjm->rm", pulls)) * (self.mixing / (players - 1))
        mixed = np.where(own, 0.0, drift)

        iteration = (memory - self.warm_up) // 2
        alpha = self.step / (np.maximum(iteration, 0) + 1) ** self.power
        gradients = np.take_along_axis(reading.gradient, blocks, axis=1)
        descent = -alpha * everywhere(gradients)  # of all components, so that the mean follows the strategy

        descends = (memory - self.warm_up) % 2 == 1
        displacement = np.where(memory < self.warm_up, start, np.where(descends, descent, mixed))
        return per_step(displacement, reading), memory + 1


def mixing_norm(laplacian: FloatArray, mixing: float) -> float:
    """σ = ‖I − h L − 11ᵀ/N‖, the factor by which one mixing shrinks disagreement at least."""
    players = len(laplacian)
    return float(np.linalg.norm(np.eye(players) - mixing * laplacian - 1 / players, 2))


def _spread(constants: ProblemConstants) -> float:
    """How far the coupling of a player to the others is from the same for all others, per place in the block."""
    owners, jacobian = constants.owners, constants.jacobian
    players = constants.num_players
    if len(set(np.bincount(owners))) != 1:
        return np.inf
    blocks = jacobian.reshape(players, len(owners) // players, players, -1)
    spread = 0.0
    for player in range(players):
        others = blocks[player][:, np.arange(players) != player]
        spread = max(spread, float(np.ptp(others, axis=1).max()))
    return spread
