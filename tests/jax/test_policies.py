"""Laws, rollouts and entries of comparisons on JAX, and gradients through whole episodes."""

from extras import need_jax

need_jax()

import dataclasses

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

import ptne_env
import ptne_env.jax
from ptne_env import PolicySpec, laws
from ptne_env.evaluation.rollout import rollout
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.world import dynamics

SCENARIO = "random-energy-switching-transformed"
UNEVEN = get_suite("ptne-v1").track("uneven-box").scenario
LAWS = {"static": laws.Static, "adaptive": laws.Adaptive}
GAINS = 0.1 + np.add.outer(np.arange(5), np.arange(5)) / 10
"""A symmetric table, a gain per link."""


def start(world, count=3):
    """A first state of numpy's."""
    return dynamics.draw_initial_state(world.numpy, [RandomStreams.from_seed(seed) for seed in range(count)])


@pytest.mark.parametrize(
    ("name", "arguments"), [*((name, {}) for name in LAWS), ("adaptive", {"gamma": GAINS / 50, "initial_gain": GAINS})]
)
@pytest.mark.parametrize("scenario", [SCENARIO, UNEVEN], ids=["energy", "uneven"])
def test_a_law_has_the_digits_of_the_law_on_numpy(name, arguments, scenario):
    world = ptne_env.jax.JaxWorld(scenario, interface="physical", pool=3)
    state, policy = start(world), getattr(ptne_env.jax, name)(world.layout, **arguments)
    found = jax.jit(lambda: ptne_env.jax.rollout(world, policy, world.state(state)))()
    expected = rollout(LAWS[name](world.layout, **arguments), Encoder(world.numpy, world.layout.interface), state)
    np.testing.assert_allclose(found.digits, -np.log10(expected["estimate_distance"][1:]), atol=1e-4)
    mean = expected["mean_digits"]
    np.testing.assert_allclose(found.rewards.sum(0).mean(0), mean[-1] - mean[0], atol=1e-4)


def test_a_policy_is_an_entry_of_a_comparison():
    def act(params, observation, memory):
        return params["weight"] @ observation + memory, memory / 2

    layout = ptne_env.parallel_env(SCENARIO).layout
    learned = ptne_env.jax.JaxPolicy(act, {"weight": np.zeros((layout.action_size, layout.size))}, memory=np.ones(5))
    twin = PolicySpec("twin", ptne_env.jax.static(ptne_env.parallel_env(SCENARIO, interface="physical").layout))
    results = ptne_env.evaluate([PolicySpec("learned", learned), twin, "static"], SCENARIO, episodes=2)
    assert not results.failures
    twins, statics = (results.samples[SCENARIO, name]["digits"] for name in ("twin", "static"))
    np.testing.assert_allclose(twins, statics, rtol=1e-5)


def test_a_memory_starts_afresh_where_an_episode_starts():
    policy = ptne_env.jax.JaxPolicy(lambda params, observation, memory: (memory, memory + 1), memory=np.zeros(1))
    rows, starts = np.zeros((3, 2), dtype=np.float32), np.array([False, True, False])
    _, memory = policy.predict(rows)
    actions, memory = policy.predict(rows, memory, starts)
    assert actions.ravel().tolist() == [1, 0, 1]
    assert policy.predict(rows, memory)[0].ravel().tolist() == [2, 1, 2]
    assert policy.predict(rows[0])[0].shape == (1,)


def test_nothing_compiles_again_when_it_is_called_again(caplog):
    world = ptne_env.jax.JaxWorld("random-energy", interface="physical")
    policy = ptne_env.jax.static(world.layout)

    def call_everything(key):
        state = world.restarted(key, world.reset(key, 2)._replace(diverged=jnp.array([True, False])))
        after = world.step(state, world.inputs(state, jnp.ones_like(world.observe(state)[:5])))
        episodes = ptne_env.jax.rollout(world, policy, key, 2, steps=2, reward={"digits": 2.0})
        return world.rewards(state, after), world.digits(after), world.is_over(after), episodes

    call_everything(jax.random.key(0))
    with jax.log_compiles():
        call_everything(jax.random.key(1))
        assert not caplog.records
        jax.jit(lambda number: number + 1)(1)
    assert caplog.records  # compilations would have been seen


