"""The BenchMARL task, whose environments are stepped together, and its trained actors as policies.

Needs ``pip install benchmarl``, in a virtual environment of its own, because BenchMARL pins an older TorchRL.
"""

from functools import partial
from typing import Any

import torch
from benchmarl.environments import TaskClass
from benchmarl.experiment import Experiment
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ptne_env.envs.torchrl import GROUP, TorchRLEnv
from ptne_env.perception.policy import NetworkPolicy
from ptne_env.shared.arrays import Float32Array
from ptne_env.world.world import World


class NashSeekingTask(TaskClass):
    """A task, such as ``NashSeekingTask("mine", {"scenario": "random-energy"})``.

    The name is used for files, and the dictionary holds arguments of :class:`~ptne_env.envs.torchrl.TorchRLEnv`. All
    players are one group, and a centralised critic receives the observations of all of them.
    """

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: str) -> Any:
        return partial(TorchRLEnv, num_envs=num_envs, seed=seed, **self.config)

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def has_render(self, env: Any) -> bool:
        return False

    def max_steps(self, env: Any) -> int:
        return World(env.vector.scenario).clock.total_steps

    def group_map(self, env: Any) -> Any:
        return env.group_map

    def observation_spec(self, env: Any) -> Any:
        spec = env.full_observation_spec_unbatched.clone()
        del spec[GROUP, "info"]  # BenchMARL's networks read every entry
        return spec

    def action_spec(self, env: Any) -> Any:
        return env.full_action_spec_unbatched

    def _none(self, env: Any) -> None:
        """Return ``None``: there are no logged infos, no state beside the observations, and no mask of actions."""

    info_spec = state_spec = action_mask_spec = _none

    @staticmethod
    def env_name() -> str:
        return "ptne"


def make_policy(experiment: Experiment) -> NetworkPolicy:
    """Return the actor without exploration, at every call as trained by then, as a policy for ``evaluate``.

    The players must share one network that decides each of them alone (an MLP), as BenchMARL's defaults have it.
    """
    layout = experiment.test_env.layout

    def decide(rows: Float32Array, memory: Any, *_: Any) -> tuple[Any, Any]:
        observations = torch.from_numpy(rows)[:, None].expand(-1, layout.num_players, -1)  # of all players the same
        group = TensorDict({"observation": observations}, observations.shape[:2])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            actions = experiment.policy(TensorDict({GROUP: group}, observations.shape[:1]))[GROUP, "action"]
        return actions[:, 0].numpy(), memory

    made_for = {name: getattr(layout, name) for name in ("interface", "action_dims", "slots", "size")}
    return NetworkPolicy(decide, made_for, experiment.algorithm_name)
