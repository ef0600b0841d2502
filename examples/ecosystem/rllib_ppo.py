"""Ray RLlib: PPO with one policy for all players, and with one policy per player.

Run it with: python examples/ecosystem/rllib_ppo.py
"""

import logging

import numpy as np
import torch
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.rllib.utils.pre_checks.env import check_multiagent_environments
from ray.tune.registry import register_env
from yardstick import EPISODES, SCENARIO, TASK, Acting, digits, law, report

import ptne_env

PLAYERS = [f"player_{index}" for index in range(5)]


def make_env(arguments: dict) -> ParallelPettingZooEnv:
    """The environment of RLlib's runners; their processes import ``ptne_env`` through it."""
    return ParallelPettingZooEnv(ptne_env.parallel_env(SCENARIO, **arguments))


def law_digits() -> list[float]:
    """The digits that the law gains through the wrapper, whose dictionaries have an additional entry ``__all__``."""
    env = make_env({})
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


def build(policies: list[str]) -> Algorithm:
    """PPO with one policy per player, named like the player, or with one policy for all, ``shared``."""
    model = DefaultModelConfig(fcnet_hiddens=[64, 64], vf_share_layers=False, free_log_std=True)
    specs = {policy: RLModuleSpec(module_class=Network, model_config=model) for policy in policies}
    return (
        PPOConfig()
        .environment("ptne", env_config=TASK)
        .env_runners(num_env_runners=0)
        .learners(num_learners=0)
        .multi_agent(
            policies=policies,
            policy_mapping_fn=lambda agent, *_, **__: agent if agent in policies else "shared",
        )
        .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs=specs))
        .training(train_batch_size_per_learner=800, minibatch_size=500, num_epochs=5, lr=1e-3, gamma=0.9, lambda_=0.9)
        .debugging(seed=0, log_level="ERROR")
        .build_algo()
    )


def acting(algorithm: Algorithm) -> Acting:
    """The means of the policies' actions; the one-hot in the observation selects the player."""
    layout = ptne_env.parallel_env(SCENARIO, **TASK).layout
    modules = [algorithm.get_module(player) or algorithm.get_module("shared") for player in PLAYERS]

    def act(observations: np.ndarray) -> np.ndarray:
        players = layout.select(observations, "player").argmax(axis=1)
        actions = np.empty((len(observations), layout.action_size), dtype=np.float32)
        for index, module in enumerate(modules):
            own = torch.from_numpy(observations[players == index])
            with torch.no_grad():
                output = module.forward_inference({Columns.OBS: own})[Columns.ACTION_DIST_INPUTS]
            actions[players == index] = output[:, : layout.action_size].numpy()  # means first, then log deviations
        return actions

    return Acting(act)


def main() -> None:
    """RLlib's own check, the law's digits, and two short trainings."""
    logging.getLogger("ray").setLevel(logging.ERROR)
    check_multiagent_environments(make_env(TASK))
    register_env("ptne", make_env)
    gained = law_digits()
    for what, policies in {"one policy for all": ["shared"], "one policy per player": PLAYERS}.items():
        algorithm = build(policies)
        before = digits(acting(algorithm))
        for _ in range(8):
            algorithm.train()
        report(gained, before, digits(acting(algorithm)), what)
        algorithm.stop()


if __name__ == "__main__":
    main()
