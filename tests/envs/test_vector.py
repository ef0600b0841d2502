"""The vector environment's own facts: seeds, masks, restarts; what all adapters promise is in test_adapters.py."""

import numpy as np
import pytest
from test_adapters import same
from worlds import SHORT, make_env, random_actions

from ptne_env import VectorParallelEnv
from ptne_env.envs import vector as vector_module
from ptne_env.envs.vector import VectorStep


@pytest.fixture(params=[1024, 2], ids=["one block", "blocks of two"])
def block_size(request, monkeypatch):
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", request.param)
    return request.param


def make(name="random-energy", num_envs=5, **arguments):
    return VectorParallelEnv(name, num_envs, **{"interface": "physical", **SHORT, **arguments})


def first(env, **arguments):
    """The observations of a reset."""
    return env.reset(**arguments)[0]


def go_on(env, steps, seed=1):
    """All that is returned in ``steps`` steps, with a reset after each end."""
    generator, record = np.random.default_rng(seed), []
    for _ in range(steps):
        outcome = env.step(random_actions(env, generator))
        record.append(tuple(outcome))
        over = outcome.terminated | outcome.truncated
        if over.any():
            record.append(env.reset(mask=over))
    return record


def test_shapes_and_dtypes_are_as_documented(block_size):
    env = make(reward={"digits": 1.0, "payoff": 1e-3})
    observations, infos = env.reset(seed=0)
    outcome = env.step(random_actions(env, np.random.default_rng(0)))
    assert type(outcome) is VectorStep
    returned = {
        "first observations": observations,
        **{name: value for name, value in outcome._asdict().items() if name != "infos"},
        **outcome.infos,
    }
    assert {name: (array.shape, array.dtype) for name, array in returned.items()} == {
        "first observations": ((5, 5, env.layout.size), np.float32),
        "observations": ((5, 5, env.layout.size), np.float32),
        "rewards": ((5, 5), np.float64),
        "terminated": ((5,), np.bool_),
        "truncated": ((5,), np.bool_),
        "diverged": ((5,), np.bool_),
        "clipped": ((5, 5), np.int64),
        "is_success": ((5,), np.bool_),
        "reward_digits": ((5, 5), np.float64),
        "reward_payoff": ((5, 5), np.float64),
    }
    assert {name: (array.shape, array.dtype) for name, array in infos.items()} == {
        name: (array.shape, array.dtype) for name, array in outcome.infos.items()
    }
    assert env.single_observation_space.shape == (env.layout.size,)
    assert env.single_action_space.shape == (env.layout.action_size,)


def test_a_seed_is_counted_up_and_a_list_is_taken_as_it_is(block_size):
    env = make(num_envs=4)
    counted = first(env, seed=20)
    assert np.array_equal(first(env, seed=[20, 21, 22, 23]), counted)
    assert np.array_equal(first(env, seed=np.int64(20)), counted)
    assert np.array_equal(first(env, seed=np.arange(20, 24)), counted)
    assert np.array_equal(first(env, seed=[23, 22, 21, 20]), counted[::-1])
    assert len({row.tobytes() for row in counted}) == 4
    alone = make_env("random-energy", **SHORT)
    for index in range(4):
        observations, _ = alone.reset(seed=20 + index)
        assert np.array_equal(np.stack(list(observations.values())), counted[index])


def test_without_a_seed_the_generators_continue(block_size):
    env, other = make(), make()
    one = first(env, seed=1)
    second = first(env)
    assert not np.any(np.all(one == second, axis=(1, 2)))
    other.reset(seed=1)
    assert np.array_equal(first(other), second)
    mixed = first(other, seed=[1, None, None, 4, None])
    assert np.array_equal(mixed[[0, 3]], one[[0, 3]])
    assert np.array_equal(mixed[[1, 2, 4]], first(env)[[1, 2, 4]])
    assert not np.array_equal(first(make()), first(make()))


def test_a_mask_restarts_only_its_environments(block_size):
    env = make(steps=60)
    env.reset(seed=0)
    before = go_on(env, 3)[-1][0]
    mask = np.array([False, True, True, False, False])
    observations = first(env, mask=mask)
    assert np.array_equal(observations[~mask], before[~mask])
    assert not np.any(np.all(observations[mask] == before[mask], axis=(1, 2)))
    clock = env.layout.select(observations, "clock")[:, 0, 0]
    assert np.array_equal(clock == 0, mask)
    seeded = first(env, seed=[50, 51, 52, 53, 54], mask=mask)
    assert np.array_equal(seeded[mask], first(make(steps=60), seed=50)[mask])
    assert np.array_equal(seeded[~mask], before[~mask])
    assert np.array_equal(first(env, mask=[False] * 5), seeded)
    undisturbed = make(steps=60)
    undisturbed.reset(seed=0)
    assert np.array_equal(first(env)[~mask], first(undisturbed)[~mask])  # the seeds of others did not count


