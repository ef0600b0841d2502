"""Conditions of the laws' theorems: numbers of a scenario against the numbers that each theorem needs.

:func:`condition` finds the condition of a law by its class. Conditions are sufficient for convergence; most are not
necessary. A law of your own registers its condition::

    @condition.register
    def _(law: MyLaw, constants: ProblemConstants) -> Condition:
        return Condition.above("κ > 1/λ2", law.kappa, 1 / constants.connectivity)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from ptne_env.field.laws import (
    ContactRelay,
    MultiRate,
    ObserverRelay,
    ProjectedGradient,
    ProximalBestResponse,
    RoutedUnknown,
)
from ptne_env.laws import Adaptive, AdaptiveGrounded, CorollaryOne, FixedGain, Grounded, Law, Static
from ptne_env.shared.arrays import FloatArray, IntArray
from ptne_env.theory.closed_loop import last_modes
from ptne_env.theory.constants import ZERO, MonotonicityConstants, gain_bound, jacobians, monotonicity_constants
from ptne_env.theory.delayed_play import (
    coupling_radius,
    delayed_play_radius,
    hop_delays,
    largest_delayed_step,
    multi_rate_radius,
)
from ptne_env.world.graphs import Graph, union
from ptne_env.world.world import World

_LARGEST_SYSTEM = 1200
"""Delayed play is decided exactly while its matrix has no more rows than this: its eigenvalues take seconds beyond."""


@dataclass(frozen=True)
class ProblemConstants(MonotonicityConstants):
    """The numbers of a scenario that conditions use: the constants of its game, its graphs and its clock.

    Attributes:
        jacobian: dF, shape (n, n); at x* unless F is affine.
        owners: the player that owns each component, shape (n,).
        graphs: the modes of the topology.
        recurring: the graphs whose links act again and again as s → ∞: the union of all modes on the transformed clock,
            each mode that may be the last on the physical clock (docs/errata.md, 2).
    """

    jacobian: FloatArray
    owners: IntArray
    graphs: tuple[Graph, ...]
    recurring: tuple[Graph, ...]

    @property
    def num_players(self) -> int:
        """N."""
        return self.graphs[0].num_players

    @property
    def connectivity(self) -> float:
        """The smallest λ2 over the modes; exactly 0 where a mode is disconnected."""
        return min(graph.algebraic_connectivity for graph in self.graphs)

    @property
    def recurring_connectivity(self) -> float:
        """The smallest λ2 of the recurring graphs."""
        return min(graph.algebraic_connectivity for graph in self.recurring)

    @property
    def largest_degree(self) -> float:
        """The largest Σ_j a_ij over players and modes."""
        return max(float(graph.laplacian.diagonal().max()) for graph in self.graphs)


def problem_constants(world: World, constants: MonotonicityConstants | None = None) -> ProblemConstants:
    """The numbers of ``world`` that conditions use; for a family of games, those of its representative member.

    Args:
        world: the scenario, built.
        constants: of its game, when already known.
    """
    game, topology = world.game, world.topology
    recurring = [topology.union]
    if not topology.is_fixed and topology.clock == "physical":  # one mode is the last before T
        recurring = [topology.graphs[mode] for mode in last_modes(topology, world.scenario.deadline)]
    return ProblemConstants(
        **vars(constants or monotonicity_constants(game)),
        jacobian=jacobians(game, game.nash_equilibrium[:, None])[:, :, 0],
        owners=game.owners,
        graphs=tuple(topology.graphs),
        recurring=tuple(recurring),
    )


@dataclass(frozen=True)
class Condition:
    """The condition of a law's theorem on a scenario.

    Attributes:
        name: the condition in words or symbols, with the direction in which ``value`` is compared with ``bound``.
        value: the number that decides.
        bound: the number that it is compared with; infinite or NaN where no number would do.
        holds: whether the scenario meets the condition.
        exact: whether the numbers are exact; otherwise they come from samples or a linearisation and prove nothing.
        necessary: whether the law does not settle where the condition fails (if no bound is active).
    """

    name: str
    value: float
    bound: float
    holds: bool
    exact: bool = True
    necessary: bool = False

    @classmethod
    def above(cls, name: str, value: float, bound: float, *, exact: bool = True) -> Condition:
        """The condition value > bound."""
        return cls(name, float(value), float(bound), bool(value > bound), exact)

    @classmethod
    def below(cls, name: str, value: float, bound: float, *, exact: bool = True) -> Condition:
        """The condition value < bound."""
        return cls(name, float(value), float(bound), bool(value < bound), exact)

    @classmethod
    def settles(cls, name: str, radius: float, *, exact: bool) -> Condition:
        """The condition ρ < 1 on the loop of an affine game, which is necessary too; ``exact``: F is affine."""
        return cls(name, float(radius), 1.0, bool(radius < 1), exact, necessary=exact)


def decisive(*conditions: Condition) -> Condition:
    """All of several conditions as one: the first that fails, or else the last."""
    return next((condition for condition in conditions if not condition.holds), conditions[-1])


def _strongly_monotone(constants: ProblemConstants) -> Condition:
    """Assumption 4."""
    return Condition.above("F is strongly monotone: ε > 0", constants.epsilon, 0.0, exact=constants.exact)


def _stays_connected(constants: ProblemConstants) -> Condition:
    """Assumptions 1 and 2 for the graphs that act as s → ∞."""
    return Condition.above("the graphs are connected as s → ∞: λ2 > 0", constants.recurring_connectivity, 0.0)


def _always_connected(constants: ProblemConstants) -> Condition:
    return Condition.above("every graph is connected: λ2 > 0", constants.connectivity, 0.0)


def _gains_adapt(gamma: float) -> Condition:
    return Condition.above("the gains adapt: γ > 0", gamma, 0.0)


def _gain_condition(kappa: float, constants: ProblemConstants) -> Condition:
    bound = gain_bound(constants, constants.connectivity)
    return Condition.above("κ > (ι²/ε + ι)/λ2", kappa, bound, exact=constants.exact)


# --- the condition of each law --------------------------------------------------------------------------------------


@singledispatch
def condition(law: Law, constants: ProblemConstants) -> Condition | None:  # noqa: ARG001 - laws with a theorem use them
    """The condition of the theorem of ``law``, with the number that decides; ``None`` for a law without a theorem.

    Args:
        law: built for the scenario; its class, or a base class, selects the condition.
        constants: of the scenario, see :func:`problem_constants`.
    """
    return None


@condition.register
def static_condition(law: Static, constants: ProblemConstants) -> Condition:
    """κ > (ι²/ε + ι)/λ2, eq. (15) of the paper, for scaled costs with κ divided by the gradient gain."""
    return _gain_condition(law.kappa / law.gradient_gain, constants)


@condition.register
def corollary_one_condition(law: CorollaryOne, constants: ProblemConstants) -> Condition:
    """κ > (ι²/ε + ι)/λ2, eq. (15) of the paper; convergence is asymptotic, not by the deadline."""
    return _gain_condition(law.kappa, constants)


@condition.register
def fixed_gain_condition(law: FixedGain, constants: ProblemConstants) -> Condition:
    """κ > ((ι_F + ι)²/(4ε) + ι)/λ2, with κ divided by the gradient gain.

    It holds exactly where the bound [[ε/N, −(ι_F + ι)/(2√N)], [·, κ λ2 − ι]] of the loop on consensus and
    disagreement is positive definite, and then (𝐱 − 1⊗x*)ᵀ M (𝐱 − 1⊗x*) > 0.
    """
    bound = np.inf
    if constants.epsilon > 0 and constants.connectivity > 0:
        total = constants.iota_strategies + constants.iota_estimates
        bound = (total**2 / (4 * constants.epsilon) + constants.iota_estimates) / constants.connectivity
    name = "κ > ((ι_F + ι)²/(4ε) + ι)/λ2"
    return Condition.above(name, law.kappa / law.gradient_gain, bound, exact=constants.exact)


@condition.register
def adaptive_condition(law: Adaptive, constants: ProblemConstants) -> Condition:
    """ε > 0, and the graphs that act as s → ∞ are (jointly) connected (Theorems 3 and 4); γ > 0 on all links."""
    return decisive(_gains_adapt(law.gamma), _stays_connected(constants), _strongly_monotone(constants))


@condition.register
def grounded_condition(law: Grounded, constants: ProblemConstants) -> Condition:
    """κ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ, with λ the smallest eigenvalue of the grounded Laplacians.

    The paper proves that a large enough κ exists (there 1/δ). This κ is large enough, for d/dτ ½(‖x − x*‖² + ‖y‖²),
    y being the estimates minus the strategies that they estimate, is at most
    −ε a² + (ι + √(N−1) ι_F) a b − (κ λ − √(N−1) ι) b² with a = ‖x − x*‖ and b = ‖y‖.
    """
    grounded, bound = _grounded_connectivity(constants), np.inf
    if constants.epsilon > 0 and grounded > 0:
        others = np.sqrt(constants.num_players - 1)
        cross = constants.iota_estimates + others * constants.iota_strategies
        bound = (cross**2 / (4 * constants.epsilon) + others * constants.iota_estimates) / grounded
    name = f"κ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ, λ = {grounded:.3g}"
    return Condition.above(name, law.kappa, bound, exact=constants.exact)


def _grounded_connectivity(constants: ProblemConstants) -> float:
    """The smallest eigenvalue of H_j = L without row and column j, plus diag(a_ij), over players j and modes."""
    if constants.connectivity == 0:
        return 0.0
    smallest = np.inf
    for laplacian in (graph.laplacian for graph in constants.graphs):
        for leader in range(len(laplacian)):
            others = np.arange(len(laplacian)) != leader
            matrix = laplacian[np.ix_(others, others)] - np.diag(laplacian[others, leader])
            smallest = min(smallest, float(np.linalg.eigvalsh(matrix)[0]))
    return smallest


@condition.register
def adaptive_grounded_condition(law: AdaptiveGrounded, constants: ProblemConstants) -> Condition:
    """γ > 0, ε > 0 and every graph connected: with H the grounded Laplacian, V = ½‖x − x*‖² + ½ yᵀ H y + gains."""
    return decisive(_gains_adapt(law.gamma), _always_connected(constants), _strongly_monotone(constants))


@condition.register
def projected_gradient_condition(law: ProjectedGradient, constants: ProblemConstants) -> Condition:
    """ρ = λ_max(M_α) < 1: every iteration then shrinks ‖𝐱 − 1⊗x*‖ by √ρ at least, on every sequence of modes.

    M_α = [[1 − 2αε/N + α²ι_F²/N, ασ(ι + ι_F + αιι_F)/√N], [·, σ²(1 + αι)²]] bounds the growth of
    (‖consensus error‖, ‖disagreement‖)², with σ the largest ‖I − h L − 11ᵀ/N‖ over the modes, the factor by which
    mixing shrinks disagreement; it is 1 as soon as a mode is disconnected.
    """
    if constants.epsilon <= 0:
        return _strongly_monotone(constants)
    alpha, players = law.step, constants.num_players
    iota_strategies, iota = constants.iota_strategies, constants.iota_estimates
    sigma = max(
        float(np.linalg.norm(np.eye(players) - law.mixing * graph.laplacian - 1 / players, 2))
        for graph in constants.graphs
    )
    mean = 1 - 2 * alpha * constants.epsilon / players + (alpha * iota_strategies) ** 2 / players
    cross = alpha * sigma * (iota + iota_strategies + alpha * iota * iota_strategies) / np.sqrt(players)
    contraction = np.array([[mean, cross], [cross, sigma**2 * (1 + alpha * iota) ** 2]])
    return Condition.below("λ_max(M_α) < 1", float(np.linalg.eigvalsh(contraction)[-1]), 1.0, exact=constants.exact)


@condition.register
def routed_condition(law: RoutedUnknown, constants: ProblemConstants) -> Condition:
    """On a fixed graph ρ < 1 of gradient play with delays equal to hop counts, exactly where it converges.

    Where the graph switches, η max_c dF_cc ≤ 1 and ρ(D⁻¹ |dF − D|) < 1, which suffice for every delay
    (:func:`~ptne_env.theory.delayed_play.coupling_radius`), and all links act again and again.
    """
    delays = hop_delays(union(constants.graphs), constants.owners)
    monotone, curvature = _strongly_monotone(constants), float(constants.jacobian.diagonal().max())
    if len(constants.graphs) == 1 and len(delays) * (delays.max() + 1) <= _LARGEST_SYSTEM:
        radius = delayed_play_radius(constants.jacobian, delays, law.step)
        largest = largest_delayed_step(constants.jacobian, delays)
        limit = "for no η" if largest is None else f"up to η = {largest:.3g}"
        name = f"gradient play with delays settles ({limit}): ρ < 1"
        return decisive(monotone, Condition.settles(name, radius, exact=constants.exact))
    return decisive(
        monotone,
        _all_links_recur(constants),
        Condition.below("η max dF_cc ≤ 1", law.step * curvature, np.nextafter(1.0, 2.0), exact=constants.exact),
        Condition.below(
            "ρ(D⁻¹ |dF − D|) < 1, with D the diagonal", coupling_radius(constants.jacobian), 1.0, exact=constants.exact
        ),
    )


@condition.register
def multi_rate_condition(law: MultiRate, constants: ProblemConstants) -> Condition:
    """F monotone, a fixed graph, and ρ < 1 of primal-dual play with delays, the hop counts, as if no bound were active.

    Operators are the players whose own block of dF is 0. The loop is exact where all prices of x* are positive and no
    other bound is active.
    """
    delays = hop_delays(union(constants.graphs), constants.owners)
    monotone = Condition.above(
        "F is monotone: ε ≥ 0", constants.epsilon, np.nextafter(0.0, -1.0), exact=constants.exact
    )
    needed = decisive(monotone, _fixed_graph(constants))
    if not needed.holds or len(delays) * (delays.max() + 2) > _LARGEST_SYSTEM:
        return needed
    own = constants.owners[:, None] == constants.owners
    is_price = ~np.any(np.where(own, constants.jacobian, 0.0), axis=1)
    steps, leads = np.where(is_price, law.price_step, law.step), np.where(is_price, law.lead, 0.0)
    radius = multi_rate_radius(constants.jacobian, delays, steps, leads)
    return Condition.settles("primal-dual play with delays settles: ρ < 1", radius, exact=constants.exact)


def _fixed_graph(constants: ProblemConstants) -> Condition:
    return Condition.below("the graph is fixed: number of graphs < 2", len(constants.graphs), 2)


@condition.register
def proximal_condition(law: ProximalBestResponse, constants: ProblemConstants) -> Condition:
    """h/α > (ι²/ε + ι)/λ2 on a fixed graph, and h Σ_j a_ij < 1, once the rows of dF are identified.

    The law is the proximal-point method with the preconditioner I + W for the inclusion 0 ∈ α Rᵀ**F**(𝐱) + (I − W) 𝐱,
    W = I − h L. That operator is α times the one of Theorem 1 with κ = h/α, so the gain condition makes it restricted
    strongly monotone, and 𝐱 converges linearly where I + W is positive definite.
    """
    return decisive(
        _fixed_graph(constants),
        Condition.below("W is stochastic: h max Σ_j a_ij < 1", law.mixing * constants.largest_degree, 1.0),
        _gain_condition(law.mixing / law.step, constants),
    )


@condition.register
def relay_condition(law: ContactRelay, constants: ProblemConstants) -> Condition:  # noqa: ARG001 - it has no gain
    """ε > 0, ρ(B) < 1 with B_ij = ‖G_ii⁻¹ G_ij‖ for i ≠ j and G = dF, and all links act again and again.

    Then best responses contract in a weighted maximum norm, with copies of any age (D. P. Bertsekas and J. N.
    Tsitsiklis, "Parallel and distributed computation", 1989, section 6.2), so also along paths that switch.
    """
    curved = _own_curvature(constants)
    if not curved.holds:
        return curved
    blocks = [np.flatnonzero(constants.owners == player) for player in range(constants.num_players)]
    coupling = np.zeros((len(blocks), len(blocks)))
    for i, own in enumerate(blocks):
        response = np.linalg.solve(constants.jacobian[np.ix_(own, own)], constants.jacobian[own])
        for j, other in enumerate(blocks):
            coupling[i, j] = 0.0 if i == j else np.linalg.norm(response[:, other], 2)
    radius = float(np.abs(np.linalg.eigvals(coupling)).max())
    return decisive(
        _strongly_monotone(constants),
        _all_links_recur(constants),
        Condition.below("ρ(B) < 1, B_ij = ‖G_ii⁻¹ G_ij‖", radius, 1.0, exact=constants.exact),
    )


@condition.register
def observer_relay_condition(law: ObserverRelay, constants: ProblemConstants) -> Condition:
    """That of :class:`~ptne_env.field.laws.ContactRelay`, and max_c Σ_d |G_cd| ≤ min_c G_cc, d of others, for the own c of a player.

    Then responses are undamped and players do not extrapolate their own gradient, which need not contract. Joint
    solutions contract as best responses do: with the weights v of the norm, B v ≤ ρ v, and errors |e_j| ≤ r v_j of the
    components that a solution leaves alone, those that it fixes obey |z_i| ≤ Σ_j B_ij max(|z_j|, r v_j) ≤ ρ r v_i, as
    soon as model and planes are identified.
    """
    size, own = np.abs(constants.jacobian), constants.owners[:, None] == constants.owners
    beside, curvature = np.where(own, 0.0, size).sum(axis=1), size.diagonal()
    players = range(constants.num_players)
    ratios = [
        beside[mine].max() / curvature[mine].min() if curvature[mine].min() > 0 else np.inf
        for mine in (constants.owners == player for player in players)
    ]
    name = "responses stay undamped: max_c Σ_d |G_cd| / min_c |G_cc| ≤ 1, d of others"
    undamped = Condition.below(name, max(ratios), np.nextafter(1.0, 2.0), exact=constants.exact)
    return decisive(undamped, relay_condition(law, constants))


def _own_curvature(constants: ProblemConstants) -> Condition:
    """Whether best responses exist: no own block of dF is singular."""
    own = constants.owners[:, None] == constants.owners
    smallest = float(np.linalg.svd(np.where(own, constants.jacobian, 0.0), compute_uv=False)[-1])
    name = "each J_i is curved in x_i: smallest singular value of G_ii > 0"
    return Condition.above(name, smallest, ZERO * constants.iota_strategies, exact=constants.exact)


def _all_links_recur(constants: ProblemConstants) -> Condition:
    name = "all links recur as s → ∞: smallest number of recurring links > all links − 1"
    recurring = min(len(graph.edges) for graph in constants.recurring)
    return Condition.above(name, recurring, len(union(constants.graphs).edges) - 1)
