"""Damaged policy files: refused with :class:`PolicyFileError`, or loaded as a policy that decides."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from affine_games import SOAK
from extras import need_sb3

onnx = need_sb3("onnx")

from onnx import helper
from stable_baselines3 import PPO

from ptne_env import learn as policies
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn import PolicyFileError
from ptne_env.learn.archive import load_archive

ONNX_FILES, ARCHIVES = (900, 100) if SOAK else (40, 10)
VALUES = [None, True, -1, 0, 10**30, 1e300, "", "text", "\x1b[31m", "\ud800", [], [1, [2]], {}, {"a": {}}]


def damaged(content, rng):
    """The content with flipped bits, cut off, with inserted bytes, or with a part of itself in another place."""
    data = bytearray(content)
    place, length = int(rng.integers(len(data))), int(rng.integers(1, 40))
    kind = rng.integers(4)
    if kind == 0:
        for index in rng.integers(len(data), size=length):
            data[index] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del data[place:]
    elif kind == 2:
        data[place:place] = rng.bytes(length)
    else:
        source = int(rng.integers(len(data)))
        data[place : place + length] = data[source : source + length]
    return bytes(data)


def with_changed_metadata(content, rng):
    """The ONNX file with one value of its metadata replaced, left out or added."""
    model = onnx.load_from_string(content)
    data = json.loads(model.metadata_props[0].value)
    target = data["interface"] if rng.random() < 0.3 else data
    key = str(rng.choice([*target, "other"]))
    value = VALUES[rng.integers(len(VALUES))]
    if rng.random() < 0.2:
        target.pop(key, None)
    else:
        target[key] = value
    helper.set_model_props(model, {"ptne_env": json.dumps(data)})
    return model.SerializeToString()


def assert_all_end(load, paths, size_of):
    """Some files are refused, and the others are loaded and decide."""

    def attempt(path):
        try:
            policy = load(path)
        except PolicyFileError:
            return "refused"
        actions, _ = policy.predict(np.zeros((3, size_of(policy)), dtype=np.float32), deterministic=True)
        assert actions.shape[0] == 3
        return "loaded"

    with ThreadPoolExecutor(4) as threads:
        outcomes = list(threads.map(attempt, paths))
    assert set(outcomes) == {"refused", "loaded"}


def test_damaged_onnx_files_are_refused_or_decide(tmp_path):
    rng = np.random.default_rng(0)
    contents = [policies.shipped_path(name).read_bytes() for name in policies.shipped()]
    paths = []
    for number in range(ONNX_FILES):
        change = with_changed_metadata if number % 3 == 0 else damaged
        paths.append(tmp_path / f"{number}.onnx")
        paths[-1].write_bytes(change(contents[number % len(contents)], rng))
    assert_all_end(policies.load, paths, lambda policy: policy.observation_size)


@pytest.mark.filterwarnings("ignore")  # of Stable-Baselines3, torch and pickle about what they find
def test_damaged_archives_that_are_trusted_are_refused_or_decide(tmp_path):
    rng = np.random.default_rng(0)
    env = PlayerVecEnv("random-energy", 1, interface="scaled")
    PPO("MlpPolicy", env, policy_kwargs={"net_arch": [4]}, device="cpu", seed=0).save(tmp_path / "model.zip")
    content, paths = (tmp_path / "model.zip").read_bytes(), [tmp_path / "model.zip"]
    for number in range(ARCHIVES):
        paths.append(tmp_path / f"{number}.zip")
        paths[-1].write_bytes(damaged(content, rng))
    assert_all_end(load_archive, paths, lambda policy: env.layout.size)
