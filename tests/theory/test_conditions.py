"""Conditions of the laws' theorems, and the theorems where the conditions hold, on random affine games."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, random_affine, random_digraph, run
from sample_laws import condition_on
from scipy import linalg
from worlds import DIRECTED, fixed_part, loop_matrix

from ptne_env import CATALOGUE, FactorySpec, get_scenario, laws, theory
from ptne_env.games import QuadraticGame
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.parts import PARTS, resolve
from ptne_env.world.graphs import from_edges
from ptne_env.world.world import World

RANDOM = range(200 if SOAK else 6)


def random_world(seed, *, is_directed=False):
    generator = np.random.default_rng(seed)
    matrix, offset, adjacency = random_affine(generator, 3 + seed % 3, coupling=3.0)
    if is_directed:
        adjacency = random_digraph(generator, len(matrix))
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency))
    return scenario, World(scenario).game, adjacency


def positive_definite(matrix):
    return np.linalg.eigvalsh(matrix + matrix.T)[0] > 0


def test_conditions_are_decided_by_the_constants_of_the_theory():
    certificate = theory.certify(get_scenario("energy"))
    static = condition_on("energy", laws.Static)
    constants = theory.problem_constants(World(get_scenario("energy")))
    assert static == certificate.condition
    assert static.bound == theory.gain_bound(constants, constants.connectivity)
    assert (static.value, static.holds, static.exact) == (2.0, False, True)
    assert condition_on("energy", laws.Static, kappa=static.bound * 1.001).holds
    scaled = condition_on("energy", laws.Static, kappa=8.0, gradient_gain=4.0)
    assert scaled == static  # the same law for scaled costs


@pytest.mark.parametrize("scenario", ["energy", "non-quadratic"])
def test_the_condition_of_a_new_law_is_one_entry_and_never_that_of_its_base_class(scenario, monkeypatch):
    class Mine(laws.Static):
        """A law with a theorem of its own."""

    world = World(CATALOGUE[scenario])
    law, constants = theory.build_law(Mine, world), theory.problem_constants(world)
    assert theory.condition(law, constants) is None
    assert theory.certify(CATALOGUE[scenario], Mine).condition is None
    mine = lambda law, constants: theory.Condition.below("exact", float(not constants.exact), law.kappa / 4)  # noqa: E731
    monkeypatch.setitem(theory.CONDITIONS, Mine, mine)
    assert theory.condition(law, constants).holds == world.game.is_affine
    assert theory.certify(CATALOGUE[scenario], Mine).condition.bound == law.kappa / 4
    assert condition_on(scenario, laws.ZeroInput) is None


def test_only_links_that_act_again_and_again_count_as_s_grows():
    transformed = theory.problem_constants(World(CATALOGUE["energy-switching-transformed"]))
    assert transformed.connectivity == 0
    assert [graph.is_connected for graph in transformed.recurring] == [True]
    assert condition_on("energy-switching-transformed", laws.Relay).holds
    assert not condition_on("energy-switching", laws.Relay).holds  # links of its last graph alone recur


BOX = {"low": [-30.0, -1.0, -30.0, -1.0], "high": [30.0, 1.0, 30.0, 1.0]}


@pytest.mark.parametrize(
    ("players", "box", "holds"), [(2, {}, True), (2, BOX, False), (4, BOX, True)], ids=["free", "in a box", "alone"]
)
def test_best_responses_in_a_box_are_proven_for_players_of_one_component(players, box, holds):
    """In this box those of two players contract as if there were no bounds, and yet go round for ever."""
    own, response = np.array([[1, 0.5], [0.5, 1]]), 0.93 * np.outer([1.25, 1.0], [1, 0]) / np.hypot(1, 0.5)
    matrix = np.block([[own, response], [-response, own]]) if players == 2 else np.eye(4) + 0.1
    offset = [0, -50, 0, -50] - matrix @ [0, 1, 0, 1]
    game = QuadraticGame(matrix, offset, (4 // players,) * players, **box)
    scenario = get_scenario("energy", game=game, topology=FactorySpec.of("topology:path", players=players))
    assert condition_on(scenario, laws.Relay).holds == holds
    if players == 2:
        strategies = game.nash_equilibria + 0.1
        for _ in range(200):
            strategies = game.best_response(strategies)
        assert (np.abs(strategies - game.nash_equilibria).max() < 1e-3) == holds


GENEROUS = {
    **{law: {"kappa": 1e3} for law in (laws.Static, laws.CorollaryOne, laws.Grounded)},
    laws.ProjectedGradient: {"step": 0.01},
    laws.ProximalBestResponse: {"step": 0.05},
}
"""Arguments with which conditions hold in a game that is nearly the identity."""


@pytest.mark.parametrize("law", theory.CONDITIONS)
def test_in_a_box_only_proofs_that_allow_for_it_hold(law):
    game = {"matrix": np.eye(5) + 0.01, "offset": np.ones(5)}
    free, boxed = (
        condition_on(get_scenario("energy", game=QuadraticGame(**game, **box)), law, **GENEROUS.get(law, {}))
        for box in ({}, {"low": -2.0, "high": 2.0})
    )
    assert free.holds
    needs_none = law in (laws.Grounded, laws.AdaptiveGrounded, laws.ProjectedGradient)
    assert (boxed.holds, "no bounds" in boxed.name) == (not needs_none, needs_none)


@pytest.mark.parametrize("law", theory.CONDITIONS)
def test_every_condition_fails_in_a_game_without_curvature(law):
    game = QuadraticGame(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.ones(2))
    scenario = get_scenario("energy", game=game, topology=FactorySpec.of("topology:path", players=2))
    assert not condition_on(scenario, law, **GENEROUS.get(law, {})).holds


def test_conditions_that_come_from_a_linearisation_say_so():
    assert "holds, by numbers that prove nothing" in str(theory.Condition.above("x > 0", 1, 0, exact=False))
    assert str(theory.Condition.above("x > 0", 1, 0)).endswith("holds")


MODES = {
    "disconnected": [[(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)]],
    "connected": [[(0, 1), (1, 2), (2, 3), (3, 4)], [(0, 2), (2, 4), (4, 1), (1, 3)]],
}


@pytest.mark.parametrize("clock", ["physical", "transformed"])
@pytest.mark.parametrize("modes", MODES)
@pytest.mark.parametrize("law", ["law:adaptive", "law:static"])
def test_the_paper_s_laws_are_proven_where_every_mode_is_connected(law, modes, clock):
    """Over the first modes, which are jointly connected, both diverge for some strongly monotone F (errata.md, 2)."""
    graphs = [fixed_part(from_edges(5, edges).adjacency.tolist()) for edges in MODES[modes]]
    dwell = 0.25 if clock == "transformed" else 0.1
    topology = FactorySpec.of("topology:periodic", graphs=graphs, dwells=[dwell] * len(graphs), clock=clock)
    arguments = {"kappa": 1e3} if law == "law:static" else {}
    certificate = theory.certify(
        get_scenario("energy", topology=topology, start="paper"), FactorySpec.of(law, **arguments)
    )
    assert [certificate.condition.holds, certificate.condition.exact] == [modes == "connected", True]
    told = any("nothing is proven" in note or "frozen and disconnected" in note for note in certificate.notes)
    assert told == (modes == "disconnected")


def test_the_law_of_ye_and_hu_with_gains_that_adapt_is_proven_on_fixed_graphs_alone():
    """H, which depends on the graph, is in their Lyapunov function."""
    graphs = [fixed_part(from_edges(5, edges).adjacency.tolist()) for edges in MODES["connected"]]
    topology = FactorySpec.of("topology:periodic", graphs=graphs, dwells=[0.25] * 2, clock="transformed")
    assert not condition_on(get_scenario("energy", topology=topology), laws.AdaptiveGrounded).holds
    assert condition_on("energy", laws.AdaptiveGrounded).holds


@pytest.mark.parametrize("scenario", ["energy", "energy-switching", "non-quadratic", "ev-charging"])
@pytest.mark.parametrize("law", theory.CONDITIONS)
def test_every_theorem_has_its_condition_on_every_scenario(law, scenario):
    condition = condition_on(scenario, law)
    assert condition.name
    assert condition.theorem
    assert condition.holds in (True, False)
    if scenario == "non-quadratic":
        assert not condition.holds  # F is not monotone there


LAWS = [law for law in PARTS if law.startswith("law:") and law not in ("law:random", "law:coded")]


@pytest.mark.parametrize("law", LAWS)
def test_every_law_has_a_certificate_and_every_theorem_is_of_a_law(law):
    certificate = theory.certify(get_scenario("energy-switching", steps=50), FactorySpec.of(law))
    assert (certificate.condition is not None) == (resolve(law) in theory.CONDITIONS)
    assert (certificate.rate is None) == any("no rate" in note for note in certificate.notes)
    assert set(theory.CONDITIONS) <= {resolve(law) for law in LAWS}


@pytest.mark.parametrize("step", [0.2, 0.3, 3.0])
def test_the_routed_law_shortens_steps_that_do_not_settle(step):
    """Gradient play with delays equal to hop counts, on four firms: the spectral radius is 1 at η = 0.264."""
    scenario = get_scenario("oligopoly", input_limit=1e9, steps=300)
    world = World(scenario)
    encoder = Encoder(world, laws.RoutedUnknown.interface)
    states = run(world, encoder, laws.RoutedUnknown(encoder.layout, step), loop_start(world, size=1.0))[..., 0]
    errors = np.linalg.norm(states - world.game.nash_equilibrium[:, None], axis=(1, 2))
    assert errors[-1] < 1e-3 * errors[20]


def test_the_coupling_radius_promises_that_late_best_responses_settle():
    generator = np.random.default_rng(0)
    owners = np.array([0, 0, 1, 2, 2, 2])
    matrix = generator.uniform(-0.3, 0.3, (6, 6)) + np.diag(generator.uniform(1.5, 2.5, 6))
    assert theory.coupling_radius(matrix, owners) < 1
    errors = [generator.normal(size=6)] * 4
    for _ in range(200):
        late = errors[-1 - generator.integers(4)]
        blocks = [owners == player for player in range(3)]
        errors.append(
            np.concatenate([-np.linalg.solve(matrix[own][:, own], matrix[own][:, ~own] @ late[~own]) for own in blocks])
        )
    assert np.abs(errors[-1]).max() < 1e-6
    assert theory.coupling_radius(np.zeros((2, 2)), np.arange(2)) == np.inf
    diagonal = np.diag(np.diag(matrix))
    by_component = np.abs(np.linalg.eigvals(np.linalg.inv(diagonal) @ np.abs(matrix - diagonal))).max()
    assert theory.coupling_radius(matrix, np.arange(6)) == pytest.approx(by_component)


@pytest.mark.parametrize("seed", RANDOM)
def test_gain_of_the_static_law_makes_a_lyapunov_function_decrease_on_directed_graphs(seed):
    """V = ½ Σ_i ‖x̄_i − x*_i‖²/q_i + ½ Σ_i p_i ‖x^i − x̄‖² with pᵀ L = 0, max p = 1, q = p/Σ p and x̄ = Σ_i q_i x^i."""
    scenario, game, adjacency = random_world(seed, is_directed=True)
    kappa = 1.0001 * condition_on(scenario, laws.Static).bound
    laplacian, n = np.diag(adjacency.sum(axis=1)) - adjacency, game.dimension
    left = np.abs(linalg.null_space(laplacian.T)[:, 0])
    left, share = left / left.max(), left / left.sum()
    mean = np.kron(share, np.eye(n))
    rest = np.eye(n * n) - np.kron(np.ones((n, 1)), mean)
    lyapunov = mean.T @ np.diag(1 / share) @ mean + rest.T @ np.diag(np.repeat(left, n)) @ rest
    assert positive_definite(lyapunov)
    assert positive_definite(lyapunov @ loop_matrix(game, adjacency, kappa))


@pytest.mark.parametrize("law", theory.CONDITIONS)
def test_on_directed_graphs_only_laws_with_a_proof_of_their_own_have_a_condition_that_holds(law):
    """The theorems of the others need symmetric or doubly stochastic weights."""
    game = FactorySpec.of("game:quadratic", matrix=np.eye(5) + 0.01, offset=np.ones(5))
    scenario = DIRECTED.replace(game=game, topology=5 * np.roll(np.eye(5), 1, axis=0))
    proven = (laws.Static, laws.CorollaryOne, laws.Grounded, laws.RoutedUnknown, laws.Relay)
    assert condition_on(scenario, law, **GENEROUS.get(law, {})).holds == (law in proven)
    certificate = theory.certify(scenario, law)
    assert [check.verdict for check in certificate.assumptions[1:3]] == ["fails"] * 2
    assert any("links are directed: the paper's theorems do not cover" in note for note in certificate.notes)


def test_conditions_name_their_theorem():
    theorems = {law: condition_on("energy", law).theorem for law in (laws.Static, laws.CorollaryOne, laws.Adaptive)}
    assert list(theorems.values()) == ["Theorem 1", "Corollary 1", "Theorem 3"]
    assert condition_on("energy-switching", laws.Adaptive).theorem.startswith("Theorem 4 as corrected")
    directed = condition_on(DIRECTED, laws.Static)
    assert (directed.theorem, directed.name) == ("directed graphs (docs/mathematics.md)", "κ > (ι²/ε + ι)/λ")


def test_the_gain_of_the_static_law_is_proven_on_one_directed_graph_and_not_on_several():
    graphs = [fixed_part(np.roll(np.eye(5), shift, axis=0).tolist()) for shift in (1, 2)]
    topology = FactorySpec.of("topology:periodic", graphs=graphs, dwells=[0.25] * 2, clock="transformed")
    assert condition_on(DIRECTED, laws.Static, kappa=1e3).holds
    assert not condition_on(get_scenario("energy", topology=topology), laws.Static, kappa=1e3).holds


def test_links_that_recur_in_one_direction_only_are_missing():
    modes = [DIRECTED.topology, fixed_part(np.roll(np.eye(5), 1, axis=0).tolist())]
    for graphs, holds in ((modes, False), (modes[::-1], True)):
        topology = FactorySpec.of("topology:periodic", graphs=graphs, dwells=[0.7, 0.7], clock="physical")
        assert condition_on(get_scenario("energy", topology=topology), laws.Relay).holds == holds


def grounded_matrix(game, adjacency, kappa):
    """The loop of Ye & Hu's law: own components follow own gradients, the others leader–follower consensus."""
    n = game.dimension
    laplacian = np.diag(adjacency.sum(axis=1)) - adjacency
    matrix = kappa * np.kron(laplacian, np.eye(n))
    jacobian = game.jacobian(np.zeros((n, 1)))[:, :, 0]
    for i in range(n):
        for j in range(n):
            if i != j:
                matrix[i * n + j, i * n + j] += kappa * adjacency[i, j]
                matrix[i * n + j, j * n + j] -= kappa * adjacency[i, j]
        matrix[i * n + i] = 0
        matrix[i * n + i, i * n : (i + 1) * n] = jacobian[i]
    return matrix


