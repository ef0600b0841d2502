"""BenchMARL: MAPPO on a task whose environments are stepped together.

Run it with: python examples/ecosystem/benchmarl_mappo.py
"""

from tempfile import TemporaryDirectory

import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordicts import law_digits
from torchrl.envs import EnvBase, check_env_specs
from yardstick import EPISODES, LAW, SCENARIO, digits, report

from ptne_env.envs.benchmarl import NashSeekingTask, make_policy


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
