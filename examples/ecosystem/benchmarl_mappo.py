"""BenchMARL: a task class for any scenario, and MAPPO on it.

Run it with: python examples/ecosystem/benchmarl_mappo.py
"""

from collections.abc import Callable
from tempfile import TemporaryDirectory

import numpy as np
import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments import PettingZooClass, Task
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase, PettingZooWrapper, check_env_specs
from torchrl.envs.utils import ExplorationType, set_exploration_type
from yardstick import EPISODES, SCENARIO, TASK, Acting, digits, law, report

import ptne_env

OBSERVATION, ACTION = ("player", "observation"), ("player", "action")


class NashSeekingTask(PettingZooClass):
    """The adapter by which BenchMARL builds and reads our environments.

    The configuration holds the arguments of ``ptne_env.parallel_env``.
    """

    def get_env_fun(
        self,
        num_envs: int,  # noqa: ARG002 - BenchMARL itself puts several environments in series
        continuous_actions: bool,  # noqa: ARG002, FBT001 - all actions are continuous
        seed: int | None,
        device: str,
    ) -> Callable[[], EnvBase]:
        """A function that makes one environment."""
        return lambda: PettingZooWrapper(
            ptne_env.parallel_env(**self.config), return_state=self.has_state(), seed=seed, device=device
        )

    def supports_continuous_actions(self) -> bool:
        """Always."""
        return True

    def has_state(self) -> bool:
        """Whether MAPPO's critic receives the global state; otherwise it receives all observations."""
        return False

    def has_render(self, env: EnvBase) -> bool:  # noqa: ARG002
        """Only with a render mode."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """The number of steps of an episode, with the hold phase."""
        return env.world.clock.total_steps

    @staticmethod
    def env_name() -> str:
        """The name of the family of tasks."""
        return "ptne"


class NashSeeking(Task):
    """The tasks, which differ in their configuration."""

    RANDOM_ENERGY = None

    @staticmethod
    def associated_class() -> type[NashSeekingTask]:
        """The class of every task."""
        return NashSeekingTask


def law_digits() -> list[float]:
    """The digits that the law gains in the task's environment."""
    env = NashSeeking.RANDOM_ENERGY.get_task({"scenario": SCENARIO}).get_env_fun(1, True, None, "cpu")()  # noqa: FBT003
    policy = law(env.layout)
    act = TensorDictModule(lambda o: torch.from_numpy(policy.predict(o.numpy())[0]), [OBSERVATION], [ACTION])
    gained = []
    for seed in range(EPISODES):
        episode = env.rollout(10_000, act, auto_reset=False, tensordict=env.reset(seed=seed))
        gained.append(episode["next", "player", "reward"].double().sum(dim=0).mean().item())
    return gained


def acting(experiment: Experiment) -> Acting:
    """The trained policy without its sampling; it takes the observations of all players together."""

    def act(observations: np.ndarray) -> np.ndarray:
        together = torch.from_numpy(observations).unflatten(0, (-1, 5))
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            batch = TensorDict(
                {"player": TensorDict({"observation": together}, together.shape[:2])}, together.shape[:1]
            )
            return experiment.policy(batch)[ACTION].flatten(0, 1).numpy()

    return Acting(act)


def main() -> None:
    """TorchRL's check of the task, the law's digits, and a short training."""
    task = NashSeeking.RANDOM_ENERGY.get_task({"scenario": SCENARIO, **TASK})
    check_env_specs(task.get_env_fun(1, True, 0, "cpu")())  # noqa: FBT003
    config = ExperimentConfig.get_from_yaml()
    config.gamma, config.lr = 0.9, 1e-3
    config.on_policy_n_envs_per_worker = 2
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
        report(law_digits(), before, digits(acting(experiment)))


if __name__ == "__main__":
    main()
