"""The task of BenchMARL, whose pins admit an older TorchRL than the tests have: where it is missing, a stand-in."""

import importlib
import importlib.util
import sys
from types import ModuleType

import pytest
from extras import need_torchrl

need_torchrl()

from test_vector import SHORT
from torchrl.envs import check_env_specs

from ptne_env.envs.torchrl import TorchRLEnv


class TaskClass:
    """What BenchMARL's class of this name keeps."""

    def __init__(self, name, config):
        self.name, self.config = name, {} if config is None else config


@pytest.fixture
def task_class(monkeypatch):
    if importlib.util.find_spec("benchmarl") is None:
        module = ModuleType("benchmarl.environments")
        module.TaskClass = TaskClass
        monkeypatch.setitem(sys.modules, "benchmarl", ModuleType("benchmarl"))
        monkeypatch.setitem(sys.modules, "benchmarl.environments", module)
        monkeypatch.delitem(sys.modules, "ptne_env.envs.benchmarl", raising=False)
    return importlib.import_module("ptne_env.envs.benchmarl").NashSeekingTask


def test_a_task_makes_one_batched_environment_of_its_scenario(task_class):
    task = task_class("random-energy", {**SHORT, "interface": "local"})
    env = task.get_env_fun(3, continuous_actions=True, seed=4, device="cpu")()
    assert isinstance(env, TorchRLEnv)
    assert (env.batch_size, env.vector.scenario.steps, env.layout.interface.kind) == ((3,), 6, "local")
    expected = TorchRLEnv("random-energy", 3, seed=4, **SHORT, interface="scaled").reset()
    assert (env.reset() == expected).all()
    check_env_specs(env)


def test_specifications_are_those_of_one_environment(task_class):
    task = task_class("random-energy")
    env = task.get_env_fun(3, continuous_actions=True, seed=None, device="cpu")()
    assert task.group_map(env) == {"player": [f"player_{index}" for index in range(5)]}
    assert task.observation_spec(env)["player", "observation"].shape == (5, env.layout.size)
    assert list(task.observation_spec(env)["player"].keys()) == ["observation"]
    assert task.action_spec(env)["player", "action"].shape == (5, env.layout.action_size)
    assert [spec(env) for spec in (task.info_spec, task.state_spec, task.action_mask_spec)] == [None] * 3
    assert [task.supports_continuous_actions(), task.supports_discrete_actions(), task.has_render(env)] == [1, 0, 0]
    assert task.env_name() == "ptne"


def test_the_longest_rollout_is_an_episode(task_class):
    task = task_class("random-energy", {"steps": 6, "hold_steps": 2})
    env = task.get_env_fun(2, continuous_actions=True, seed=0, device="cpu")()
    assert env.rollout(100).shape == (2, task.max_steps(env))
