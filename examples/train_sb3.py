"""Train PPO of Stable-Baselines3 for some seconds, and compare it with the paper's law.

Every player of every environment becomes one environment of a vector environment, and all of them share one network. It
acts through the interface ``scaled``, in which gradients, differences and actions have no unit.
``ptne train`` trains for minutes, with checkpoints, and exports a file that runs without PyTorch.

Prints the digits gained in an episode, by Stable-Baselines3's own evaluation on 20 games outside of the training: those
of the network before and after training, and those of the paper's static law.

Run it with: python examples/train_sb3.py
"""

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

import ptne_env
from ptne_env import laws
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.training import defaults

SCENARIO = "random-energy"
TEST_SEED = 1_000_000


def digits_gained(policy: ptne_env.Policy) -> float:
    """Return the mean return over all players; a law is evaluated like any model."""
    env = PlayerVecEnv(SCENARIO, num_envs=20, seed=TEST_SEED)
    mean, _ = evaluate_policy(policy, env, n_eval_episodes=env.num_envs, warn=False)
    return float(mean)


def main() -> None:
    """Train, and evaluate before and after."""
    torch.set_num_threads(1)  # the network is small, and a second thread makes it slower
    env = PlayerVecEnv(SCENARIO, num_envs=32, seed=0)
    model = PPO("MlpPolicy", env, seed=0, **defaults.PPO)
    before = digits_gained(model)
    model.learn(150_000)
    after = digits_gained(model)
    print(f"PPO gains {before:.2f} digits before training and {after:.2f} after {model.num_timesteps} agent-steps")
    print(f"the law gains {digits_gained(laws.Static(env.layout, kappa=2.0)):.2f}")


if __name__ == "__main__":
    main()
