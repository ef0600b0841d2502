import json
import math

import numpy as np
import pytest

from ptne_env import theory
from ptne_env.games import EnergyGame, Game, NonQuadraticGame
from ptne_env.world.catalogue import CATALOGUE, get_scenario
from ptne_env.world.clock import Exponential, HyperbolicTangent, Rational
from ptne_env.world.graphs import Graph, complete, cycle, path
from ptne_env.world.switching import fixed, paper_topology
from ptne_env.world.world import World


class BlockGame(Game):
    """An affine game with blocks of different sizes, F(x) = A x − 1, whose Jacobian is unknown."""

    is_affine = True

    def __init__(self, matrix, dims=(2, 1, 3)):
        super().__init__(dims)
        self.matrix = np.asarray(matrix, dtype=float)

    def costs(self, strategies):
        gradient = np.zeros((self.num_players, strategies.shape[1]))
        for i in range(self.num_players):
            own = self.owners == i
            square, cross = self.matrix[np.ix_(own, own)], self.matrix[np.ix_(own, ~own)]
            x, rest = strategies[own], strategies[~own]
            gradient[i] = (x * (square @ x)).sum(0) / 2 + (x * (cross @ rest)).sum(0) - x.sum(0)
        return gradient

    def own_gradients(self, estimates):
        return np.einsum("kj,jkb->kb", self.matrix, estimates[:, self.owners]) - 1

    def best_response(self, strategies):
        raise NotImplementedError


@pytest.fixture(scope="module")
def block_game():
    generator = np.random.default_rng(3)
    root = generator.normal(size=(6, 6))
    symmetric = root @ root.T / 6 + np.eye(6)
    return BlockGame(symmetric + _skew(generator))


def _skew(generator):
    """A skew part between different players keeps every own Hessian symmetric."""
    skew = generator.normal(size=(6, 6))
    skew = skew - skew.T
    owners = np.repeat([0, 1, 2], [2, 1, 3])
    return np.where(owners[:, None] == owners, 0.0, skew)


def test_constants_of_the_energy_game_are_exact():
    constants = theory.monotonicity_constants(EnergyGame())
    assert constants.exact
    assert constants.radius is None
    assert constants.epsilon == pytest.approx(2.1, abs=1e-12)
    assert constants.iota == pytest.approx(2.6, abs=1e-12)
    assert constants.iota_strategies == pytest.approx(2.6, abs=1e-12)
    assert constants.iota_estimates == pytest.approx(math.sqrt(2.2**2 + 4 * 0.1**2), abs=1e-12)


def test_constants_of_another_game_are_labelled_as_sampled():
    near = theory.monotonicity_constants(NonQuadraticGame(), radius=5.0)
    far = theory.monotonicity_constants(NonQuadraticGame(), radius=30.0)
    assert not near.exact
    assert (near.samples, near.radius) == (256, 5.0)
    assert near.epsilon < 0  # so F is refuted to be monotone
    assert far.iota > 100 * near.iota  # and no Lipschitz constant is in sight


def test_constants_without_a_jacobian_come_from_differences(block_game):
    assert block_game.jacobian(np.zeros((6, 1))) is None
    constants = theory.monotonicity_constants(block_game)
    symmetric = (block_game.matrix + block_game.matrix.T) / 2
    assert constants.exact
    assert constants.epsilon == pytest.approx(np.linalg.eigvalsh(symmetric)[0], rel=1e-8)
    assert constants.iota_strategies == pytest.approx(np.linalg.norm(block_game.matrix, 2), rel=1e-8)
    rows = [np.linalg.norm(block_game.matrix[block_game.owners == i], 2) for i in range(3)]
    assert constants.iota_estimates == pytest.approx(max(rows), rel=1e-8)


@pytest.mark.parametrize("arguments", [{"samples": 0}, {"radius": 0.0}, {"radius": math.inf}])
def test_constants_refuse_bad_sampling(arguments):
    with pytest.raises(ValueError, match="must be"):
        theory.monotonicity_constants(NonQuadraticGame(), **arguments)


def test_lipschitz_constants_bound_the_stacked_gradient(block_game):
    constants = theory.monotonicity_constants(block_game)
    generator = np.random.default_rng(0)
    x, y = generator.normal(size=(2, 6, 3, 200))
    change = block_game.own_gradients(x) - block_game.own_gradients(y)
    size = np.sqrt(((x - y) ** 2).sum(axis=(0, 1)))
    assert np.all(np.linalg.norm(change, axis=0) <= constants.iota_estimates * size * (1 + 1e-9))


