"""BenchMARL: MAPPO on ``NashSeekingTask``, whose environments are stepped together, and on a task with one at a time.

Run it with: python examples/ecosystem/benchmarl_mappo.py
"""

from collections.abc import Callable
from tempfile import TemporaryDirectory

import numpy as np
import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict
from tensordicts import ACTION, law_digits
from torchrl.envs import EnvBase, PettingZooWrapper, check_env_specs
from torchrl.envs.utils import ExplorationType, set_exploration_type
from yardstick import EPISODES, LAW, SCENARIO, Acting, digits, report

import ptne_env
from ptne_env.envs.benchmarl import NashSeekingTask


class OneAtATime(NashSeekingTask):
    """The same task through TorchRL's wrapper of PettingZoo; BenchMARL puts such environments in series."""

    def get_env_fun(
        self,
        num_envs: int,  # noqa: ARG002
        continuous_actions: bool,  # noqa: ARG002, FBT001
        seed: int | None,
        device: str,
    ) -> Callable[[], EnvBase]:
        """A function that makes one environment."""
        return lambda: PettingZooWrapper(ptne_env.parallel_env(self.name, **self.config), seed=seed, device=device)

    def max_steps(self, env: EnvBase) -> int:
        """The number of steps of an episode, with the hold phase."""
        return env.world.clock.total_steps


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
    """The environment, or the first of those that BenchMARL would put in series."""
    return task.get_env_fun(num_envs, True, 0, "cpu")()  # noqa: FBT003


def main() -> None:
    """TorchRL's check, the law's digits and a short training, of each of the two tasks."""
    for task, num_envs, what in ((OneAtATime, 2, "one at a time"), (NashSeekingTask, 8, "stepped together")):
        report(law_digits(make(task(SCENARIO, LAW), EPISODES)), *train(task(SCENARIO), num_envs), what)


if __name__ == "__main__":
    main()
