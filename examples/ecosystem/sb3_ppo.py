"""Stable-Baselines3: PPO with one network for the players of all environments.

Run it with: python examples/ecosystem/sb3_ppo.py
"""

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from yardstick import EPISODES, LAW, SCENARIO, digits, law, report

from ptne_env.envs.gymnasium import JointEnv
from ptne_env.envs.sb3 import PlayerVecEnv


def main() -> None:
    """Stable-Baselines3's own check, the law's digits by its own evaluation, and a short training."""
    check_env(JointEnv(SCENARIO))
    evaluation_env = PlayerVecEnv(SCENARIO, EPISODES, seed=0, **LAW)
    returns, _ = evaluate_policy(
        law(evaluation_env.layout),
        evaluation_env,
        n_eval_episodes=evaluation_env.num_envs,
        return_episode_rewards=True,
        warn=False,
    )
    gained = np.reshape(returns, (EPISODES, evaluation_env.layout.num_players)).mean(axis=1)

    env = PlayerVecEnv(SCENARIO, num_envs=16, seed=0)
    model = PPO(
        "MlpPolicy", env, n_steps=50, batch_size=500, n_epochs=5, learning_rate=1e-3, gamma=0.9, gae_lambda=0.9,
        policy_kwargs={"log_std_init": -1.0}, seed=0, device="cpu",
    )  # fmt: skip
    before = digits(model)
    model.learn(20_000)
    report(gained, before, digits(model))


if __name__ == "__main__":
    main()