@pytest.mark.parametrize("is_directed", [False, True])
@pytest.mark.parametrize("seed", RANDOM)
def test_gain_of_ye_and_hu_makes_their_lyapunov_function_decrease(seed, is_directed):
    """V = ½‖x − x*‖² + ½‖y‖² in the coordinates x and y^i_j = x^i_j − x_j, as in the condition of :class:`Grounded`."""
    scenario, game, adjacency = random_world(seed, is_directed=is_directed)
    if np.isinf(condition_on(scenario, laws.Grounded).bound):
        assert is_directed
        return
    kappa = 1.0001 * condition_on(scenario, laws.Grounded).bound
    slow = {"kappa": kappa / 10, "gradient_gain": 0.1}  # the same loop in another unit of time
    assert condition_on(scenario, laws.Grounded, **slow).value == pytest.approx(kappa)
    n = game.dimension
    matrix = grounded_matrix(game, adjacency, kappa)
    own = [i * n + i for i in range(n)]
    to_original = np.eye(n * n)  # of (x, y)
    for i in range(n):
        for j in range(n):
            to_original[i * n + j, j * n + j] = 1
    assert positive_definite(np.linalg.solve(to_original, matrix @ to_original))
    assert np.linalg.eigvals(matrix).real.min() > 0
    assert np.array_equal(matrix[own][:, own], np.diag(np.diag(game.matrix)))
