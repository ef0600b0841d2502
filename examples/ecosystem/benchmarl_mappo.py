"""BenchMARL: MAPPO on a task whose environments are stepped together, and its trained actors as policies.

The task and ``make_policy`` may be copied as they are. BenchMARL pins an older TorchRL, so it needs a virtual
environment of its own: pip install -r examples/ecosystem/requirements/benchmarl.txt

Run it with: python examples/ecosystem/benchmarl_mappo.py
"""

from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments import TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict
from tensordicts import law_digits
from torchrl.envs import EnvBase, check_env_specs
from torchrl.envs.utils import ExplorationType, set_exploration_type
from yardstick import EPISODES, LAW, SCENARIO, digits, report

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


def train(task: NashSeekingTask, num_envs: int) -> tuple[float, float]:
    """Return the digits before and after a short training."""
    check_env_specs(make(task, 2))
    config = ExperimentConfig.get_from_yaml()
    config.gamma, config.lr = 0.9, 1e-3
    config.on_policy_n_envs_per_worker = num_envs
    config.on_policy_collected_frames_per_batch = 800
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 5, 100
    config.max_n_frames = 6400
    config.evaluation, config.loggers, config.create_json = False, [], False
    algorithm = MappoConfig.get_from_yaml()
    algorithm.scale_mapping = "biased_softplus_0.4"
    model = MlpConfig(num_cells=[64, 64], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)
    with TemporaryDirectory() as folder:
        config.save_folder = folder
        experiment = Experiment(task, algorithm, model, seed=0, config=config)
        before = digits(make_policy(experiment))
        experiment.run()
        return before, digits(make_policy(experiment))


def make(task: NashSeekingTask, num_envs: int) -> EnvBase:
    """Return the batched environment of a task."""
    return task.get_env_fun(num_envs, True, 0, "cpu")()  # noqa: FBT003


def main() -> None:
    """Run TorchRL's check, and print the law's digits and those of a short training."""
    task = {"scenario": SCENARIO}
    gained = law_digits(make(NashSeekingTask("law", task | LAW), EPISODES))
    report(gained, *train(NashSeekingTask("mappo", task), 8))


if __name__ == "__main__":
    main()
