import numpy as np
import pytest
from worlds import BLOCKS, DIRECTED, loop_matrix, make_env, play, world_and_encoder

from ptne_env import laws


@pytest.mark.parametrize("scenario", ["energy-switching", BLOCKS, DIRECTED], ids=["switching", "blocks", "directed"])
def test_environment_is_the_product_of_the_step_matrices_through_float32(scenario):
    env = make_env(scenario, hold_steps=20)
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