def test_a_policy_is_refused_by_a_world_that_it_was_not_made_for():
    world = ptne_env.jax.JaxWorld("energy", interface="physical")
    for policy in (
        ptne_env.jax.JaxPolicy(None),
        ptne_env.jax.static(ptne_env.jax.JaxWorld(UNEVEN, interface="physical", pool=2).layout),
    ):
        with pytest.raises(LayoutError, match="policy"):
            ptne_env.jax.rollout(world, policy, jax.random.key(0))
    with pytest.raises(LayoutError, match="interface='physical'"):
        ptne_env.jax.static(ptne_env.jax.JaxWorld("energy").layout)


# Gradients ---------------------------------------------------------------------------------------------------------


def network(layout, width=2):
    """A small policy with random weights and bounded actions."""
    generator = np.random.default_rng(3)
    params = {
        "in": generator.normal(size=(width, layout.size)) / 30,
        "out": generator.normal(size=(layout.action_size, width)) * 3,
    }

    def act(params, observation, memory):
        return params["out"] @ jnp.tanh(params["in"] @ observation), memory

    return ptne_env.jax.JaxPolicy(act, params, interface=layout.interface)


@pytest.mark.parametrize("steps", [20, 400])
@pytest.mark.parametrize("make", [ptne_env.jax.static, network], ids=["static", "network"])
def test_the_gradient_of_the_digits_is_that_of_finite_differences(make, steps):
    world = ptne_env.jax.JaxWorld(SCENARIO, interface="physical", dtype=jnp.float64)
    state, policy = world.state(start(world, 2)), make(world.layout)
    flat, unflatten = jax.flatten_util.ravel_pytree(jax.tree.map(jnp.asarray, policy.params))

    def digits(flat):
        chosen = dataclasses.replace(policy, params=unflatten(flat))
        return ptne_env.jax.rollout(world, chosen, state, steps=steps).digits[-1].mean()

    assert -2 < digits(flat) < 11
    found = jax.jit(jax.grad(digits))(flat)
    moves = 1e-6 * np.eye(flat.size)
    values = jax.jit(jax.vmap(digits))(flat + np.concatenate([moves, -moves]))
    expected = (values[: flat.size] - values[flat.size :]) / 2e-6
    assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("scenario", ["non-quadratic", "rate-control", "random-energy", "ptne-v1/curved"])
def test_no_number_and_no_gradient_is_nan_where_games_diverge(scenario):
    found = get_suite("ptne-v1").track("curved").scenario if "/" in scenario else ptne_env.get_scenario(scenario)
    world = ptne_env.jax.JaxWorld(found.replace(input_limit=1e6), interface="physical", pool=4)

    def run(gain):
        policy = ptne_env.jax.JaxPolicy(flee, gain, interface=world.layout.interface)
        played = ptne_env.jax.rollout(world, policy, state, steps=60, reward={"digits": 1.0, "payoff": 1.0})
        return (played.rewards.sum((0, 1)), played.digits.mean()), (played.state.diverged, played.state.estimates)

    def flee(gain, observation, memory):
        return gain * observation[world.layout.slices["own_estimate"]], memory

    state = world.reset(jax.random.key(0), 3)
    slopes, (diverged, estimates) = jax.jit(jax.jacrev(run, has_aux=True))(1e4)
    assert diverged.all()
    assert all(np.isfinite(numbers).all() for numbers in (*slopes, estimates))
    values, _ = jax.jit(run)(50.0)
    assert all(np.isfinite(numbers).all() for numbers in values)


def test_the_gradient_passes_through_rounding_as_if_nothing_were_rounded():
    slopes = []
    for track in ("rounding", "liar"):
        world = ptne_env.jax.JaxWorld(get_suite("ptne-v1").track(track).scenario, pool=2)
        state = world.reset(jax.random.key(0), 2)
        received = lambda inputs, world=world, state=state: world.step(state, inputs).received.messages.sum()  # noqa: E731
        slopes.append(jax.jit(jax.grad(received))(jnp.ones_like(state.estimates)))
    assert np.abs(slopes[1]).max() > 0
    np.testing.assert_allclose(*slopes)
