"""What PPO, SAC and TD3 of Stable-Baselines3 learn, by interface, reward and settings, as a table in Markdown.

Run ``python -m benchmarks.learners`` with the extra ``[sb3]``; it takes some minutes. Each row is a training on
``random-energy``, and what its policy, without exploration, reaches in 20 games outside of the training: the digits
that it gains, and the median of the mean regret.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO, SAC, TD3

from ptne_env import PolicySpec, evaluate
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.perception.fields import InterfaceKind
from ptne_env.training import defaults

_ALGORITHMS = {"PPO": PPO, "SAC": SAC, "TD3": TD3}


class Training(NamedTuple):
    """A row of the table: the name of an algorithm, the interface, environments, agent-steps and reward of training."""

    algorithm: str
    interface: InterfaceKind
    has_defaults: bool
    num_envs: int
    steps: int
    reward: str | Mapping[str, float] = "digits"

    def measure(self, seed: int = 0) -> tuple[float, float]:
        """Train; the digits gained, and the mean regret, in games outside of the training."""
        torch.set_num_threads(1)
        settings = dict(getattr(defaults, self.algorithm)) if self.has_defaults else {"device": "cpu"}
        env = PlayerVecEnv("random-energy", self.num_envs, interface=self.interface, reward=self.reward, seed=seed)
        model = _ALGORITHMS[self.algorithm]("MlpPolicy", env, seed=seed, **settings).learn(self.steps)
        results = evaluate(PolicySpec("model", model, self.interface), "random-energy", episodes=20, split="validation")
        samples = results.samples["random-energy", "model"]
        return float(np.mean(samples["digits_gained"])), float(np.median(samples["mean_regret"]))


TRAININGS = (
    Training("PPO", "physical", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "scaled", has_defaults=False, num_envs=1, steps=100_000),
    Training("PPO", "scaled", has_defaults=True, num_envs=32, steps=150_000),
    *(
        Training("PPO", "scaled", has_defaults=True, num_envs=32, steps=150_000, reward=reward)
        for reward in ({"digits": 1.0, "regret": 0.001}, {"digits": 1.0, "regret": 0.1}, "regret", "tracking", "payoff")
    ),
    Training("SAC", "scaled", has_defaults=True, num_envs=16, steps=40_000),
    Training("TD3", "scaled", has_defaults=True, num_envs=16, steps=60_000),
)


def table() -> list[str]:
    """The lines of the table."""
    lines = [
        "| Algorithm | Interface | Settings | Reward | Environments | Agent-steps | Digits gained | Mean regret |",
        "| --- | --- | --- | --- | ---: | ---: | ---: | ---: |",
    ]
    for row in TRAININGS:
        settings = f"`defaults.{row.algorithm}`" if row.has_defaults else "none"
        digits, regret = row.measure()
        cells = (row.algorithm, f"`{row.interface}`", settings, f"`{row.reward}`", row.num_envs, f"{row.steps:,}")
        lines.append(f"| {' | '.join(map(str, cells))} | {digits:.1f} | {regret:.3f} |")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
