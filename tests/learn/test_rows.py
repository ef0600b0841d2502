"""A policy decides every row alike, bit for bit, in every batch: other rows, another order, another number of rows."""

import sys
from functools import partial

import numpy as np
import pytest
from extras import need_sb3

need_sb3()

import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO, SAC

from ptne_env import get_scenario
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.evaluation import POLICIES
from ptne_env.learn import PolicyFileError
from ptne_env.learn.sb3_archive import load_archive
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.world import dynamics
from ptne_env.world.world import World

STEPS, EPISODES = 6, 4
WORLDS = [World(get_scenario(name)) for name in ("random-energy", "random-energy-switching", "robots")]
WORLDS.append(World(get_suite("ptne-v1").track("liar").scenario))


def parts_of(rows, rng):
    """Row numbers of batches that have the same rows as a batch of ``rows``."""
    order = rng.permutation(rows)
    return [order, *np.split(order, [1, 3, 6, 13]), *rng.choice(rows, (3, 1), replace=False)]


class Part:
    """A policy of its own for some rows."""

    def __init__(self, policy, rows):
        self.policy, self.rows, self.memory = policy, rows, None

    def decide(self, observations, episode_start):
        actions, self.memory = self.policy.predict(
            observations[self.rows], self.memory, episode_start[self.rows], deterministic=True
        )
        return actions


def assert_decides_rows_alike(policy_of, observations_of, rows):
    """``observations_of`` gives the rows of a step from the actions of the previous step."""
    rng = np.random.default_rng(0)
    whole = Part(policy_of(), np.arange(rows))
    parts = [Part(policy_of(), chosen) for chosen in parts_of(rows, rng)]
    actions = None
    for step in range(STEPS):
        observations, episode_start = observations_of(actions), np.full(rows, step == 0)
        actions = whole.decide(observations, episode_start)
        for part in parts:
            np.testing.assert_array_equal(part.decide(observations, episode_start), actions[part.rows])


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_every_policy_of_the_library_decides_rows_alike(name):
    fitting = 0
    for world in WORLDS:
        spec = POLICIES[name].on_scenario(world.scenario.name)
        try:
            encoder = Encoder(world, spec.interface)
            spec.build(encoder.layout)
        except LayoutError:
            continue
        layout, rows = encoder.layout, EPISODES * encoder.layout.num_players
        fitting += 1
        state = dynamics.draw_initial_state(world, [RandomStreams.from_seed(seed) for seed in range(EPISODES)])

        def observations_of(actions, encoder=encoder):
            nonlocal state
            if actions is not None:
                inputs = encoder.decode(actions.reshape(EPISODES, encoder.layout.num_players, -1), state)
                state = dynamics.step(encoder.world, state, inputs)
            return encoder.observe(state).reshape(-1, encoder.layout.size)

        assert_decides_rows_alike(partial(spec.build, layout), observations_of, rows)
    assert fitting


def random_rows(size, rows=70):
    rng = np.random.default_rng(1)
    scales = rng.choice([0.01, 1.0, 30.0], (STEPS, rows, 1))
    steps = iter((scales * rng.normal(size=(STEPS, rows, size))).astype(np.float32))
    return lambda _: next(steps)


@pytest.mark.parametrize(
    ("algorithm", "network", "arguments"),
    [
        (PPO, "MlpPolicy", {"net_arch": [400, 300], "activation_fn": torch.nn.ELU}),
        (SAC, "MlpPolicy", {}),
        (RecurrentPPO, "MlpLstmPolicy", {"lstm_hidden_size": 17, "n_lstm_layers": 2}),
    ],
)
def test_archives_decide_rows_alike_in_the_interface_of_their_training(tmp_path, algorithm, network, arguments):
    env = PlayerVecEnv("random-energy", 1, interface="physical")
    path = tmp_path / "model.zip"
    algorithm(network, env, seed=0, device="cpu", policy_kwargs=arguments).save(path)
    policy = load_archive(str(path), env.layout)
    assert policy.interface == env.layout.interface
    assert_decides_rows_alike(lambda: policy, random_rows(env.layout.size), 70)
    row = np.ones(env.layout.size, dtype=np.float32)
    one, two = (policy.predict(rows, deterministic=True)[0] for rows in (row, np.stack([row, row])))
    np.testing.assert_array_equal(np.stack([one, one]), two)


def test_another_archive_or_layout_is_refused(tmp_path):
    scaled = PlayerVecEnv("random-energy", 1)
    path = tmp_path / "model.zip"
    PPO("MlpPolicy", scaled, device="cpu").save(path)
    assert load_archive(str(path)).interface == scaled.layout.interface
    with pytest.raises(LayoutError, match=r"the policy was made for another layout; size: policy 24, environment"):
        load_archive(str(path), PlayerVecEnv("robots", 1).layout)
    for content in (b"", b"not a zip", path.read_bytes()[:-300]):
        path.write_bytes(content)
        with pytest.raises(PolicyFileError, match="is not an archive of a Stable-Baselines3 model"):
            load_archive(str(path))
    PPO("MlpPolicy", "Pendulum-v1", device="cpu").save(path)
    with pytest.raises(LayoutError, match="interface: .*'physical'.*; size: policy 3, .*action_size: policy 1,"):
        load_archive(str(path), scaled.layout)
    PPO("MlpPolicy", "CartPole-v1", device="cpu").save(path)
    with pytest.raises(PolicyFileError, match="was not trained on one player's observations and actions"):
        load_archive(str(path))


def test_without_stable_baselines3_the_extra_to_install_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.save_util", None)
    with pytest.raises(ImportError, match=r'pip install "ptne-env\[sb3\]"'):
        load_archive("model.zip")
