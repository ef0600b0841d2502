import numpy as np
import pytest
from worlds import BLOCKS, BLOCKS_SWITCHING, loop_matrix, make_env, play, world_and_encoder

from ptne_env import FactorySpec, get_scenario, laws

AFFINE = {
    "energy": get_scenario("energy"),
    "energy-switching": get_scenario("energy-switching"),
    "energy-switching-transformed": get_scenario("energy-switching-transformed"),
    "blocks": BLOCKS,
    "blocks-switching": BLOCKS_SWITCHING,
}


@pytest.mark.parametrize("name", AFFINE)
def test_environment_is_the_product_of_the_step_matrices_through_float32(name):
    env = make_env(AFFINE[name], hold_steps=20)
    states, _ = play(env, laws.Static(env.layout, kappa=1.0), seed=5)
    game, clock, world = env.world.game, env.world.clock, env.world
    equilibrium = np.tile(game.nash_equilibrium, game.num_players)
    error = states[0].ravel() - equilibrium
    largest = np.abs(states).max()
    assert len(states) == 421
    for k in range(clock.total_steps):
        graph = world.topology.graphs[int(world.modes[k])]
        error = error - clock.theta[k] * loop_matrix(game, graph.adjacency, 1.0) @ error
        assert np.abs(states[k + 1].ravel() - equilibrium - error).max() <= 2e-6 * largest


def test_readme_example_ends_at_the_printed_distance():
    env = make_env("energy")
    play(env, laws.Static(env.layout, kappa=2.0), seed=7)
    error = np.linalg.norm(env.strategies - env.nash_equilibrium) / np.linalg.norm(env.nash_equilibrium)
    assert error == pytest.approx(6.5e-5, rel=0.05)


def test_gradient_gain_is_the_law_for_scaled_costs():
    env = make_env("energy")
    doubled = FactorySpec.of("ptne_env.games:EnergyGame", curvature=2.0, coupling=0.2, base_price=20.0)
    scaled = make_env("energy", game=doubled)
    plain, _ = play(env, laws.Static(env.layout, kappa=2.0, gradient_gain=2.0))
    other, _ = play(scaled, laws.Static(scaled.layout, kappa=2.0))
    assert np.abs(plain - other).max() <= 2e-6 * np.abs(plain).max()


@pytest.mark.parametrize("kappa", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("law", [laws.Static, laws.CorollaryOne, laws.Grounded])
def test_negative_or_infinite_kappa_is_refused(law, kappa):
    layout = world_and_encoder("energy")[1].layout
    with pytest.raises(ValueError, match="kappa must be a finite number of at least 0"):
        law(layout, kappa=kappa)


@pytest.mark.parametrize("gain", [0.0, -1.0, float("nan")])
def test_gradient_gain_must_be_positive(gain):
    with pytest.raises(ValueError, match="gradient_gain must be a finite number above 0"):
        laws.Static(world_and_encoder("energy")[1].layout, gradient_gain=gain)


def test_corollary_one_moves_as_if_there_were_no_time_gain():
    env = make_env("energy")
    clock = env.world.clock
    states, _ = play(env, laws.CorollaryOne(env.layout, kappa=10.0))
    game = env.world.game
    matrix = loop_matrix(game, env.world.topology.graphs[0].adjacency, 10.0)
    equilibrium = np.tile(game.nash_equilibrium, 5)
    error = states[0].ravel() - equilibrium
    for k in range(400):
        error = error - clock.dt[k] * matrix @ error
    assert np.abs(states[-1].ravel() - equilibrium - error).max() <= 2e-6 * np.abs(states).max()
