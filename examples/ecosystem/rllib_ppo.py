"""Ray RLlib: PPO with one policy for all players, through its multi-agent runner and through its single-agent runner.

RLlib's multi-agent runner steps one environment at a time. Its single-agent runner takes a vector of Gymnasium, whose
members are here the players of all environments, so one policy acts for all.

Run it with: python examples/ecosystem/rllib_ppo.py
"""

import logging

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.rllib.utils.pre_checks.env import check_multiagent_environments
from ray.tune.registry import register_env
from yardstick import EPISODES, LAW, SCENARIO, digits, law, policy_of, report

import ptne_env
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.perception.policy import Policy

PLAYERS = [f"player_{index}" for index in range(5)]


class PlayerVectorEnv(gymnasium.vector.VectorEnv):
    """A vector of B·N members, the players of B environments, which start again in the step after their end."""

    def __init__(self, num_envs: int, **arguments: str) -> None:
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.vector = VectorParallelEnv(SCENARIO, num_envs, **arguments)
        self.num_envs = num_envs * self.vector.num_players
        self.single_observation_space = self.vector.single_observation_space
        self.single_action_space = self.vector.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.over = np.zeros(num_envs, dtype=np.bool_)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:  # noqa: ARG002
        """Start all episodes; environment b gets seed + b."""
        self.over[:] = False
        return self.vector.reset(seed)[0].reshape(self.num_envs, -1), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Step all environments, and start those again that ended in the step before."""
        players = self.vector.num_players
        outcome = self.vector.step(np.reshape(actions, (-1, players, actions.shape[-1])), self.over)
        self.over = outcome.terminated | outcome.truncated
        ends = outcome.terminated.repeat(players), outcome.truncated.repeat(players)
        return outcome.observations.reshape(self.num_envs, -1), outcome.rewards.reshape(-1), *ends, {}


def make_env(arguments: dict) -> ParallelPettingZooEnv:
    """Return the environment of RLlib's runners; their processes import ``ptne_env`` through it."""
    return ParallelPettingZooEnv(ptne_env.parallel_env(SCENARIO, **arguments))


def make_players(arguments: dict) -> PlayerVectorEnv:
    """Return the members of RLlib's single-agent runner, of which it counts ``num_envs``: every player is one."""
    others = {name: value for name, value in arguments.items() if name != "num_envs"}
    return PlayerVectorEnv(arguments["num_envs"] // len(PLAYERS), **others)


def law_digits_of_players() -> list[float]:
    """Return the digits that the law gains where all players of all episodes are members of one vector."""
    env = PlayerVectorEnv(EPISODES, **LAW)
    policy = law(env.vector.layout)
    observations, _ = env.reset(seed=0)
    total, over = np.zeros(env.num_envs), np.zeros(env.num_envs, dtype=bool)
    while not over.all():
        observations, rewards, terminated, truncated, _ = env.step(policy.predict(observations)[0])
        total += rewards
        over = terminated | truncated
    return total.reshape(EPISODES, -1).mean(axis=1).tolist()


def law_digits() -> list[float]:
    """Return the digits that the law gains through the wrapper, whose dictionaries also have the key ``__all__``."""
    env = make_env(LAW)
    policy = law(env.par_env.layout)
    gained = []
    for seed in range(EPISODES):
        observations, _ = env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            actions, _ = policy.predict(np.stack([observations[player] for player in PLAYERS]))
            observations, rewards, terminated, truncated, _ = env.step(dict(zip(PLAYERS, actions, strict=True)))
            total += np.mean([rewards[player] for player in PLAYERS])
            over = terminated["__all__"] or truncated["__all__"]
        gained.append(total)
    return gained


class Network(DefaultPPOTorchRLModule):
    """RLlib's own, with less initial noise: with a standard deviation of 1 the mean would adapt to the noise."""

    def setup(self) -> None:
        """Lower the logarithm of the standard deviation from 0 to −1."""
        super().setup()
        torch.nn.init.constant_(self.pi.log_std, -1.0)


MODEL = DefaultModelConfig(fcnet_hiddens=[64, 64], vf_share_layers=False, free_log_std=True)
SPEC = RLModuleSpec(module_class=Network, model_config=MODEL)


def settings(env: str, frames: int) -> PPOConfig:
    """PPO that trains on a number of frames at a time."""
    return (
        PPOConfig()
        .environment(env)
        .env_runners(num_env_runners=0)
        .learners(num_learners=0)
        .training(
            train_batch_size_per_learner=frames, minibatch_size=500, num_epochs=5, lr=1e-3, gamma=0.9, lambda_=0.9
        )
        .debugging(seed=0, log_level="ERROR")
    )


def one_at_a_time() -> Algorithm:
    """One policy for all, ``shared``; a frame has five players."""
    return (
        settings("ptne", 800)
        .multi_agent(policies=["shared"], policy_mapping_fn=lambda *_, **__: "shared")
        .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs={"shared": SPEC}))
        .build_algo()
    )


def stepped_together(num_envs: int) -> Algorithm:
    """One policy for all; a frame has one player."""
    mode = gymnasium.VectorizeMode.VECTOR_ENTRY_POINT
    return (
        settings("ptne-players", 800 * len(PLAYERS))
        .env_runners(num_envs_per_env_runner=num_envs * len(PLAYERS), gym_env_vectorize_mode=mode)
        .rl_module(rl_module_spec=SPEC)
        .build_algo()
    )


def acting(algorithm: Algorithm) -> Policy:
    """Return the means of the policy's actions."""
    size = ptne_env.parallel_env(SCENARIO).layout.action_size
    module = algorithm.get_module("shared" if algorithm.config.is_multi_agent else DEFAULT_MODULE_ID)

    @torch.no_grad()
    def act(observations: np.ndarray) -> np.ndarray:
        outputs = module.forward_inference({Columns.OBS: torch.from_numpy(observations)})
        return outputs[Columns.ACTION_DIST_INPUTS][:, :size].numpy()  # means first, then log deviations

    return policy_of(act)


def main() -> None:
    """Run RLlib's own check, and print the law's digits and those of a short training, by each of the two runners."""
    logging.getLogger("ray").setLevel(logging.ERROR)
    check_multiagent_environments(make_env({}))
    register_env("ptne", make_env)
    register_env("ptne-players", make_players)
    for what, algorithm, gained in (
        ("one at a time", one_at_a_time(), law_digits()),
        ("stepped together", stepped_together(8), law_digits_of_players()),
    ):
        before = digits(acting(algorithm))
        for _ in range(8):
            algorithm.train()
        report(gained, before, digits(acting(algorithm)), what)
        algorithm.stop()


if __name__ == "__main__":
    main()
