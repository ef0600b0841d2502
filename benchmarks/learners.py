"""The digits that PPO, SAC and TD3 of Stable-Baselines3 gain, by interface and settings.

Run ``python -m benchmarks.learners`` with the extra ``[sb3]`` for the table of docs/learning.md. Each row is a training
on ``random-energy``, and the digits that its policy, without exploration, gains in 20 games outside of the training.
"""

from __future__ import annotations

from time import process_time
from typing import Annotated, NamedTuple

import torch
import typer
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.evaluation import evaluate_policy

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn.training import defaults
from ptne_env.perception.observation import InterfaceKind

_ALGORITHMS = {"PPO": PPO, "SAC": SAC, "TD3": TD3}
_TEST_SEED = 1_000_000
_GAMES = 20


class Training(NamedTuple):
    """A row of the table: the name of an algorithm, the interface, environments and agent-steps of training."""

    algorithm: str
    interface: InterfaceKind
    has_defaults: bool
    num_envs: int
    steps: int

    def digits(self, seed: int) -> tuple[float, float]:
        """Train; the digits gained on games outside of the training, and the processor seconds of training."""
        settings = dict(getattr(defaults, self.algorithm)) if self.has_defaults else {"device": "cpu"}
        env = PlayerVecEnv("random-energy", self.num_envs, interface=self.interface, seed=seed)
        began = process_time()
        model = _ALGORITHMS[self.algorithm]("MlpPolicy", env, seed=seed, **settings).learn(self.steps)
        seconds = process_time() - began
        games = PlayerVecEnv("random-energy", _GAMES, interface=self.interface, seed=_TEST_SEED)
        mean, _ = evaluate_policy(model, games, n_eval_episodes=games.num_envs, warn=False)
        return float(mean), seconds


TRAININGS = (
    Training("PPO", "physical", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "local", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "learner", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "learner", has_defaults=True, num_envs=32, steps=150_000),
    Training("SAC", "learner", has_defaults=True, num_envs=16, steps=40_000),
    Training("TD3", "learner", has_defaults=True, num_envs=16, steps=60_000),
)


def main(
    seeds: Annotated[int, typer.Option(min=1)] = 1,
    rows: Annotated[str, typer.Option(help="Numbers of the rows, by commas; all if left out.")] = "",
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps of every row.")] = None,
) -> None:
    """Print the table, one row as soon as it is measured."""
    torch.set_num_threads(1)
    chosen = [int(row) for row in rows.split(",")] if rows else range(len(TRAININGS))
    print("| Algorithm | Interface | Settings | Environments | Agent-steps | Digits gained | CPU seconds |")
    print("| --- | --- | --- | ---: | ---: | --- | ---: |")
    for row in chosen:
        training = TRAININGS[row] if steps is None else TRAININGS[row]._replace(steps=steps)
        found = [training.digits(seed) for seed in range(seeds)]
        settings = f"`defaults.{training.algorithm}`" if training.has_defaults else "none"
        gained = " ".join(f"{digits:.1f}" for digits, _ in found)
        seconds = sum(each for _, each in found) / len(found)
        print(
            f"| {training.algorithm} | `{training.interface}` | {settings} | {training.num_envs} | "
            f"{training.steps:,} | {gained} | {seconds:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    typer.run(main)