@pytest.mark.parametrize("reward", ["digits", {"tracking": 1.0, "payoff": 1e-3}])
def test_restarting_within_a_step_is_a_reset_without_a_step(reward, block_size):
    env, by_hand = (make(steps=60, reward=reward) for _ in range(2))
    env.reset(seed=0)
    by_hand.reset(seed=0)
    generator = np.random.default_rng(0)
    for restart in np.array([[0, 1, 0, 0, 1], [0, 0, 0, 0, 0], [1, 1, 1, 1, 1], [0, 0, 1, 1, 0]], dtype=np.bool_):
        actions = random_actions(env, generator)
        kept = restart.copy()
        ours, theirs = env.step(actions, restart), by_hand.step(actions)
        observations = first(by_hand, mask=restart)
        assert np.array_equal(restart, kept)
        assert np.array_equal(ours.observations, observations)
        assert np.array_equal(ours.rewards, np.where(restart[:, None], 0.0, theirs.rewards))
        for name in env.reward_names:
            assert np.array_equal(ours.infos[name], np.where(restart[:, None], 0.0, theirs.infos[name]))
        assert np.array_equal(ours.infos["clipped"], np.where(restart[:, None], 0, theirs.infos["clipped"]))
        assert theirs.infos["clipped"].any(axis=1).all()


BAD_RESETS = {
    "too few seeds": ({"seed": [1, 2, 3]}, "5 environments need as many seeds, got 3"),
    "a negative seed": ({"seed": [0, 1, 2, 3, -4]}, "a seed must be a whole number of at least 0, got -4"),
    "a fractional seed among others": ({"seed": [1, 2, 3, 4.5, 5]}, "a seed must be a whole number.*got 4.5"),
    "a text as seeds": ({"seed": "12345"}, "seeds are a whole number or 5 of them, got str"),
    "a masked mask": (
        {"mask": np.ma.masked_array([True] * 5)},
        "a reset mask must be a plain array, got a masked array",
    ),
    "a short mask": ({"mask": np.ones(4, dtype=np.bool_)}, r"a reset mask is 5 booleans, got bool of shape \(4,\)"),
    "a mask of numbers": ({"mask": [0, 1, 0, 1, 1]}, r"a reset mask is 5 booleans, got int64 of shape \(5,\)"),
    "one start too far out": (
        {"estimates": np.repeat([0.0] * 4 + [4e5], 25).reshape(5, 5, 5)},
        "own gradients at the initial estimates must be within",
    ),
}


@pytest.mark.parametrize("name", BAD_RESETS)
def test_bad_reset_is_refused_and_no_environment_is_touched(name, block_size):
    arguments, message = BAD_RESETS[name]
    env, undisturbed = make(steps=20, max_cycles=9), make(steps=20, max_cycles=9)
    for each in (env, undisturbed):
        each.reset(seed=0)
        go_on(each, 4)
    with pytest.raises(ValueError, match=message):
        env.reset(**arguments)
    assert same(go_on(env, 15, seed=3), go_on(undisturbed, 15, seed=3))


def test_the_first_reset_starts_every_environment(block_size):
    env = make()
    with pytest.raises(ValueError, match=r"the first reset\(\) starts every environment: leave out the mask"):
        env.reset(seed=0, mask=[True, True, False, False, False])
    assert np.array_equal(first(env, seed=0), first(make(), seed=0))


def test_step_of_environments_that_are_over_or_not_started_names_the_first(block_size):
    env = make(steps=30, input_limit=1e9)
    actions = np.zeros((5, 5, 5))
    with pytest.raises(RuntimeError, match=r"5 of 5 environments .* \(the first is 0\): call reset\(mask=...\) before"):
        env.step(actions)
    env.reset(seed=0)
    actions[[2, 4]] = 1e9
    over = env.step(actions).terminated
    assert over.tolist() == [False, False, True, False, True]
    with pytest.raises(RuntimeError, match=r"2 of 5 environments are over or not started \(the first is 2\)"):
        env.step(actions)
    with pytest.raises(RuntimeError, match=r"1 of 5 environments are over or not started \(the first is 4\)"):
        env.step(actions, np.array([False, False, True, False, False]))
    env.reset(mask=np.array([False, False, True, False, False]))
    with pytest.raises(RuntimeError, match=r"1 of 5 environments are over or not started \(the first is 4\)"):
        env.step(actions)
    env.reset(mask=over)
    env.step(np.zeros((5, 5, 5)))


def test_a_bad_restart_mask_is_refused_and_no_environment_moves():
    env, undisturbed = make(steps=20), make(steps=20)
    for each in (env, undisturbed):
        each.reset(seed=0)
    actions = np.zeros((5, 5, 5))
    with pytest.raises(ValueError, match="a restart mask is 5 booleans, got int64"):
        env.step(actions, np.ones(5, dtype=np.int64))
    assert np.array_equal(env.step(actions).observations, undisturbed.step(actions).observations)