def test_gain_condition_of_the_paper():
    constants = theory.monotonicity_constants(EnergyGame())
    ring = cycle(5).algebraic_connectivity
    bound = theory.gain_bound(constants, ring)
    assert bound == pytest.approx((2.6**2 / 2.1 + 2.6) / ring, rel=1e-12)
    assert bound == pytest.approx(4.2107, abs=1e-4)
    assert theory.gain_bound(constants, 0.0) == math.inf
    assert theory.gain_bound(theory.monotonicity_constants(NonQuadraticGame()), ring) == math.inf


def test_closed_loop_matrix_is_the_loop_in_player_major_order(block_game):
    graph, kappa = Graph([[0, 2, 0], [2, 0, 0.5], [0, 0.5, 0]]), 1.7
    matrix = theory.closed_loop_matrix(block_game, graph, kappa)
    error = np.random.default_rng(1).normal(size=(3, 6))
    expected = np.zeros((3, 6))
    for i in range(3):
        for k in np.flatnonzero(block_game.owners == i):
            expected[i, k] = block_game.matrix[k] @ error[i]
        for j in range(3):
            expected[i] += kappa * graph.adjacency[i, j] * (error[i] - error[j])
    np.testing.assert_allclose(matrix @ error.ravel(), expected.ravel(), atol=1e-8)


def rate_of_the_static_law(topology, kappa=2.0, deadline=1.2):
    matrices = [theory.closed_loop_matrix(EnergyGame(), graph, kappa) for graph in topology.graphs]
    return theory.decay_rate(matrices, topology, deadline)


def test_closed_loop_matrix_refuses_other_players_and_negative_gains():
    with pytest.raises(ValueError, match="players"):
        theory.closed_loop_matrix(EnergyGame(), cycle(4), 2.0)
    with pytest.raises(ValueError, match="kappa"):
        theory.closed_loop_matrix(EnergyGame(), cycle(5), -1.0)


def test_rate_on_the_cycle():
    assert rate_of_the_static_law(fixed(cycle(5))) == pytest.approx(0.2801, abs=1e-4)


def test_rate_of_a_large_gain_is_that_of_gradient_play_shared_by_all():
    # As κ → ∞ all estimates agree and follow x̄' = −F(x̄)/N.
    assert rate_of_the_static_law(fixed(complete(5)), 1e5) == pytest.approx(2.1 / 5, rel=1e-4)


def test_rate_in_t_is_that_of_the_last_graph():
    assert rate_of_the_static_law(paper_topology(0.1, "physical")) == 0.0
    # With a connected graph last, its own rate counts alone.
    mixed = type(paper_topology())([path(5), cycle(5)], [1.0, 5.0], "physical")
    assert rate_of_the_static_law(mixed) == pytest.approx(0.2801, abs=1e-4)
    expected = rate_of_the_static_law(fixed(path(5)))
    assert rate_of_the_static_law(mixed, deadline=0.5) == pytest.approx(expected, rel=1e-12)


def test_rate_in_s_is_the_floquet_rate():
    topology = paper_topology(0.25, "transformed")
    assert rate_of_the_static_law(topology) == pytest.approx(0.1551, abs=1e-4)
    # Fast switching averages the graphs: every edge of the cycle is on for half the time or a quarter of it.
    mean = Graph(np.mean([graph.adjacency for graph in topology.graphs], axis=0))
    fast = rate_of_the_static_law(paper_topology(1e-4, "transformed"))
    assert fast == pytest.approx(rate_of_the_static_law(fixed(mean)), rel=1e-4)


def test_largest_stable_step_separates_contraction_from_growth():
    matrix = theory.closed_loop_matrix(EnergyGame(), cycle(5), 2.0)
    step = theory.largest_stable_step(matrix)
    assert step is not None
    identity = np.eye(25)
    assert np.abs(np.linalg.eigvals(identity - 0.999 * step * matrix)).max() < 1
    assert np.abs(np.linalg.eigvals(identity - 1.001 * step * matrix)).max() > 1
    assert theory.largest_stable_step(-matrix) is None
    assert theory.largest_stable_step(np.zeros((3, 3))) is None
    assert theory.largest_stable_step(np.diag([0.0, 1.0, 4.0])) == pytest.approx(0.5)


