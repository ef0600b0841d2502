"""BenchMARL: MAPPO on a task whose environments are stepped together.

Run it with: python examples/ecosystem/benchmarl_mappo.py
"""

from collections.abc import Callable
from functools import partial
from tempfile import TemporaryDirectory

import numpy as np
import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments import TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict
from tensordicts import ACTION, law_digits
from torchrl.data import Composite
from torchrl.envs import EnvBase, check_env_specs
from torchrl.envs.utils import ExplorationType, set_exploration_type
from yardstick import EPISODES, LAW, SCENARIO, Acting, digits, report

from ptne_env.learn.torchrl import TorchRLEnv
from ptne_env.world.world import World


class NashSeekingTask(TaskClass):
    """A scenario as a task of BenchMARL, whose environments are stepped together.

    The name is that of a scenario, and the configuration holds the arguments of ``TorchRLEnv``.
    """

    def get_env_fun(
        self,
        num_envs: int,
        continuous_actions: bool,  # noqa: ARG002, FBT001
        seed: int | None,
        device: str,  # noqa: ARG002
    ) -> Callable[[], EnvBase]:
        """A function that makes one batched environment, which stays on the CPU."""
        return partial(TorchRLEnv, self.name, num_envs, seed=seed, **self.config)

    def supports_continuous_actions(self) -> bool:
        """Always."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Never."""
        return False

    def has_render(self, env: EnvBase) -> bool:  # noqa: ARG002
        """Never, because batches are not drawn."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """The number of steps of an episode, with the hold phase."""
        return World(env.vector.scenario).clock.total_steps

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """All players in one group."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Of one environment, without the infos: BenchMARL's networks read every entry."""
        spec = env.full_observation_spec_unbatched.clone()
        del spec["player", "info"]
        return spec

    def action_spec(self, env: EnvBase) -> Composite:
        """Of one environment."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """Not given: BenchMARL logs no entries of infos."""

    def state_spec(self, env: EnvBase) -> None:
        """Not given: a centralised critic receives the observations of all players."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """Not given: all actions are allowed."""

    @staticmethod
    def env_name() -> str:
        """The name of the family of tasks."""
        return "ptne"


def acting(experiment: Experiment) -> Acting:
    """The trained policy without its sampling, which decides every row from that row alone.

    It takes the observations of all players together, so each row takes the places of them all.
    """

    def act(observations: np.ndarray) -> np.ndarray:
        together = torch.from_numpy(observations)[:, None].expand(-1, 5, -1)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            batch = TensorDict(
                {"player": TensorDict({"observation": together}, together.shape[:2])}, together.shape[:1]
            )
            return experiment.policy(batch)[ACTION][:, 0].numpy()

    return Acting(act)


def train(task: NashSeekingTask, num_envs: int) -> tuple[float, float]:
    """Digits before and after a short training."""
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
        before = digits(acting(experiment))
        experiment.run()
        return before, digits(acting(experiment))


def make(task: NashSeekingTask, num_envs: int) -> EnvBase:
    """The batched environment of a task."""
    return task.get_env_fun(num_envs, True, 0, "cpu")()  # noqa: FBT003


def main() -> None:
    """TorchRL's check, the law's digits and a short training."""
    report(law_digits(make(NashSeekingTask(SCENARIO, LAW), EPISODES)), *train(NashSeekingTask(SCENARIO, {}), 8))


if __name__ == "__main__":
    main()
