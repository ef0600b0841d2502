"""Matrices of closed loops, their rates and stable steps, against loops written by hand and matrix exponentials."""

import numpy as np
import pytest
from affine_games import random_affine
from sample_games import BlockGame
from sample_laws import Damped, Sign
from scipy import linalg
from worlds import BLOCKS, world_and_encoder

from ptne_env import get_scenario, laws, theory
from ptne_env.games import EnergyGame, QuadraticGame
from ptne_env.theory.closed_loop import NoClosedLoopError
from ptne_env.world.clock import Exponential, HyperbolicTangent, Rational
from ptne_env.world.graphs import Graph, cycle, path
from ptne_env.world.switching import SwitchingTopology, fixed, paper_topology
from ptne_env.world.world import World

RATE = 0.28014661
"""Spectral abscissa of the static law, κ = 2, on the energy game and the 5-cycle."""


def build(scenario, law, **arguments):
    world, encoder = world_and_encoder(scenario, kind="physical")
    return world, law(encoder.layout, **arguments)


def by_hand(game, graph, error, kappa):
    """M e of the static law, with e of shape (N, n)."""
    result = np.zeros_like(error)
    for k, owner in enumerate(game.owners):
        result[owner, k] = game.matrix[k] @ error[owner]
    for i in range(game.num_players):
        for j in range(game.num_players):
            result[i] += kappa * graph.adjacency[i, j] * (error[i] - error[j])
    return result


def test_closed_loop_matrix_is_the_loop_in_player_major_order():
    game, graph = BlockGame(), Graph([[0, 2, 0], [2, 0, 0.5], [0, 0.5, 0]])
    matrix = theory.closed_loop_matrix(game, graph, 1.7)
    error = np.random.default_rng(1).normal(size=(3, 6))
    np.testing.assert_allclose(matrix @ error.ravel(), by_hand(game, graph, error, 1.7).ravel(), atol=1e-12)
    with pytest.raises(ValueError, match="players"):
        theory.closed_loop_matrix(EnergyGame(), cycle(4), 2.0)
    with pytest.raises(ValueError, match="kappa"):
        theory.closed_loop_matrix(EnergyGame(), cycle(5), -1.0)


@pytest.mark.parametrize("scenario", ["energy", BLOCKS, "ev-charging", "non-quadratic"])
def test_measured_matrix_of_the_static_law_is_the_closed_loop_matrix(scenario):
    world, law = build(scenario, laws.Static, kappa=1.7)
    graph = world.topology.graphs[0]
    measured = theory.law_matrix(law, world.game, graph)
    np.testing.assert_allclose(measured, theory.closed_loop_matrix(world.game, graph, 1.7), atol=1e-6)
    assert len(measured) == world.game.num_players * world.game.dimension - world.game.held_at_equilibrium.sum()


def test_laws_without_a_closed_loop_give_the_reason():
    world, sign = build("energy", Sign)
    with pytest.raises(NoClosedLoopError, match="Sign is not linear"):
        theory.law_matrix(sign, world.game, world.topology.graphs[0])
    with pytest.raises(NoClosedLoopError, match="the gains of Damped depend on time"):
        theory.sampled_loop(*build("energy", Damped))


def matrices(topology, kappa=2.0):
    return [theory.closed_loop_matrix(EnergyGame(), graph, kappa) for graph in topology.graphs]


def rate_of_the_static_law(topology, kappa=2.0, deadline=1.2, clock="effective"):
    return theory.decay_rate(matrices(topology, kappa), topology, deadline, clock)


def test_rate_on_the_cycle_is_that_of_the_matrix_exponential():
    assert rate_of_the_static_law(fixed(cycle(5))) == pytest.approx(RATE, abs=1e-8)
    matrix = matrices(fixed(cycle(5)))[0]
    late, later = (np.linalg.norm(linalg.expm(-matrix * tau), 2) for tau in (60.0, 80.0))
    assert np.log(late / later) / 20 == pytest.approx(RATE, rel=1e-6)


@pytest.mark.parametrize("players", [3, 6])
def test_for_a_large_gain_the_rate_is_that_of_gradient_play_shared_by_all_players(players):
    """Min Re eig(dF)/N, which is more than ε/N where F is not symmetric."""
    matrix, offset, _ = random_affine(np.random.default_rng(0), players, coupling=2.0)
    game = QuadraticGame(matrix, offset)
    slowest = np.linalg.eigvals(matrix).real.min()
    assert theory.monotonicity_constants(game).epsilon < 0.9 * slowest
    rate = theory.spectral_abscissa(theory.closed_loop_matrix(game, cycle(players), 1e6))
    assert rate == pytest.approx(slowest / players, rel=1e-3)


