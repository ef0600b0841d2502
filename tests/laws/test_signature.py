"""Laws behave as Stable-Baselines3's ``predict`` does."""

import inspect
from dataclasses import asdict

import numpy as np
import pytest
from worlds import BLOCKS, make_env, play, world_and_encoder

from ptne_env import Interface, Policy, laws
from ptne_env.field import laws as field_laws
from ptne_env.laws import base
from ptne_env.perception.policy import PolicyError
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics

LAWS = [
    laws.Static,
    laws.Adaptive,
    laws.CorollaryOne,
    laws.Grounded,
    laws.FixedGain,
    laws.AdaptiveGrounded,
    field_laws.ProjectedGradient,
    field_laws.RoutedUnknown,
    laws.ZeroInput,
    laws.RandomPolicy,
]
SPECIAL = [
    field_laws.ContactRelay,
    field_laws.ObserverRelay,
    field_laws.MultiRate,
    field_laws.ProximalBestResponse,
    laws.CentralisedOracle,
]
"""Laws that need an interface of their own."""


def observe_for(law, scenario="energy", batch=3):
    return observe(scenario, batch, **asdict(getattr(law, "interface", Interface("physical"))))


def observe(scenario="energy", batch=3, **interface):
    world, encoder = world_and_encoder(scenario, **interface)
    state = dynamics.initial_state(
        world, np.stack([world.draw_estimates([RandomStreams.from_seed(b)])[..., 0] for b in range(batch)], -1)
    )
    state = dynamics.initial_state(world, state.estimates + np.random.default_rng(0).normal(size=state.estimates.shape))
    return encoder.layout, encoder.observe(state).reshape(-1, encoder.layout.size)


@pytest.mark.parametrize("law", [*LAWS, *SPECIAL])
def test_laws_have_the_signature_of_stable_baselines3(law):
    parameters = inspect.signature(law.predict).parameters
    assert list(parameters) == ["self", "observation", "state", "episode_start", "deterministic"]
    assert [parameters[name].default for name in list(parameters)[2:]] == [None, None, False]
    assert issubclass(law, Policy)


class Forgetful(laws.Static):
    """A law whose inputs come without a memory."""

    def inputs(self, observation, memory):
        return super().inputs(observation, memory)[0]


def test_a_law_is_built_from_a_layout_and_returns_a_memory():
    with pytest.raises(TypeError, match=r"Static is built from a layout, such as env\.layout, got a NashSeekingEnv"):
        laws.Static(make_env("energy"))
    layout, observations = observe()
    with pytest.raises(PolicyError, match=r"Forgetful\.inputs returns \(inputs, memory\), got a ndarray alone"):
        Forgetful(layout).predict(observations)


