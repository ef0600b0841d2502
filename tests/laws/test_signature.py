"""Laws behave as Stable-Baselines3's ``predict`` does."""

import inspect
from copy import deepcopy

import numpy as np
import pytest
from worlds import BLOCKS, world_and_encoder

from ptne_env import Policy, laws
from ptne_env.perception.policy import PolicyError
from ptne_env.shared.parts import PARTS, resolve
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics

POLICIES = [resolve(part) for part in PARTS if part.startswith("law:")]
LAWS = [policy for policy in POLICIES if issubclass(policy, laws.Law)]


def observe(law, scenario="energy", batch=3):
    world, encoder = world_and_encoder(scenario, kind=law.interface)
    starts = [world.draw_estimates([RandomStreams.from_seed(b)])[..., 0] for b in range(batch)]
    noise = np.random.default_rng(0).normal(size=(*starts[0].shape, batch))
    state = dynamics.initial_state(world, np.stack(starts, -1) + noise)
    return encoder.layout, encoder.observe(state).reshape(-1, encoder.layout.size)


def arrays(memory):
    """The arrays of a memory, in order."""
    return [each for part in memory for each in arrays(part)] if isinstance(memory, tuple) else [memory]


@pytest.mark.parametrize("law", POLICIES)
def test_laws_have_the_signature_of_stable_baselines3(law):
    parameters = inspect.signature(law.predict).parameters
    assert list(parameters) == ["self", "observation", "state", "episode_start", "deterministic"]
    assert [parameters[name].default for name in list(parameters)[2:]] == [None, None, False]
    assert issubclass(law, Policy)


class Forgetful(laws.Static):
    """A law whose inputs come without a memory."""

    def inputs(self, observation, memory):
        return super().inputs(observation, memory)[0]


def test_a_law_returns_a_memory():
    layout, observations = observe(laws.Static)
    with pytest.raises(PolicyError, match=r"Forgetful\.inputs returns \(inputs, memory\), got a ndarray alone"):
        Forgetful(layout).predict(observations)


@pytest.mark.parametrize("law", [law for law in LAWS if "own_estimate" in law.needs])
def test_laws_that_read_absolute_strategies_refuse_scale_free_observations(law):
    with pytest.raises(ValueError, match=f"{law.__name__} reads own_estimate, which the layout of .* lacks"):
        law(world_and_encoder("energy", kind="scaled")[1].layout)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("scenario", ["energy-switching", BLOCKS], ids=["energy-switching", "blocks"])
def test_predict_answers_one_row_each_and_repeats_itself(scenario, law):
    layout, observations = observe(law, scenario)
    policy = law(layout)
    actions, memory = policy.predict(observations, deterministic=True)
    assert actions.shape == (len(observations), layout.action_size)
    assert actions.dtype == np.float32
    assert np.abs(actions).max() <= layout.action_bound

    kept = observations.copy(), deepcopy(memory)
    first, after = policy.predict(observations, state=memory)
    again, after_again = policy.predict(observations, state=memory)
    assert np.array_equal(observations, kept[0])
    assert np.array_equal(first, again)
    if memory is not None:  # it is left alone
        for each, others in ((memory, kept[1]), (after, after_again)):
            assert all(map(np.array_equal, arrays(each), arrays(others)))
        assert not any(np.shares_memory(new, old) for new in arrays(after) for old in arrays(memory))

    for row in (0, 4):  # a single observation gives a single action
        action, alone = law(layout).predict(observations[row])
        assert np.array_equal(action, actions[row])
        assert np.array_equal(law(layout).predict(observations[row], state=alone)[0], first[row])


@pytest.mark.parametrize("law", [law for law in LAWS if law.initial_memory is not laws.Law.initial_memory])
def test_rows_whose_episode_starts_forget_and_all_others_remember(law):
    layout, observations = observe(law)
    policy, memory = law(layout), None
    for scale in (1.0, 0.9, 0.7, 0.4):
        _, memory = policy.predict((observations * scale).astype(np.float32), state=memory)
    starts = np.arange(len(observations)) % 3 == 0
    mixed, mixed_memory = policy.predict(observations, state=memory, episode_start=starts)
    going, going_memory = policy.predict(observations, state=memory)
    fresh, fresh_memory = policy.predict(observations)
    assert np.array_equal(mixed, np.where(starts[:, None], fresh, going))
    memories = zip(*map(arrays, (mixed_memory, fresh_memory, going_memory)), strict=True)
    for found, start, other in memories:
        assert np.array_equal(found[starts], start[starts], equal_nan=True)
        assert np.array_equal(found[~starts], other[~starts], equal_nan=True)
    assert not all(map(np.array_equal, arrays(going_memory), arrays(fresh_memory)))


def test_observations_and_memories_of_another_scenario_are_refused():
    layout, observations = observe(laws.Adaptive)
    _, foreign = observe(laws.Adaptive, BLOCKS)
    law = laws.Adaptive(layout)
    with pytest.raises(ValueError, match="this policy was built for observations of length"):
        law.predict(foreign)
    with pytest.raises(ValueError, match=r"episode_start has the shape \(2,\), and the 15 rows need \(15,\)"):
        law.predict(observations, episode_start=np.zeros(2, bool))
    _, memory = law.predict(observations)
    with pytest.raises(ValueError, match=r"memory has the shape \(15, 2\).*need \(3, 2\); pass state=None"):
        law.predict(observations[:3], state=memory)


@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_random_policy_fills_the_action_box_and_repeats_with_its_seed(kind):
    layout = world_and_encoder("energy", kind=kind)[1].layout
    observations = np.zeros((4000, layout.size), dtype=np.float32)
    observations[:, layout.slices["clock"].start] = np.arange(4000)
    actions, _ = laws.RandomPolicy(layout, seed=3).predict(observations)
    assert np.array_equal(actions, laws.RandomPolicy(layout, seed=3).predict(observations)[0])
    assert not np.array_equal(actions, laws.RandomPolicy(layout, seed=4).predict(observations)[0])
    bound = layout.action_bound
    assert 0.99 * bound < np.abs(actions).max() <= bound
    assert np.abs(actions.mean(axis=0)).max() < 0.05 * bound
    assert laws.RandomPolicy(layout).predict(observations[0])[0].shape == (layout.action_size,)
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0"):
        laws.RandomPolicy(layout, seed=-1)
