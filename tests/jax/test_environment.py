"""Draws, ends and refusals of the world on JAX."""

from extras import need_jax

need_jax()

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from processes import run_python
from scipy import stats
from worlds import FAULTY

import ptne_env.jax
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.world import dynamics
from ptne_env.world.disturbances import Disturbance
from ptne_env.world.starts import Start, UniformStart


class NumpyPush(Disturbance):
    """A disturbance that numpy alone can compute."""

    def velocity(self, keys, step, dimension):
        return np.float64(step) * np.ones((dimension, 1))


class NumpyStart(Start):
    """A start that numpy alone can draw."""

    is_random = True

    def draw(self, num_players, dimension, generator):
        return generator.normal(size=(dimension, num_players))


def key(seed=0):
    return jax.random.key(seed)


@pytest.mark.parametrize("track", ["nominal", "curved", "uneven-box", "switching-transformed"])
def test_own_draws_have_the_distribution_of_numpys(track):
    world = ptne_env.jax.JaxWorld(get_suite("ptne-v1").track(track).scenario, pool=400)
    streams = [RandomStreams.from_seed(seed) for seed in range(10_000, 10_300)]
    found, expected = (
        jax.jit(world.reset, static_argnums=1)(key(), 300),
        dynamics.draw_initial_state(world.numpy, streams),
    )
    for each in (
        lambda state: state.game.nash_equilibria[0],
        lambda state: state.game.equilibrium_scale,
        lambda state: state.estimates[0, 1],
        lambda state: state.own_gradients[0],
        lambda state: state.randomness.modes[-1],
        lambda state: state.randomness.time_since_switch[-1],
        lambda state: np.asarray(state.randomness.channel_keys) / 2**64,
    ):
        assert stats.ks_2samp(each(found), each(expected)).pvalue > 1e-3  # Kolmogorov and Smirnov


def test_the_games_that_jax_draws_are_played_at_their_equilibria():
    game = ptne_env.jax.JaxWorld("random-energy").reset(key(), 50).game
    assert np.abs(game.pseudo_gradient(game.nash_equilibria)).max() < 1e-12


def test_an_episode_is_the_same_in_a_batch_of_any_size_and_another_for_another_key():
    world = ptne_env.jax.JaxWorld(get_suite("ptne-v1").track("liar").scenario, pool=20)
    alone, together, other = world.reset(key(), 1), world.reset(key(), 3), world.reset(key(1), 1)
    np.testing.assert_array_equal(alone.estimates, together.estimates[..., :1])
    np.testing.assert_array_equal(alone.received.messages, together.received.messages[..., :1])
    assert not np.any(other.estimates == alone.estimates)


def test_a_start_has_a_range_per_component():
    start = UniformStart(low=[0.0, 1.0, 2.0, 3.0, 4.0], high=np.arange(5) + 0.5)
    estimates = ptne_env.jax.JaxWorld("energy", start=start).reset(key(), 20).estimates
    assert np.array_equal(np.round(estimates - 0.25), np.broadcast_to(np.arange(5.0)[:, None, None], (5, 5, 20)))


def test_starts_that_numpy_alone_can_draw_come_from_a_pool():
    state = ptne_env.jax.JaxWorld("energy", start=NumpyStart(), pool=5).reset(key(), 100)
    assert len(np.unique(state.estimates[0, 1])) == 5


def test_episodes_that_are_over_start_again_and_others_go_on():
    world = ptne_env.jax.JaxWorld(FAULTY.replace(steps=30, hold_steps=0), pool=4)
    state = jax.jit(world.reset, static_argnums=1)(key(), 4)
    state = state._replace(diverged=jnp.array([False, True, False, False]), step=state.step + 27)
    step = jax.jit(lambda state: world.restarted(key(), world.step(state, jnp.zeros_like(state.estimates))))
    after = step(state)
    assert after.step.tolist() == [28, 0, 28, 28]
    assert not after.diverged.any()
    fresh = world.reset(key(), 4)
    np.testing.assert_allclose(after.estimates[..., 1], fresh.estimates[..., 1])
    np.testing.assert_allclose(after.received.messages[..., 1], fresh.received.messages[..., 1])
    assert step(step(after)).step.tolist() == [0, 2, 0, 0]


def test_a_world_without_64_bit_numbers_says_what_to_set_and_sets_nothing():
    world = ptne_env.jax.JaxWorld("energy")
    first = key()
    jax.config.update("jax_enable_x64", val=False)
    for call in (lambda: ptne_env.jax.JaxWorld("energy"), lambda: world.reset(first)):
        with pytest.raises(RuntimeError, match=r'jax.config.update\("jax_enable_x64", True\)'):
            call()
    assert not jax.config.jax_enable_x64


def test_jax_is_imported_by_ptne_env_jax_alone_and_its_settings_stay():
    imports = (
        "import sys, ptne_env, ptne_env.execution, ptne_env.suites, ptne_env.laws; assert 'jax' not in sys.modules"
    )
    run_python("-c", f"{imports}; import ptne_env.jax, jax; assert not jax.config.jax_enable_x64")


def test_a_scenario_with_a_part_that_numpy_alone_can_compute_is_refused_by_name():
    world = ptne_env.jax.JaxWorld("energy", name="mine", disturbance=NumpyPush())
    state = world.reset(key())
    with pytest.raises(ValueError, match=r"scenario 'mine' has a part .*test_environment.py"):
        world.step(state, state.estimates)


@pytest.mark.parametrize("size", [1, 4, 6])
def test_actions_and_inputs_of_another_shape_are_refused(size):
    """JAX would read beyond the ends of them without a word."""
    world = ptne_env.jax.JaxWorld("energy")
    state = world.reset(key(), 2)
    for call in (world.inputs, world.step):
        with pytest.raises(ValueError, match=rf"have the shape \(n, N, B\) = \(5, 5, 2\), got \({size}, 5, 2\)"):
            call(state, np.zeros((size, 5, 2)))


def test_the_leaves_of_a_drawn_game_are_its_parameters_and_equilibria_and_a_single_game_has_none():
    world = ptne_env.jax.JaxWorld("random-affine", pool=3)
    game = world.reset(key(), 2).game
    leaves, structure = jax.tree.flatten(game)
    assert [leaf.shape[-1] for leaf in leaves] == [2] * len((*game.parameters, "nash_equilibria", "equilibrium_scale"))
    again = jax.tree.unflatten(structure, leaves)
    assert (again.action_dims, again.batch_size) == (game.action_dims, 2)
    assert jax.tree.structure(jax.device_get(game)) == structure
    assert jax.tree.structure(jax.tree.unflatten(structure, [object()] * len(leaves))) == structure
    single = ptne_env.jax.JaxWorld("energy")
    assert jax.tree.leaves(single.reset(key()).game) == []
    other = ptne_env.jax.JaxWorld("energy").reset(key())
    assert jax.tree.structure(single.reset(key())) == jax.tree.structure(other)  # games are compared by value
    assert jax.tree.structure(ptne_env.jax.JaxWorld("hvac-ye-hu").reset(key())) != jax.tree.structure(other)