@pytest.mark.parametrize(("kind", "growth"), [(Exponential, 1.0), (HyperbolicTangent, 2.0), (Rational, 0.0)])
def test_gain_growth(kind, growth):
    assert theory.gain_growth(kind(1.2)) == pytest.approx(growth, abs=0.02)


def test_certificate_of_the_energy_scenario():
    certificate = theory.certify(get_scenario("energy"))
    assert [check.verdict for check in certificate.assumptions] == ["holds"] * 4
    assert not certificate.condition.holds
    assert certificate.rate_is_exact
    assert certificate.rate == pytest.approx(0.2801, abs=1e-4)
    assert certificate.digits_from_rate == pytest.approx(0.28014661 * 32 / math.log(10), abs=1e-6)
    assert certificate.shortfall == pytest.approx(math.exp(-8), rel=1e-9)
    assert not certificate.velocity_bounded
    assert not certificate.energy_finite
    assert certificate.step_margin == pytest.approx(2.97, abs=0.01)


def test_sampled_digits_are_those_of_a_plain_loop():
    scenario = get_scenario("energy-switching")
    game, clock, topology = World(scenario).game, World(scenario).clock, World(scenario).topology
    estimates = World(scenario).start.draw(5, 5, np.random.default_rng(0))[:, :, None]
    for k in range(clock.steps):
        graph = topology.graphs[int(topology.schedule(clock.t[k]).modes)]
        u = -2.0 * np.einsum("ij,kjb->kib", graph.laplacian, estimates)
        gradients = game.own_gradients(estimates)
        for i in range(5):
            u[i, i] -= gradients[i]
        estimates = estimates + clock.theta[k] * u
    error = estimates[:, :, 0] - game.nash_equilibrium[:, None]
    distance = np.linalg.norm(error) / (math.sqrt(5) * np.linalg.norm(game.nash_equilibrium))
    assert theory.certify(scenario).digits_sampled == pytest.approx(-math.log10(distance), abs=1e-9)


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_every_certificate_is_plain_json(name):
    data = theory.certify(CATALOGUE[name], delay_limit=1).to_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert len(data["assumptions"]) == 4


def test_certificate_of_the_non_quadratic_game_claims_nothing_unproved():
    certificate = theory.certify(get_scenario("non-quadratic"))
    assert [check.verdict for check in certificate.assumptions] == ["holds", "holds", "fails", "fails"]
    assert certificate.condition.bound == math.inf
    assert not certificate.condition.holds
    assert certificate.digits_sampled is None
    assert not certificate.rate_is_exact
    assert any("linearisation" in note for note in certificate.notes)


def test_certificate_warns_of_a_frozen_graph():
    certificate = theory.certify(get_scenario("energy-switching"))
    assert certificate.assumptions[0].verdict == "fails"
    assert certificate.assumptions[1].verdict == "holds"
    assert certificate.rate == 0.0
    assert certificate.energy_finite  # the frozen graph lets u vanish, at a rate above 1/2, though short of x*
    assert any("switches 11 times before T" in note for note in certificate.notes)


def test_certificate_notes_a_short_horizon_saturation_and_a_random_start():
    scenario = get_scenario("energy", s_end=3.0, input_limit=10.0, start="random")
    with pytest.warns(UserWarning, match="short of the deadline"):
        notes = " ".join(theory.certify(scenario).notes)
    for phrase in ("short of the deadline", "above the input limit", "start is random"):
        assert phrase in notes


def test_certificate_of_an_unstable_loop_stays_finite():
    certificate = theory.certify(get_scenario("energy", steps=20), kappa=50.0)
    assert certificate.step_margin is not None
    assert certificate.step_margin < 1
    assert certificate.digits_sampled is not None
    assert certificate.digits_sampled < -5
    json.dumps(certificate.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("kind", "bounded", "finite"), [("exponential", False, False), ("rational", True, True), ("tanh", False, False)]
)
def test_velocity_depends_on_how_fast_the_gain_grows(kind, bounded, finite):
    long = {"rational": 200.0}.get(kind, 8.0)
    certificate = theory.certify(get_scenario("energy", transformation=kind, s_end=long, steps=1000))
    assert (certificate.velocity_bounded, certificate.energy_finite) == (bounded, finite)


def test_kappa_must_not_be_negative():
    with pytest.raises(ValueError, match="kappa"):
        theory.certify(get_scenario("energy"), kappa=-1.0)