def test_rate_in_t_is_that_of_the_last_graph():
    assert rate_of_the_static_law(paper_topology(0.1, "physical")) == 0.0  # which is disconnected
    mixed = SwitchingTopology([path(5), cycle(5)], [1.0, 5.0], "physical")
    assert rate_of_the_static_law(mixed) == pytest.approx(RATE, abs=1e-8)
    assert rate_of_the_static_law(mixed, deadline=0.5) == pytest.approx(rate_of_the_static_law(fixed(path(5))))


def test_rate_in_s_is_the_floquet_rate():
    topology = paper_topology(0.25, "transformed")
    moves = [linalg.expm(-matrix * dwell) for matrix, dwell in zip(matrices(topology), topology.dwells, strict=True)]
    period = np.linalg.multi_dot(moves[::-1])
    late, later = (np.linalg.norm(np.linalg.matrix_power(period, power), 2) for power in (100, 2000))
    expected = np.log(late / later) / (1900 * topology.period)
    assert rate_of_the_static_law(topology) == pytest.approx(expected, rel=1e-3)
    # Fast switching averages the graphs.
    mean = Graph(np.mean([graph.adjacency for graph in topology.graphs], axis=0))
    fast = rate_of_the_static_law(paper_topology(1e-4, "transformed"))
    assert fast == pytest.approx(rate_of_the_static_law(fixed(mean)), rel=1e-4)


def test_without_the_time_gain_the_clocks_change_places():
    physical, transformed = paper_topology(0.25, "physical"), paper_topology(0.25, "transformed")
    assert rate_of_the_static_law(physical, clock="physical") == rate_of_the_static_law(transformed)
    mean = Graph(np.mean([graph.adjacency for graph in transformed.graphs], axis=0))
    found = rate_of_the_static_law(transformed, clock="physical")
    assert found == pytest.approx(rate_of_the_static_law(fixed(mean)))


def test_largest_stable_step_separates_contraction_from_growth():
    matrix, identity = matrices(fixed(cycle(5)))[0], np.eye(25)
    step = theory.largest_stable_step(matrix)
    assert np.abs(np.linalg.eigvals(identity - 0.999 * step * matrix)).max() < 1
    assert np.abs(np.linalg.eigvals(identity - 1.001 * step * matrix)).max() > 1
    assert theory.largest_stable_step(-matrix) is None
    assert theory.largest_stable_step(np.zeros((3, 3))) == np.inf
    assert theory.largest_stable_step(np.diag([0.0, 1.0, 4.0])) == pytest.approx(0.5)


def test_a_rate_whose_exponential_is_no_number_of_float64():
    topology = paper_topology(0.25, "transformed")
    fast = [2000 * np.eye(25) + matrix for matrix in matrices(topology)]
    rate = theory.decay_rate(fast, topology, 1.2)
    assert rate == pytest.approx(2000 + rate_of_the_static_law(topology), rel=1e-9)


class Fast(Exponential):
    """λ(s) = T (1 − e^{−9 s}), as far as its gain grows; its λ'(300) is 0 in float64."""

    def derivative(self, s):
        return 9 * super().derivative(9 * s)


@pytest.mark.parametrize(
    ("kind", "growth"), [(Exponential, 1.0), (HyperbolicTangent, 2.0), (Rational, 0.0), (Fast, 9.0)]
)
def test_gain_growth(kind, growth):
    assert theory.gain_growth(kind(1.2)) == growth


def test_sampled_loop_is_the_product_of_step_matrices():
    world, law = build("energy-switching", laws.Static)
    loop, start = theory.sampled_loop(world, law), np.random.default_rng(0).normal(size=25)
    product = np.eye(25)
    for k in range(world.clock.steps):
        graph = world.topology.graphs[int(world.topology.schedule(world.clock.t[k]).modes)]
        product = (np.eye(25) - world.clock.theta[k] * theory.closed_loop_matrix(world.game, graph, 2.0)) @ product
    np.testing.assert_allclose(loop.errors(start)[-1], product @ start, atol=1e-12)


def test_a_law_without_the_time_gain_steps_in_seconds():
    world, law = build(get_scenario("energy"), laws.CorollaryOne)
    loop = theory.sampled_loop(world, law)
    assert loop.clock == "physical"
    np.testing.assert_array_equal(loop.steps, World(get_scenario("energy")).clock.dt[:400])
