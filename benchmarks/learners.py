"""The digits that PPO, SAC and TD3 of Stable-Baselines3 gain, by interface and settings, as a table in Markdown.

Run ``python -m benchmarks.learners`` with the extra ``[sb3]``; it takes some minutes. Each row is a training on
``random-energy``, and the digits that its policy, without exploration, gains in 20 games outside of the training.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.evaluation import evaluate_policy

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.perception.fields import InterfaceKind
from ptne_env.training import defaults

_ALGORITHMS = {"PPO": PPO, "SAC": SAC, "TD3": TD3}


class Training(NamedTuple):
    """A row of the table: the name of an algorithm, the interface, environments and agent-steps of training."""

    algorithm: str
    interface: InterfaceKind
    has_defaults: bool
    num_envs: int
    steps: int

    def digits(self, seed: int = 0) -> float:
        """Train; the digits gained in games outside of the training."""
        torch.set_num_threads(1)
        settings = dict(getattr(defaults, self.algorithm)) if self.has_defaults else {"device": "cpu"}
        env = PlayerVecEnv("random-energy", self.num_envs, interface=self.interface, seed=seed)
        model = _ALGORITHMS[self.algorithm]("MlpPolicy", env, seed=seed, **settings).learn(self.steps)
        games = PlayerVecEnv("random-energy", 20, interface=self.interface, seed=1_000_000)
        gained, _ = evaluate_policy(model, games, n_eval_episodes=games.num_envs, warn=False)
        return float(np.mean(gained))


TRAININGS = (
    Training("PPO", "physical", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "scaled", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "scaled", has_defaults=True, num_envs=32, steps=150_000),
    Training("SAC", "scaled", has_defaults=True, num_envs=16, steps=40_000),
    Training("TD3", "scaled", has_defaults=True, num_envs=16, steps=60_000),
)


def table() -> list[str]:
    """The lines of the table."""
    lines = [
        "| Algorithm | Interface | Settings | Environments | Agent-steps | Digits gained |",
        "| --- | --- | --- | ---: | ---: | ---: |",
    ]
    for row in TRAININGS:
        settings = f"`defaults.{row.algorithm}`" if row.has_defaults else "none"
        cells = (row.algorithm, f"`{row.interface}`", settings, row.num_envs, f"{row.steps:,}", f"{row.digits():.1f}")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
