"""The world on JAX is the numpy world: the same numbers from the same state, game, draws and inputs."""

import random
from functools import partial

from extras import need_jax

need_jax()

import jax
import numpy as np
import pytest
from fuzz import KINDS, UNPLAYABLE, a_scenario, fitting, no_warnings
from scipy import special
from worlds import DEGREE, DIRECTED, FAULTY, OWN_COST, channel_part, every_field, with_field

import ptne_env.jax
from ptne_env import CATALOGUE
from ptne_env.games import AffineGame, CostGame, SaturatingGame
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS
from ptne_env.shared import counter_random
from ptne_env.shared.parts import PARTS
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.world import dynamics
from ptne_env.world.rewards import TERMS, Reward
from ptne_env.world.world import World

SCENARIOS = {
    **CATALOGUE,
    **{f"ptne-v1/{track.name}": track.scenario for track in get_suite("ptne-v1").tracks},
    "faulty": FAULTY,
    "directed": DIRECTED.replace(channel=channel_part("Loss", probability=0.2)),
}
STEPS = 50
OPTIMISED = {"xla_backend_optimization_level": 3, "xla_cpu_use_fusion_emitters": True}


def close(found, expected, scale=1.0):
    """Equal to 1e-9, relative to each number or to a thousandth of the largest one."""
    expected = np.asarray(expected)
    slack = 1e-9 * scale * np.maximum(np.abs(expected), 1e-3 * np.abs(expected).max(initial=0))
    assert np.all(np.abs(np.asarray(found) - expected) <= slack + 1e-15)


def numbers(world, state, paid, observed):
    """Estimates, own gradients, messages, weights and rewards in a state; then observations and divergence."""
    messages = state.estimates if state.received is None else state.received.messages
    weights = dynamics.weights(world, state) * np.ones(state.step.size)
    return state.estimates, state.own_gradients, messages, weights, paid, observed, state.diverged


def both(world, start, inputs, reward, options):
    """What :func:`numbers` are of every step, by numpy, then by JAX."""
    state, twin = start, world.state(start)
    encoder, payer, numpys = Encoder(world.numpy, world.layout.interface), Reward(world.numpy, reward), []
    payer.reset(state)
    for held in inputs:
        state = dynamics.step(world.numpy, state, held)
        numpys.append(numbers(world.numpy, state, payer.total(payer.step(state)), encoder.observe(state)))

    def step(state, held):
        after = world.step(state, held)
        return after, numbers(
            world._world, after, world.rewards(state, after, reward), world.observe(after).transpose(2, 1, 0)
        )

    run = jax.jit(lambda state, inputs: jax.lax.scan(step, state, inputs)[1], compiler_options=options)
    return map(np.array, zip(*numpys, strict=True)), run(twin, inputs)


def responds_with_numpy_alone(game):
    """Whether best responses are found by iterations, which compute with numpy alone.

    No other formula of the library's games and channels does; the regret on JAX is then refused.
    """
    is_coupled = isinstance(game, AffineGame) and game.box is not None and not game._is_separable
    return is_coupled or isinstance(game, SaturatingGame | CostGame)


def every_term(game):
    """Weights of all terms that the game has on JAX."""
    has_regret = game.has_best_response and not responds_with_numpy_alone(game)
    return {name: 0.1 for name, term in TERMS.items() if has_regret or not term.needs_best_response}


def draw_start(world):
    return dynamics.draw_initial_state(world, [RandomStreams.from_seed(seed) for seed in range(3)])


def compare(scenario, interface, reward=None, size=0.3, options=None):
    world = ptne_env.jax.JaxWorld(scenario, interface=interface, pool=2)
    start = draw_start(world.numpy)
    shape = min(STEPS, world.numpy.clock.total_steps), *start.estimates.shape
    inputs = size * np.abs(start.own_gradients).mean() * np.random.default_rng(1).normal(size=shape)
    numpys, twins = both(world, start, inputs, reward or every_term(world.numpy.game), options)
    (*exact, observed, diverged), (*found, seen, gone) = numpys, twins
    for expected, computed in zip(exact, found, strict=True):
        close(computed, expected)
    np.testing.assert_allclose(seen, observed, rtol=3e-7, atol=1e-7 * np.abs(observed).max())
    assert np.array_equal(gone, diverged)
    return diverged


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_is_the_same_on_jax(name):
    # The regret of 54 players takes JAX half a minute to compile; those of the other games are compared.
    reward = {"digits": 0.1, "tracking": 0.1, "payoff": 0.1} if name == "ptne-v1/market-118" else None
    compare(SCENARIOS[name], "scaled" if len(name) % 2 else "physical", reward)


