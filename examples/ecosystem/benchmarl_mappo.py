"""BenchMARL: MAPPO on a task whose environments are stepped together, and its trained actors as policies.

The task and ``make_policy`` may be copied as they are. BenchMARL pins an older TorchRL, so it needs a virtual
environment of its own: pip install -r examples/ecosystem/requirements/benchmarl.txt

Run it with: python examples/ecosystem/benchmarl_mappo.py
or, as a witness of ``ptne train TRACK --steps STEPS``, whose settings it then has, with:
python examples/ecosystem/benchmarl_mappo.py TRACK STEPS ippo
"""

import math
import sys
from collections.abc import Callable
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

import torch
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.environments import TaskClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict
from tensordicts import law_digits
from torchrl.envs import EnvBase, check_env_specs
from torchrl.envs.utils import ExplorationType, set_exploration_type
from yardstick import EPISODES, LAW, SCENARIO, digits, report

from ptne_env.envs.torchrl import GROUP, TorchRLEnv
from ptne_env.perception.policy import NetworkPolicy, Policy
from ptne_env.shared.arrays import Float32Array
from ptne_env.training.configuration import Configuration
from ptne_env.world.catalogue import get_scenario
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


class FallingRate(Callback):
    """A learning rate that falls to 0, along a cosine."""

    def on_train_end(self, training_td: TensorDict, group: str) -> None:
        done = self.experiment.total_frames / self.experiment.config.max_n_frames
        rate = self.experiment.config.lr * (1 + math.cos(math.pi * min(done, 1))) / 2
        for optimizer in self.experiment.optimizers[group].values():
            for parameters in optimizer.param_groups:
                parameters["lr"] = rate


def train(
    task: NashSeekingTask, configuration: Configuration, algorithm: str, measure: Callable[[Policy], float]
) -> tuple[float, float]:
    """Return the digits before and after a training by ``"mappo"`` or ``"ippo"`` with the settings of ``ptne train``.

    A frame is a step of all players of an environment.
    """
    check_env_specs(make(task, 2))
    config = ExperimentConfig.get_from_yaml()
    players = World(get_scenario(configuration.scenario)).game.num_players
    environments = configuration.environments(players)
    frames = environments * configuration.rollout
    config.gamma, config.lr = configuration.discount, configuration.learning_rate
    config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = environments, frames
    config.on_policy_n_minibatch_iters = configuration.epochs
    config.on_policy_minibatch_size = frames // configuration.minibatches
    config.max_n_frames = configuration.steps // players
    config.clip_grad_val, config.adam_eps = 0.5, 1e-5
    config.evaluation, config.loggers, config.create_json = False, [], False
    learner = {"mappo": MappoConfig, "ippo": IppoConfig}[algorithm].get_from_yaml()
    learner.scale_mapping = f"biased_softplus_{math.exp(configuration.log_std):.2g}"
    # Actions near the limits have no finite probability density where a tangent squashes them.
    learner.use_tanh_normal, learner.minibatch_advantage, learner.critic_coef = False, True, 0.5
    model = MlpConfig(num_cells=configuration.hidden, layer_class=torch.nn.Linear, activation_class=torch.nn.ReLU)
    with TemporaryDirectory() as folder:
        config.save_folder = folder
        callbacks = [FallingRate()]
        experiment = Experiment(task, learner, model, seed=configuration.seed, config=config, callbacks=callbacks)
        before = measure(make_policy(experiment))
        experiment.run()
        return before, measure(make_policy(experiment))


def make(task: NashSeekingTask, num_envs: int) -> EnvBase:
    """Return the batched environment of a task."""
    return task.get_env_fun(num_envs, True, 0, "cpu")()  # noqa: FBT003


def main() -> None:
    """Run TorchRL's check, and print the law's digits and those of a short training."""
    task = {"scenario": SCENARIO}
    gained = law_digits(make(NashSeekingTask("law", task | LAW), EPISODES))
    short = Configuration(
        SCENARIO, steps=32_000, batch=4_000, rollout=100, minibatches=8, epochs=5, learning_rate=1e-3, discount=0.9
    )
    report(gained, *train(NashSeekingTask("mappo", task), short, "mappo", digits))


if __name__ == "__main__":
    if sys.argv[1:]:
        track, steps, algorithm = sys.argv[1:]
        measure = partial(digits, scenario=track, episodes=200)
        task = NashSeekingTask("witness", {"scenario": track})
        _, after = train(task, Configuration(track, steps=int(steps)), algorithm, measure)
        print(f"{after:.2f} validation digits")
    else:
        main()
