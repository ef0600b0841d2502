"""The interface of PufferLib: the caller's arrays, equality with the array interface, ends, seeds, and bad input."""

import copy

import numpy as np
import pytest
from test_vector import SHORT, random_actions

from ptne_env import VectorParallelEnv
from ptne_env.envs.puffer import PlayerBufferEnv

BATCH, AGENTS = 3, 15
NAMES = ("observations", "rewards", "terminals", "truncations", "masks", "actions")


def make(**arguments):
    return PlayerBufferEnv("random-energy", BATCH, **{**SHORT, **arguments})


def arrays(workers=1):
    """Arrays of several workers, one after the other, as PufferLib's shared memory has them."""
    layout, count = make().layout, workers * AGENTS
    return {
        "observations": np.full((count, layout.size), 7, dtype=np.float32),
        "rewards": np.full(count, 7, dtype=np.float32),
        "terminals": np.ones(count, dtype=bool),
        "truncations": np.ones(count, dtype=bool),
        "masks": np.zeros(count, dtype=bool),
        "actions": np.zeros((count, layout.action_size), dtype=np.float32),
    }


def draw(env, generator):
    return random_actions(env.vector, generator).reshape(AGENTS, -1)


@pytest.mark.parametrize("max_cycles", [None, 4])
@pytest.mark.parametrize("is_given", [True, False])
def test_the_arrays_of_the_caller_hold_every_step_of_the_vector_bit_for_bit(is_given, max_cycles):
    buf = arrays() if is_given else None
    env, vector = make(buf=buf, max_cycles=max_cycles), VectorParallelEnv("random-energy", BATCH, **SHORT)
    vector.max_cycles = max_cycles
    held = {name: getattr(env, name) for name in NAMES}
    if buf is not None:
        assert all(held[name] is buf[name] for name in NAMES)
    assert held["masks"].all()
    generator, ends = np.random.default_rng(0), 0
    env.async_reset(seed=2)
    expected = vector.reset(seed=2 * BATCH)
    for step in range(16):
        observations, rewards, terminals, truncations, infos, ids, masks = env.recv()
        returned = observations, rewards, terminals, truncations, masks
        assert all(array is held[name] for array, name in zip(returned, (*NAMES[:4], "masks"), strict=True))
        assert np.array_equal(observations, expected.reshape(AGENTS, -1))
        assert ids.tolist() == list(range(AGENTS))
        if step == 0:
            assert not any(array.any() for array in (rewards, terminals, truncations))
            assert infos == []
        actions = draw(env, generator)
        outcome = vector.step(actions.reshape(BATCH, 5, -1))
        expected, over = outcome.observations, outcome.terminated | outcome.truncated
        env.send(actions)
        assert np.array_equal(env.rewards, outcome.rewards.reshape(-1).astype(np.float32))
        assert np.array_equal(env.terminals, outcome.terminated.repeat(5))
        assert np.array_equal(env.truncations, outcome.truncated.repeat(5))
        if over.any():
            ends += 1
            shares = {name: outcome.infos[name][over].mean() for name in ("is_success", "diverged")}
            assert env.infos == [shares]
            expected = vector.reset(mask=over)
        else:
            assert env.infos == []
    assert ends > 1


def test_workers_write_their_own_part_of_shared_memory():
    buf = arrays(workers=2)
    parts = [{name: array[start : start + AGENTS] for name, array in buf.items()} for start in (0, AGENTS)]
    workers = [make(buf=part, seed=seed) for seed, part in enumerate(parts)]
    for worker in workers:
        worker.reset()
    vector = VectorParallelEnv("random-energy", 2 * BATCH, **SHORT)
    expected = vector.reset(seed=0)  # successive seeds of workers have no episode in common
    assert np.array_equal(buf["observations"], expected.reshape(2 * AGENTS, -1))
    before = buf["observations"][AGENTS:].copy()
    workers[0].step(draw(workers[0], np.random.default_rng(0)))
    assert np.array_equal(buf["observations"][AGENTS:], before)


def test_attributes_are_those_that_pufferlib_reads():
    env = make()
    assert (env.num_agents, env.agents_per_batch, env.emulated, env.done) == (AGENTS, AGENTS, False, False)
    assert env.driver_env is env
    assert env.single_observation_space == env.vector.single_observation_space
    assert env.observation_space.shape == (AGENTS, env.layout.size)
    assert env.action_space.shape == env.actions.shape == (AGENTS, env.layout.action_size)
    assert env.close() is None


def test_the_seed_of_the_constructor_holds_for_the_first_reset():
    seeded, env = make(seed=4), make()
    first = seeded.reset()[0].copy()
    assert np.array_equal(env.reset(seed=4)[0], first)
    assert not np.array_equal(seeded.reset()[0], first)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"observations": None}, "buf has no 'observations': it holds observations, rewards"),
        ({"rewards": np.zeros(AGENTS)}, r"buf\['rewards'\] is a C-contiguous array of float32 of shape \(15,\)"),
        ({"terminals": np.zeros(AGENTS, dtype=np.int8)}, "of bool"),
        ({"truncations": np.zeros(AGENTS - 1, dtype=bool)}, r"got bool of shape \(14,\)"),
        ({"actions": np.zeros((5, AGENTS), dtype=np.float32).T}, "not contiguous"),
        ({"masks": "terminals"}, r"buf\['terminals'\] and buf\['masks'\] share memory"),
        ({"masks": [True] * AGENTS}, "got a list"),
    ],
    ids=str,
)
def test_arrays_that_do_not_fit_are_refused_and_not_written(change, complaint):
    buf = arrays()
    untouched = {name: array.copy() for name, array in buf.items()}
    ((name, value),) = change.items()
    given = {**buf, name: buf[value] if isinstance(value, str) else value}
    if value is None:
        del given[name]
    with pytest.raises(ValueError, match=complaint):
        make(buf=given)
    assert all(np.array_equal(buf[name], untouched[name]) for name in NAMES)


@pytest.mark.parametrize("arguments", [{"num_envs": 0}, {"scenario": "nothing"}, {"seed": -1}], ids=str)
def test_arguments_without_sense_are_refused(arguments):
    with pytest.raises(ValueError, match=f"{next(iter(arguments))}|{next(iter(arguments.values()))}"):
        PlayerBufferEnv(**arguments)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda good: good[:14], r"actions of 15 agents have the shape \(15, 5\), got \(14, 5\)"),
        (lambda good: good > 0, "actions are numbers of shape"),
        (lambda good: good * np.nan, "without NaN or infinity"),
        (np.ma.masked_array, "actions must be a plain array"),
    ],
)
def test_actions_that_are_refused_change_nothing(change, complaint):
    env, undisturbed = make(), make()
    good = draw(env, np.random.default_rng(0))
    for each in (env, undisturbed):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=complaint):
        env.step(change(good))
    for mine, theirs in zip(env.step(good), undisturbed.step(good), strict=True):
        assert np.array_equal(mine, theirs)


def test_a_seed_that_is_refused_changes_nothing():
    env = make()
    env.reset(seed=0)
    before = env.observations.copy()
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)
    assert np.array_equal(env.observations, before)


def test_a_step_before_the_first_reset_is_refused():
    with pytest.raises(RuntimeError, match="3 of 3 environments are over or not started"):
        make().step(np.zeros((AGENTS, 5), dtype=np.float32))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_a_copy_is_refused_because_the_arrays_belong_to_the_trainer(copied):
    with pytest.raises(TypeError, match="cannot be copied: make a new one"):
        copied(PlayerBufferEnv("energy"))