@pytest.mark.parametrize("name", ["random-energy-switching", "non-quadratic", "ptne-v1/uneven-box", "faulty"])
def test_a_scenario_is_the_same_on_jax_with_all_optimisations(name):
    compare(SCENARIOS[name], "physical", options=OPTIMISED)


def test_normal_numbers_are_the_same_on_jax_in_the_middle_and_to_the_ends_of_both_tails():
    tail = np.append(2.0 ** -np.linspace(1, 53, 5001), np.linspace(0.001, 0.5, 5001))  # 2^−53 is the smallest drawn
    numbers = np.append(tail, 1 - tail)
    found = jax.jit(counter_random.normal_quantiles)(jax.numpy.asarray(numbers))
    np.testing.assert_allclose(found, special.ndtri(numbers), rtol=3e-12)


def a_startable_scenario(rng, **names):
    scenario = a_scenario(rng, **names)
    draw_start(World(scenario))
    return scenario


def compare_random(rng, **names):
    """The comparison of the first random scenario with some parts that fits together."""
    with no_warnings():
        scenario = None
        while scenario is None:
            scenario = fitting(partial(a_startable_scenario, rng, **names))
        compare(scenario, rng.choice(("physical", "scaled", "full")), size=rng.choice((0.3, 3.0)))


@pytest.mark.parametrize("name", [name for name in PARTS if name.partition(":")[0] in KINDS and name not in UNPLAYABLE])
def test_a_part_is_the_same_on_jax(name):
    kind, _, part = name.partition(":")
    compare_random(random.Random(name), **{kind: part})  # noqa: S311 - no secret


@pytest.mark.parametrize("seed", range(8))
def test_a_random_scenario_is_the_same_on_jax(seed):
    compare_random(random.Random(seed))  # noqa: S311 - no secret


def compare_field(scenario, name, interface):
    """Compare the field in a state somewhere along the way of three episodes that are at different steps."""
    world = ptne_env.jax.JaxWorld(scenario, interface=interface, pool=2)
    start = draw_start(world.numpy)
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
    start = draw_start(world.numpy)
    encoder, bound = Encoder(world.numpy, world.layout.interface), world.layout.action_bound
    shape = 3, world.layout.num_players, world.layout.action_size
    actions = np.random.default_rng(2).uniform(-1.5 * bound, 1.5 * bound, shape)
    close(jax.jit(world.inputs)(world.state(start), actions.T), encoder.decode(actions, start))


@pytest.mark.parametrize("name", TERMS)
def test_a_term_of_the_reward_is_the_same_on_jax_also_when_episodes_diverge(name):
    assert not compare("random-energy", "physical", name).any()
    assert compare("random-energy", "physical", name, size=1e4)[-1].any()


def test_a_reward_function_of_arrays_is_the_same_on_jax_also_when_episodes_diverge():
    def price(before, after, world):
        return (before.estimates - after.estimates).sum(axis=0) * world.clock.deadline

    assert compare("random-energy", "physical", price, size=1e4)[-1].any()
    world = ptne_env.jax.JaxWorld("energy", interface="physical")
    played = ptne_env.jax.rollout(world, ptne_env.jax.static(world.layout), jax.random.key(0), 2, steps=3, reward=price)
    assert played.rewards.shape == (3, 5, 2)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("non-quadratic", "needs a best response"),
        ("ev-charging", "has a part that computes with numpy alone"),
        ("ptne-v1/curved", "has a part that computes with numpy alone"),
    ],
)
def test_regret_is_refused_on_jax_where_there_is_none(name, reason):
    world = ptne_env.jax.JaxWorld(SCENARIOS[name], pool=2)
    state = world.reset(jax.random.key(0))
    with pytest.raises(ValueError, match=reason):
        jax.jit(lambda state: world.rewards(state, state, "regret"))(state)


def test_a_diverged_episode_is_charged_once_as_in_numpy():
    assert compare("non-quadratic", "physical", size=30.0)[-1].any()
