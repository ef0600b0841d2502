"""Checkpoints keep every bit, and are data: a damaged or foreign one is refused and runs nothing."""

import dataclasses
import os
import pickle
import random
from pathlib import Path

import numpy as np
import pytest
from extras import need_sb3

torch = need_sb3()

from stable_baselines3 import PPO

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn.training import checkpoint, ppo
from ptne_env.learn.training.arguments import Arguments
from ptne_env.learn.training.checkpoint import Record

ARGUMENTS = Arguments("random-energy", envs=1, rollout=4, minibatches=2, hidden=(4,), products=False)
RECORD = Record({"seed": 0}, 20, 0.1, 2)
FLIPS = 10_000 if os.environ.get("PTNE_SOAK") else 300


def new_model(**changes):
    arguments = dataclasses.replace(ARGUMENTS, **changes)
    env = PlayerVecEnv("random-energy", arguments.envs, interface="local", seed=0)
    return PPO("MlpPolicy", env, **ppo.settings(arguments, env.layout))


@pytest.fixture(scope="module")
def trained():
    return new_model().learn(40)


@pytest.fixture
def path(trained, tmp_path):
    path = tmp_path / "checkpoint.npz"
    checkpoint.save(path, trained, RECORD)
    return path


def same(model, other):
    """Whether all values and the optimiser's state agree, bit for bit."""
    mine, theirs = model.get_parameters(), other.get_parameters()
    pairs = zip(torch.utils._pytree.tree_leaves(mine), torch.utils._pytree.tree_leaves(theirs), strict=True)
    return all(torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b for a, b in pairs)


def test_a_checkpoint_keeps_network_optimiser_and_record(trained, path):
    model = new_model(seed=1)
    record, arrays = checkpoint.read(path)
    checkpoint.restore(model, arrays)
    assert record == RECORD
    assert len(model.get_parameters()["policy.optimizer"]["state"]) == len(list(model.policy.parameters()))
    for group in model.policy.optimizer.param_groups:  # the rate is set before each update
        group["lr"] = trained.policy.optimizer.param_groups[0]["lr"]
    assert same(model, trained)


def test_the_state_before_the_first_step_is_kept_too(tmp_path):
    first, second = new_model(), new_model(seed=1)
    checkpoint.save(tmp_path / "checkpoint.npz", first, RECORD)
    checkpoint.restore(second, checkpoint.read(tmp_path / "checkpoint.npz")[1])
    assert same(first, second)


def test_a_damaged_checkpoint_is_refused_or_reads_the_same(path):
    record, arrays = checkpoint.read(path)
    content, randomness, refused = path.read_bytes(), random.Random(0), set()  # noqa: S311 - damage
    for case in range(FLIPS):
        damaged = bytearray(content)
        if case % 3:
            damaged[randomness.randrange(len(content))] ^= 1 << randomness.randrange(8)
        else:
            del damaged[randomness.randrange(len(content)) :]
        path.write_bytes(damaged)
        try:
            other, others = checkpoint.read(path)
        except ValueError as error:
            refused.add(str(error).partition("(")[0])
        else:  # dates and other entries of the archive that nothing reads
            assert other == record
            assert others.keys() == arrays.keys()
            assert all(np.array_equal(others[name], arrays[name]) for name in arrays)
    assert refused == {f"{path} is damaged, or no checkpoint: remove it to train afresh "}


class Bomb:
    """An object whose unpickling makes a file."""

    def __init__(self, target):
        self.target = str(target)

    def __reduce__(self):
        return Path.touch, (Path(self.target),)


@pytest.mark.parametrize("kind", ["pickle", "torch", "array"])
def test_a_pickle_in_place_of_a_checkpoint_does_not_run(kind, tmp_path):
    target, path = tmp_path / "harmed", tmp_path / "checkpoint.npz"
    bomb = Bomb(target)
    if kind == "pickle":
        path.write_bytes(pickle.dumps(bomb))
        pickle.loads(path.read_bytes())  # noqa: S301 - our own
    elif kind == "torch":
        torch.save(bomb, path)
        torch.load(path, weights_only=False)
    else:
        with path.open("wb") as file:
            np.savez(file, record=np.array(bomb, dtype=object))
        np.load(path, allow_pickle=True)["record"]
    assert target.exists(), "the bomb is no bomb"
    target.unlink()
    content = path.read_bytes()
    with pytest.raises(ValueError, match="checkpoint.npz is damaged, or no checkpoint: remove it to train afresh"):
        ppo.train(ARGUMENTS, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.npz"]
    assert path.read_bytes() == content


def test_arrays_for_another_network_are_refused_and_change_nothing(path):
    _, arrays = checkpoint.read(path)
    name = "exp_avg/action_net.weight"
    wrong = [
        arrays | {name: arrays[name][:, :1]},
        arrays | {name: arrays[name].astype(np.float64)},
        arrays | {"more": np.zeros(1)},
        {other: array for other, array in arrays.items() if other != name},
    ]
    model, untouched = new_model(seed=1), new_model(seed=1)
    checkpoint.save(path, untouched, RECORD)  # both have the state before the first step
    for others in wrong:
        with pytest.raises(ValueError, match="does not fit the network"):
            checkpoint.restore(model, others)
    assert same(model, untouched)


@pytest.mark.parametrize("change", [{"parts": 0}, {"agent_steps": "20"}, {"seconds": -1.0}])
def test_a_record_with_wrong_numbers_is_refused(change, path, monkeypatch, trained):
    monkeypatch.setattr(checkpoint, "asdict", lambda record: dataclasses.asdict(record) | change)
    checkpoint.save(path, trained, RECORD)
    with pytest.raises(ValueError, match=f"remove it to train afresh.*{next(iter(change))}"):
        checkpoint.read(path)


def test_a_record_with_other_numbers_is_of_another_kind_and_not_called_damaged(path, monkeypatch, trained):
    monkeypatch.setattr(checkpoint, "asdict", lambda record: dataclasses.asdict(record) | {"more": 1})
    checkpoint.save(path, trained, RECORD)
    with pytest.raises(ValueError, match="another kind of policy, or of another version .*; choose another folder"):
        checkpoint.read(path)