@pytest.mark.parametrize("kind", ["physical", "scaled"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "scenario", ["energy", "energy-switching", BLOCKS], ids=lambda world: getattr(world, "name", world)
)
def test_actions_are_float32_within_the_box_one_row_each(scenario, law, kind):
    layout, observations = observe(scenario, kind=kind)
    actions, _ = law(layout).predict(observations, deterministic=True)
    assert actions.shape == (len(observations), layout.action_size)
    assert actions.dtype == np.float32
    assert np.abs(actions).max() <= layout.action_bound


@pytest.mark.parametrize("law", [law for law in [*LAWS, *SPECIAL] if law is not laws.RandomPolicy])
def test_single_observation_gives_a_single_action(law):
    layout, observations = observe_for(law)
    actions, _ = law(layout).predict(observations)
    for row in (0, 4):
        action, memory = law(layout).predict(observations[row])
        assert action.shape == (layout.action_size,)
        assert np.array_equal(action, actions[row])
        following, _ = law(layout).predict(observations[row], state=memory)
        assert following.shape == (layout.action_size,)


@pytest.mark.parametrize("law", [law for law in [*LAWS, *SPECIAL] if law is not laws.RandomPolicy])
def test_predict_leaves_observations_and_memory_alone_and_repeats_itself(law):
    layout, observations = observe_for(law)
    policy = law(layout)
    _, memory = policy.predict(observations)
    kept = observations.copy(), None if memory is None else memory.copy()
    first, after = policy.predict(observations, state=memory)
    again, after_again = policy.predict(observations, state=memory)
    assert np.array_equal(observations, kept[0])
    assert np.array_equal(first, again)
    if memory is not None:
        assert np.array_equal(memory, kept[1])
        assert np.array_equal(after, after_again)
        assert not np.shares_memory(after, memory)


@pytest.mark.parametrize("law", [law for law in [*LAWS, *SPECIAL] if law is not laws.RandomPolicy])
def test_players_in_blocks_decide_as_all_at_once(law, monkeypatch):
    layout, observations = observe_for(law)
    policy, found = law(layout), []
    for numbers in (2**18, 1000, 1):
        monkeypatch.setattr(base, "_BLOCK", numbers)
        first, memory = policy.predict(observations)
        second, memory = policy.predict(observations[::-1], state=memory)
        found.append((first, second, *([] if memory is None else [memory])))
    for others in found[1:]:
        for one, other in zip(found[0], others, strict=True):
            assert one.tobytes() == other.tobytes()
            assert one.dtype == other.dtype


def test_episode_start_resets_the_memory_of_its_rows_alone():
    layout, observations = observe()
    policy = laws.Adaptive(layout)
    _, memory = policy.predict(observations)
    _, memory = policy.predict(observations, state=memory)
    starts = np.zeros(15, dtype=bool)
    starts[[2, 7]] = True
    mixed, mixed_memory = policy.predict(observations, state=memory, episode_start=starts)
    going, going_memory = policy.predict(observations, state=memory)
    fresh, fresh_memory = policy.predict(observations)
    assert np.array_equal(mixed, np.where(starts[:, None], fresh, going))
    assert np.array_equal(mixed_memory, np.where(starts[:, None], fresh_memory, going_memory))
    assert not np.array_equal(going, fresh)


def test_first_call_with_all_episodes_starting_has_fresh_memory():
    layout, observations = observe()
    policy = laws.Adaptive(layout)
    started, memory = policy.predict(observations, state=None, episode_start=np.ones(15, dtype=bool))
    fresh, fresh_memory = policy.predict(observations)
    assert np.array_equal(started, fresh)
    assert np.array_equal(memory, fresh_memory)


@pytest.mark.parametrize("law", [law for law in LAWS if law is not laws.RandomPolicy])
def test_observations_of_another_scenario_are_refused(law):
    layout, _ = observe()
    _, foreign = observe(BLOCKS)
    with pytest.raises(ValueError, match="this policy was built for observations of length"):
        law(layout).predict(foreign)


@pytest.mark.parametrize("law", [law for law in [*LAWS, *SPECIAL] if law is not laws.RandomPolicy])
def test_batches_agree_bit_for_bit_with_single_environments(law):
    from test_dynamics import large_energy_scenario

    layout, observations = observe_for(law, large_energy_scenario(), batch=6)
    policy = law(layout)
    together, memory = policy.predict(observations)
    together, memory = policy.predict(observations, state=memory)
    for b in range(6):
        rows = slice(11 * b, 11 * b + 11)
        alone, own = policy.predict(observations[rows])
        alone, own = policy.predict(observations[rows], state=own)
        assert np.array_equal(alone, together[rows])
        if memory is not None:
            assert np.array_equal(own, memory[rows])


def test_zero_input_stays_at_the_start():
    env = make_env("energy", steps=10)
    states, steps = play(env, laws.ZeroInput(env.layout), seed=1)
    assert np.array_equal(states[0], states[-1])
    assert [reward for step in steps for reward in step[1].values()] == [0.0] * 50


@pytest.mark.parametrize("interface", [{}, {"kind": "scaled"}])
def test_random_policy_fills_the_action_box_and_repeats_with_its_seed(interface):
    layout = world_and_encoder("energy", **interface)[1].layout
    observations = np.zeros((4000, layout.size), dtype=np.float32)
    observations[:, layout.slices["clock"].start] = np.arange(4000)
    actions, _ = laws.RandomPolicy(layout, seed=3).predict(observations)
    assert np.array_equal(actions, laws.RandomPolicy(layout, seed=3).predict(observations)[0])
    assert not np.array_equal(actions, laws.RandomPolicy(layout, seed=4).predict(observations)[0])
    bound = layout.action_bound
    assert 0.99 * bound < np.abs(actions).max() <= bound
    assert np.abs(actions.mean(axis=0)).max() < 0.05 * bound
    assert laws.RandomPolicy(layout).predict(observations[0])[0].shape == (layout.action_size,)


@pytest.mark.parametrize("seed", [-1, 0.5])
def test_random_policy_refuses_other_seeds(seed):
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0"):
        laws.RandomPolicy(world_and_encoder("energy")[1].layout, seed=seed)
