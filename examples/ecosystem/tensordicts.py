"""Shared by the examples for TorchRL and BenchMARL: the law in an environment of tensordicts."""

import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase
from yardstick import EPISODES, law

OBSERVATION, ACTION = ("player", "observation"), ("player", "action")


def law_digits(env: EnvBase) -> list[float]:
    """Return the law's digits; ``reset(seed=k)`` starts episode k, and k + b in environment b of a batch."""
    policy = law(env.layout)

    def act(observations: torch.Tensor) -> torch.Tensor:
        actions, _ = policy.predict(observations.flatten(0, -2).numpy())
        return torch.from_numpy(actions).unflatten(0, observations.shape[:-1])

    gained: list[float] = []
    for seed in range(0, EPISODES, env.numel()):
        start = env.reset(seed=seed)
        episode = env.rollout(
            10_000, TensorDictModule(act, [OBSERVATION], [ACTION]), auto_reset=False, tensordict=start
        )
        rewards = episode["next", "player", "reward"].double()  # (steps, players, 1), or (environments, steps, ...)
        gained += rewards.sum(dim=-3).mean(dim=(-2, -1)).reshape(-1).tolist()
    return gained
