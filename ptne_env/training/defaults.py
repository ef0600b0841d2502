"""Settings with which algorithms of Stable-Baselines3 learn in ``PlayerVecEnv`` within seconds or minutes.

They are for the interface ``scaled``, the default of :class:`~ptne_env.envs.sb3.PlayerVecEnv`::

    env = PlayerVecEnv("random-energy", num_envs=32, seed=0)
    model = PPO("MlpPolicy", env, **defaults.PPO).learn(300_000)

The discount is low, because the effect of an input shows within a few steps, and later rewards are noise to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

_COMMON = {"gamma": 0.9, "learning_rate": 1e-3, "device": "cpu"}

PPO: Mapping[str, Any] = MappingProxyType(
    {**_COMMON, "n_steps": 50, "batch_size": 1000, "n_epochs": 5, "gae_lambda": 0.9}
)
"""For about 32 environments; with B environments of N players a rollout has 50·B·N samples."""

TD3: Mapping[str, Any] = MappingProxyType({**_COMMON, "learning_starts": 1000, "gradient_steps": 4})
"""For about 16 environments. Exploration is that of the first ``learning_starts`` agent-steps, which are random."""

SAC: Mapping[str, Any] = MappingProxyType({**TD3, "ent_coef": "auto_0.001"})
"""For about 16 environments. The reward of a step is of order 0.01, so a larger weight of the entropy would hide it."""
