"""The batched environment of TorchRL: keys, equality with arrays, memory, partial resets and bad input."""

import numpy as np
import pytest
from extras import need_sb3, need_torchrl

need_torchrl(), need_sb3()

import torch
from tensordict import TensorDict
from torchrl.envs import PettingZooWrapper, check_env_specs
from worlds import SHORT, random_actions

import ptne_env
from ptne_env import VectorParallelEnv
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.envs.torchrl import TorchRLEnv

OBSERVATION, ACTION, REWARD = ("player", "observation"), ("player", "action"), ("player", "reward")


def make(name="random-energy", num_envs=3, **arguments):
    return TorchRLEnv(name, num_envs, **{**SHORT, **arguments})


def acting(env, tensordict, generator):
    """The tensordict with random actions, and these."""
    actions = random_actions(env.vector, generator)
    tensordict[ACTION] = torch.from_numpy(actions)
    return tensordict, actions


@pytest.mark.parametrize("arguments", [{"interface": "physical"}, {"max_cycles": 2}], ids=str)
def test_torchrl_finds_no_fault_in_the_specifications(arguments):
    check_env_specs(make(**arguments), seed=0)


def test_keys_shapes_and_dtypes_are_those_of_the_wrapper_of_pettingzoo():
    env = make(num_envs=4)
    with pytest.warns(UserWarning, match="PettingZoo in TorchRL is tested"):
        single = PettingZooWrapper(ptne_env.parallel_env("random-energy", **SHORT))
    assert env.batch_size == (4,)
    assert env.group_map == single.group_map == {"player": [f"player_{index}" for index in range(5)]}
    batched, alone = env.rollout(3), single.rollout(3)
    keys = set(alone.keys(include_nested=True, leaves_only=True))
    assert set(batched.keys(include_nested=True, leaves_only=True)) == keys
    for key in keys:
        assert batched[key].dtype == alone[key].dtype, key
        assert batched[key].shape == (4, *alone[key].shape), key
    for spec in ("observation", "action", "reward", "done"):
        unbatched, expected = getattr(env, f"full_{spec}_spec_unbatched"), getattr(single, f"full_{spec}_spec")
        assert unbatched.to("cpu") == expected.to("cpu"), spec


@pytest.mark.parametrize("max_cycles", [None, 4])
def test_episodes_and_partial_resets_equal_those_of_arrays_and_of_single_players_bit_for_bit(max_cycles):
    players = PlayerVecEnv("random-energy", 3, **SHORT, max_cycles=max_cycles, seed=5)
    env, vector = make(max_cycles=max_cycles), VectorParallelEnv("random-energy", 3, **SHORT, max_cycles=max_cycles)
    generator, ends = np.random.default_rng(0), 0
    following = env.reset(seed=5)
    assert np.array_equal(following[OBSERVATION].numpy(), vector.reset(seed=5)[0])
    assert np.array_equal(following[OBSERVATION].numpy().reshape(15, -1), players.reset())
    for step in range(15):
        if step == 2:
            following = env.reset(following.update(named([False, True, False])))
            assert np.array_equal(following[OBSERVATION].numpy(), vector.reset(mask=[False, True, False])[0])
            players.vector.reset(mask=[False, True, False])
        present, actions = acting(env, following, generator)
        present, following = env.step_and_maybe_reset(present)
        outcome, moved = vector.step(actions), present["next"]
        assert np.array_equal(moved[OBSERVATION].numpy(), outcome.observations)
        assert np.array_equal(moved[REWARD].numpy()[:, :, 0], outcome.rewards.astype(np.float32))
        over = outcome.terminated | outcome.truncated
        for name, flag in {"done": over, "terminated": outcome.terminated, "truncated": outcome.truncated}.items():
            assert np.array_equal(moved[name].numpy()[:, 0], flag), name
            assert np.array_equal(moved["player", name].numpy()[:, :, 0], np.repeat(flag[:, None], 5, axis=1)), name
        expected = outcome.observations
        if over.any():
            ends += 1
            expected, _ = vector.reset(mask=over)
        assert np.array_equal(following[OBSERVATION].numpy(), expected)
        seen, rewards, dones, infos = players.step(actions.reshape(15, -1))
        cut = [info.get("TimeLimit.truncated", False) for info in infos]
        found = {"reward": rewards, "done": dones, "truncated": np.array(cut)}
        assert all(np.array_equal(moved["player", name].numpy().ravel(), each) for name, each in found.items())
        assert np.array_equal(seen, expected.reshape(15, -1))
        assert not following["done"].any()
    assert ends > 2


def named(mask):
    """A tensordict that names the environments to reset."""
    return TensorDict({"_reset": torch.tensor(mask)[:, None]}, (len(mask),))


def test_a_seed_counts_up_by_environment_and_holds_for_one_start_of_each():
    by_reset, by_argument, by_method = make(), make(seed=7), make()
    by_method.set_seed(7)
    starts = [env.reset()[OBSERVATION] for env in (by_argument, by_method)]
    starts.append(by_reset.reset(seed=7)[OBSERVATION])
    assert torch.equal(starts[0], starts[1])
    assert torch.equal(starts[0], starts[2])
    assert not torch.equal(by_reset.reset()[OBSERVATION], starts[0])
    alone = ptne_env.parallel_env("random-energy", **SHORT)
    assert np.array_equal(alone.reset(seed=8)[0]["player_2"], starts[0][1, 2])


def test_a_rollout_that_steps_some_environments_alone_is_refused_and_steps_none():
    env = make()
    start = env.reset(seed=0)
    present, _ = acting(env, start.clone(), np.random.default_rng(0))
    with pytest.raises(ValueError, match="break_when_any_done=False"):
        env.step(present.clone().set("_step", torch.tensor([[True], [False], [True]])))
    untouched, _ = acting(make(), start.clone(), np.random.default_rng(0))
    fresh = make()
    fresh.reset(seed=0)
    whole = present.clone().set("_step", torch.ones((3, 1), dtype=torch.bool))
    assert torch.equal(env.step(whole)["next"][OBSERVATION], fresh.step(untouched)["next"][OBSERVATION])
