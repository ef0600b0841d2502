"""The world on JAX is the numpy world: the same numbers from the same state, game, draws and inputs."""

import random

from extras import need_jax

need_jax()

import jax
import numpy as np
import pytest
from fuzz import a_scenario, no_warnings
from worlds import DEGREE, FAULTY, OWN_COST, every_field, with_field

import ptne_env.jax
from ptne_env import CATALOGUE
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.world import dynamics
from ptne_env.world.rewards import TERMS, Reward

SCENARIOS = {
    **CATALOGUE,
    **{f"ptne-v1/{track.name}": track.scenario for track in get_suite("ptne-v1").tracks},
    "faulty": FAULTY,
}
STEPS = 50
OPTIMISED = {"xla_backend_optimization_level": 3, "xla_cpu_use_fusion_emitters": True}


def close(found, expected, scale=1.0):
    """Equal to 1e-9, relative to each number or to a thousandth of the largest one."""
    expected = np.asarray(expected)
    slack = 1e-9 * scale * np.maximum(np.abs(expected), 1e-3 * np.abs(expected).max(initial=0))
    assert np.all(np.abs(np.asarray(found) - expected) <= slack + 1e-15)


def both(world, start, inputs, reward, options):
    """Estimates, rewards and observations of every step, by numpy, then by JAX."""
    state, twin = start, world.state(start)
    encoder, payer, numpys = Encoder(world.numpy, world.layout.interface), Reward(world.numpy, reward), []
    payer.reset(state)
    for held in inputs:
        state = dynamics.step(world.numpy, state, held)
        paid = payer.total(payer.step(state))
        numpys.append((state.estimates, paid, encoder.observe(state), state.diverged, state.own_gradients))

    def step(state, held):
        after = world.step(state, held)
        paid, observed = world.rewards(state, after, reward), world.observe(after).transpose(2, 1, 0)
        return after, (after.estimates, paid, observed, after.diverged, after.own_gradients)

    run = jax.jit(lambda state, inputs: jax.lax.scan(step, state, inputs)[1], compiler_options=options)
    return map(np.array, zip(*numpys, strict=True)), run(twin, inputs)


def every_term(game):
    """Weights of all terms that the game has."""
    return {name: 0.1 for name, term in TERMS.items() if game.has_best_response or not term.needs_best_response}


def compare(scenario, interface, reward=None, size=0.3, options=None):
    world = ptne_env.jax.JaxWorld(scenario, interface=interface, pool=2)
    start = dynamics.draw_initial_state(world.numpy, [RandomStreams.from_seed(seed) for seed in range(3)])
    shape = min(STEPS, world.numpy.clock.total_steps), *start.estimates.shape
    inputs = size * np.abs(start.own_gradients).mean() * np.random.default_rng(1).normal(size=shape)
    numpys, twins = both(world, start, inputs, reward or every_term(world.numpy.game), options)
    (estimates, rewards, observed, diverged, gradients), found = numpys, twins
    close(found[0], estimates)
    close(found[1], rewards)
    np.testing.assert_allclose(found[2], observed, rtol=3e-7, atol=1e-7 * np.abs(observed).max())
    assert np.array_equal(found[3], diverged)
    close(found[4], gradients)
    return diverged


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_is_the_same_on_jax(name):
    compare(SCENARIOS[name], "scaled" if len(name) % 2 else "physical")


@pytest.mark.parametrize("name", ["random-energy-switching", "non-quadratic", "ptne-v1/uneven-box", "faulty"])
def test_a_scenario_is_the_same_on_jax_with_all_optimisations(name):
    compare(SCENARIOS[name], "physical", options=OPTIMISED)


@pytest.mark.parametrize("seed", range(40))
def test_a_random_scenario_is_the_same_on_jax(seed):
    rng, found = random.Random(seed), None  # noqa: S311 - no secret
    with no_warnings():
        while found is None:
            try:
                scenario = a_scenario(rng)
                found = compare(scenario, rng.choice(("physical", "scaled", "full")), size=rng.choice((0.3, 3.0)))
            except ValueError:
                continue


def compare_field(scenario, name, interface):
    """Compare the field in a state somewhere along the way of three episodes that are at different steps."""
    world = ptne_env.jax.JaxWorld(scenario, interface=interface, pool=2)
    start = dynamics.draw_initial_state(world.numpy, [RandomStreams.from_seed(seed) for seed in range(3)])
    state = dynamics.step(world.numpy, start, 0.1 * start.estimates)._replace(step=np.array([1, 7, 4]))
    expected = world.layout.select(Encoder(world.numpy, interface).observe(state), name)
    found = world.layout.select(world.observe(world.state(state)).transpose(2, 1, 0), name)
    assert expected.size > 0
    assert np.ptp(expected) > 0
    np.testing.assert_allclose(found, expected, rtol=3e-7, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("scenario", ["faulty", "ptne-v1/uneven-box"])
@pytest.mark.parametrize(("name", "interface"), every_field())
def test_a_field_is_the_same_on_jax(name, interface, scenario):
    if (name, scenario) == ("time_since_switch", "ptne-v1/uneven-box"):
        scenario = "energy-switching"  # 0 in the other
    compare_field(SCENARIOS[scenario], name, interface)


@pytest.mark.parametrize("field", [DEGREE, OWN_COST], ids=lambda field: field.name)
def test_a_new_field_is_the_same_on_jax(field, monkeypatch):
    monkeypatch.setitem(FIELDS, field.name, field)
    compare_field(FAULTY, field.name, with_field(field.name, "scaled"))


@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("name", ["ptne-v1/uneven-box", "ptne-v1/short-deadline"])
def test_actions_become_the_same_inputs_on_jax(name, interface):
    world = ptne_env.jax.JaxWorld(SCENARIOS[name], interface=interface, pool=2)
    start = dynamics.draw_initial_state(world.numpy, [RandomStreams.from_seed(seed) for seed in range(3)])
    encoder, bound = Encoder(world.numpy, world.layout.interface), world.layout.action_bound
    shape = 3, world.layout.num_players, world.layout.action_size
    actions = np.random.default_rng(2).uniform(-1.5 * bound, 1.5 * bound, shape)
    close(jax.jit(world.inputs)(world.state(start), actions.T), encoder.decode(actions, start))


@pytest.mark.parametrize("name", TERMS)
def test_a_term_of_the_reward_is_the_same_on_jax_also_when_episodes_diverge(name):
    assert not compare("random-energy", "physical", name).any()
    assert compare("random-energy", "physical", name, size=1e4)[-1].any()


def test_regret_is_refused_on_jax_where_it_is_on_numpy():
    world = ptne_env.jax.JaxWorld("non-quadratic")
    state = world.reset(jax.random.key(0))
    with pytest.raises(ValueError, match="best response"):
        world.rewards(state, state, "regret")


def test_a_diverged_episode_is_charged_once_as_in_numpy():
    assert compare("non-quadratic", "physical", size=30.0)[-1].any()
