"""The conditions of the laws' theorems, which compare numbers of a scenario with those that a theorem needs.

They are sufficient for convergence, not necessary. :data:`CONDITIONS` is the table of them; the condition of a law of
your own is one more entry::

    theory.CONDITIONS[MyLaw] = lambda law, constants: Condition.above("κ > 1/λ2", law.kappa, 1 / constants.connectivity)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ptne_env.evaluation.metrics import number
from ptne_env.laws import (
    Adaptive,
    AdaptiveGrounded,
    CorollaryOne,
    Grounded,
    Law,
    ProjectedGradient,
    ProximalBestResponse,
    Relay,
    RoutedUnknown,
    Static,
)
from ptne_env.shared.arrays import FloatArray, IntArray
from ptne_env.theory.constants import ProblemConstants, gain_bound, rounding_error
from ptne_env.world.graphs import union


@dataclass(frozen=True)
class Condition:
    """The outcome of the condition of a theorem on a scenario.

    Attributes:
        name: the condition in words or symbols, with the direction in which ``value`` is compared with ``bound``.
        value: the number that decides.
        bound: the number that it is compared with; infinite where no number would do.
        holds: whether the scenario meets the condition.
        exact: whether the numbers are exact; otherwise they come from samples or a linearisation and prove nothing.
        theorem: the theorem, by its number in the paper, its authors, or the page that proves it.
    """

    name: str
    value: float
    bound: float
    holds: bool
    exact: bool = True
    theorem: str = ""

    def __str__(self) -> str:
        holds = "holds" if self.exact else "holds, by numbers that prove nothing, as F is not affine"
        verdict = holds if self.holds else "fails (sufficient, not necessary)"
        theorem = f"{self.theorem}: " * bool(self.theorem)
        return f"{theorem}{self.name}; {number(self.value)} against {number(self.bound)}: {verdict}"

    @classmethod
    def above(cls, name: str, value: float, bound: float, *, exact: bool = True) -> Condition:
        """Return the condition value > bound."""
        return cls(name, float(value), float(bound), bool(value > bound), exact)

    @classmethod
    def below(cls, name: str, value: float, bound: float, *, exact: bool = True) -> Condition:
        """Return the condition value < bound."""
        return cls(name, float(value), float(bound), bool(value < bound), exact)


def decisive(theorem: str, *conditions: Condition) -> Condition:
    """Return the condition that decides whether a theorem holds: the first that fails, or else the last."""
    deciding = next((condition for condition in conditions if not condition.holds), conditions[-1])
    return replace(deciding, theorem=theorem)


def _strongly_monotone(constants: ProblemConstants) -> Condition:
    return Condition.above("F is strongly monotone: ε > 0", constants.epsilon, 0.0, exact=constants.exact)


def _adapting_gains(law: Adaptive | AdaptiveGrounded) -> Condition:
    return Condition.above("the gains adapt: γ > 0", np.min(law.gamma), 0.0)


def _fixed_graph(constants: ProblemConstants) -> Condition:
    return Condition.below("the graph is fixed: number of graphs < 2", len(constants.graphs), 2)


def _undirected(constants: ProblemConstants) -> Condition:
    count = constants.directed_graphs
    return Condition("all links are undirected: number of directed graphs = 0", count, 0, holds=count == 0)


def _no_bounds(constants: ProblemConstants, *, unless_alone: bool = False) -> Condition:
    """Return the condition that no component has a bound; ``unless_alone``, the only one of a player may have one."""
    several = np.bincount(constants.owners)[constants.owners] > 1
    count = int(np.count_nonzero(constants.is_bounded & (several | (not unless_alone))))
    of = " of players of several components" * unless_alone
    return Condition(f"no bounds: number of bounded components{of} = 0", count, 0, holds=count == 0)


def _all_links_recur(constants: ProblemConstants) -> Condition:
    name = "all links recur as s → ∞: smallest number of recurring links > all links − 1"
    recurring = min(int(np.count_nonzero(graph.adjacency)) for graph in constants.recurring)
    return Condition.above(name, recurring, int(np.count_nonzero(union(constants.graphs).adjacency)) - 1)


def _gain_condition(kappa: float, constants: ProblemConstants) -> Condition:
    bound = gain_bound(constants, constants.connectivity)
    name = f"κ > (ι²/ε + ι)/λ{'' if constants.directed_graphs else '2'}"
    return Condition.above(name, kappa, bound, exact=constants.exact)


# --- the condition of each law ---------------------------------------------------------------------------------------


def static_condition(law: Static, constants: ProblemConstants) -> Condition:
    """κ > (ι²/ε + ι)/λ2, eq. (15) of the paper; with scaled costs, κ divided by the gradient gain.

    It is the condition of Corollary 1 too, whose convergence is asymptotic, not by the deadline. On one directed graph
    it is ours, with the λ of :attr:`~ptne_env.world.graphs.Graph.algebraic_connectivity` (docs/mathematics.md).
    """
    gain = _gain_condition(law.kappa / law.gradient_gain, constants)
    if constants.directed_graphs:
        return decisive("directed graphs (docs/mathematics.md)", _fixed_graph(constants), gain)
    return decisive("Corollary 1" if isinstance(law, CorollaryOne) else "Theorem 1", gain)


def adaptive_condition(law: Adaptive, constants: ProblemConstants) -> Condition:
    """γ > 0 on all links, ε > 0, and every mode connected: the W of Theorem 3 then serves all modes, on either clock.

    Joint connectivity, as in Theorem 4, is not enough (docs/errata.md, 2).
    """
    connected = Condition.above("every mode is connected: λ2 > 0", constants.connectivity, 0.0)
    theorem = "Theorem 3" if len(constants.graphs) == 1 else "Theorem 4 as corrected (docs/errata.md, 2)"
    return decisive(theorem, _undirected(constants), _adapting_gains(law), connected, _strongly_monotone(constants))


def grounded_condition(law: Grounded, constants: ProblemConstants) -> Condition:
    """κ/δ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ, with λ the smallest eigenvalue of the grounded Laplacians.

    λ is negative on some directed graphs. The paper proves that a large enough κ/δ exists (there κ = 1). This one is
    large enough, for with time in units of 1/δ, d/dτ ½(‖x − x*‖² + ‖y‖²), y being the estimates minus the strategies
    that they estimate, is at most −ε a² + (ι + √(N−1) ι_F) a b − (κ λ/δ − √(N−1) ι) b² with a = ‖x − x*‖ and b = ‖y‖.
    """
    grounded, bound = _grounded_connectivity(constants), np.inf
    if constants.epsilon > 0 and grounded > 0:
        others = np.sqrt(constants.num_players - 1)
        cross = constants.iota_estimates + others * constants.iota_strategies
        bound = (cross**2 / (4 * constants.epsilon) + others * constants.iota_estimates) / grounded
    name = f"κ/δ > ((ι + √(N−1) ι_F)²/(4ε) + √(N−1) ι)/λ, λ = {grounded:.3g}"
    gain = Condition.above(name, law.kappa / law.gradient_gain, bound, exact=constants.exact)
    return decisive("Ye and Hu (2017)", _no_bounds(constants), gain)


def _grounded_connectivity(constants: ProblemConstants) -> float:
    """Return the smallest eigenvalue of the symmetric parts of H_j = L without row and column j, plus diag(a_ij)."""
    if constants.connectivity == 0:
        return 0.0
    smallest = np.inf
    for laplacian in (graph.laplacian for graph in constants.graphs):
        for leader in range(len(laplacian)):
            others = np.arange(len(laplacian)) != leader
            matrix = laplacian[np.ix_(others, others)] - np.diag(laplacian[others, leader])
            smallest = min(smallest, float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[0]))
    return smallest


def adaptive_grounded_condition(law: AdaptiveGrounded, constants: ProblemConstants) -> Condition:
    """γ > 0, ε > 0, a fixed undirected graph, as H, the grounded Laplacian, is in V = ½‖x − x*‖² + ½ yᵀ H y + gains."""
    needed = _undirected(constants), _fixed_graph(constants), _no_bounds(constants), _strongly_monotone(constants)
    return decisive("Ye and Hu (2021)", _adapting_gains(law), *needed)


def projected_gradient_condition(law: ProjectedGradient, constants: ProblemConstants) -> Condition:
    """ρ = λ_max(M_α) < 1: every iteration then shrinks ‖𝐱 − 1⊗x*‖ by √ρ at least, on every sequence of modes.

    M_α = [[1 − 2αε/N + α²ι_F²/N, ασ(ι + ι_F + αιι_F)/√N], [·, σ²(1 + αι)²]] bounds the growth of
    (‖consensus error‖, ‖disagreement‖)², with σ the largest ‖I − h L − 11ᵀ/N‖ over the modes, the factor by which
    mixing shrinks disagreement; it is 1 as soon as a mode is disconnected. W keeps the mean on undirected graphs. In a
    box the environment also projects what was mixed, which the proof does not do.
    """
    alpha, players = law.step, constants.num_players
    iota_strategies, iota = constants.iota_strategies, constants.iota_estimates
    mixed = [np.eye(players) - law.mixing * graph.laplacian - 1 / players for graph in constants.graphs]
    sigma = max(float(np.linalg.norm(matrix, 2)) for matrix in mixed)
    mean = 1 - 2 * alpha * constants.epsilon / players + (alpha * iota_strategies) ** 2 / players
    cross = alpha * sigma * (iota + iota_strategies + alpha * iota * iota_strategies) / np.sqrt(players)
    contraction = np.array([[mean, cross], [cross, sigma**2 * (1 + alpha * iota) ** 2]])
    shrinks = Condition.below("λ_max(M_α) < 1", np.linalg.eigvalsh(contraction)[-1], 1.0, exact=constants.exact)
    needed = _undirected(constants), _no_bounds(constants), _strongly_monotone(constants), shrinks
    return decisive("Bianchi and Grammatico (2021)", *needed)


def proximal_condition(law: ProximalBestResponse, constants: ProblemConstants) -> Condition:
    """h/α > (ι²/ε + ι)/λ2 on a fixed undirected graph, and h Σ_j a_ij < 1, once the rows of dF are identified.

    The law is the proximal-point method with the preconditioner I + W for the inclusion 0 ∈ α Rᵀ**F**(𝐱) + (I − W) 𝐱,
    W = I − h L. That operator is α times the one of Theorem 1 with κ = h/α, so the gain condition makes it restricted
    strongly monotone, and 𝐱 converges linearly where I + W is positive definite.
    """
    return decisive(
        "Bianchi, Belgioioso and Grammatico (2019)",
        _undirected(constants),
        _fixed_graph(constants),
        _no_bounds(constants, unless_alone=True),
        Condition.below("W is stochastic: h max Σ_j a_ij < 1", law.mixing * constants.largest_degree, 1.0),
        _gain_condition(law.mixing / law.step, constants),
    )


def relay_condition(law: Relay, constants: ProblemConstants) -> Condition:  # noqa: ARG001 - it has no gain
    """ε > 0, ρ(B) < 1 with B_ij = ‖G_ii⁻¹ G_ij‖ for i ≠ j and G = dF, and all links act again and again.

    Then best responses contract in a weighted maximum norm, with copies of any age
    (:func:`coupling_radius`), so also along paths that switch. A bound keeps that true where it confines the only
    component of a player; of several components, the response in a box may be farther off than that without one.
    """
    radius = coupling_radius(constants.jacobian, constants.owners)
    return decisive(
        "Bertsekas and Tsitsiklis (1989)",
        _strongly_monotone(constants),
        _all_links_recur(constants),
        _no_bounds(constants, unless_alone=True),
        Condition.below("ρ(B) < 1, B_ij = ‖G_ii⁻¹ G_ij‖", radius, 1.0, exact=constants.exact),
    )


def routed_condition(law: RoutedUnknown, constants: ProblemConstants) -> Condition:
    """ε > 0, ρ(D⁻¹ |dF − D|) < 1 with D the diagonal of dF, η max D < 1, and all links act again and again.

    Gradient steps then contract as best responses do, with an owner for each component (:func:`coupling_radius`), in
    boxes, too.
    """
    steepest = constants.jacobian.diagonal().max()
    radius = coupling_radius(constants.jacobian, np.arange(len(constants.jacobian)))
    return decisive(
        "Bertsekas and Tsitsiklis (1989)",
        _strongly_monotone(constants),
        _all_links_recur(constants),
        Condition.below("η max D < 1, D = diag(dF)", law.step * steepest, 1.0, exact=constants.exact),
        Condition.below("ρ(D⁻¹ |dF − D|) < 1", radius, 1.0, exact=constants.exact),
    )


CONDITIONS: dict[type[Law], Callable[[Any, ProblemConstants], Condition]] = {
    Static: static_condition,
    CorollaryOne: static_condition,
    Adaptive: adaptive_condition,
    Grounded: grounded_condition,
    AdaptiveGrounded: adaptive_grounded_condition,
    ProjectedGradient: projected_gradient_condition,
    ProximalBestResponse: proximal_condition,
    Relay: relay_condition,
    RoutedUnknown: routed_condition,
}
"""The condition of each law that has a theorem, by its class. A subclass is another law and needs its own entry."""


def condition(law: Law, constants: ProblemConstants) -> Condition | None:
    """Return the condition of the theorem of a law on the scenario for which it was built; ``None`` without one."""
    of_law = CONDITIONS.get(type(law))
    return None if of_law is None else of_law(law, constants)


def coupling_radius(jacobian: FloatArray, owners: IntArray) -> float:
    """Return ρ(B) with B_ij = ‖G_ii⁻¹ G_ij‖, G = dF; below 1, best-response play settles for every delay.

    B_ii is 0. It holds for delays that change and differ, as long as every copy is renewed again and again: D. P.
    Bertsekas and J. N. Tsitsiklis, "Parallel and Distributed Computation", 1989, Section 6.2; docs/theory.md has the
    argument. With an owner per component, gradient play with steps η dF_cc ≤ 1 settles, too.

    Args:
        jacobian: dF, shape (n, n).
        owners: the player of each component, shape (n,).

    Returns:
        The radius; infinite where some G_ii is singular, so that no best response exists.
    """
    blocks = [np.flatnonzero(owners == player) for player in range(int(owners.max()) + 1)]
    coupling = np.zeros((len(blocks), len(blocks)))
    for i, own in enumerate(blocks):
        square = jacobian[np.ix_(own, own)]
        if np.linalg.svd(square, compute_uv=False)[-1] <= rounding_error(jacobian):
            return np.inf
        response = np.linalg.solve(square, jacobian[own])
        for j, other in enumerate(blocks):
            coupling[i, j] = 0.0 if i == j else np.linalg.norm(response[:, other], 2)
    return float(np.abs(np.linalg.eigvals(coupling)).max())
