"""Train PPO of Stable-Baselines3 for some seconds, and see where it stands beside the law.

Every player of every environment is a slot of one vector environment, and all slots share one network. It sees the
scale-free interface ``local``, in which an action is relative to how far the player is from rest. ``ptne train`` does
the same for minutes, with checkpoints, and exports a file that runs without PyTorch.

Prints the digits gained over an episode's start, as Stable-Baselines3's own evaluation counts them on 20 games that
were not trained on: of the network before and after training, and of the paper's static law.

Run it with: python examples/train_sb3.py
"""

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

import ptne_env
from ptne_env import laws
from ptne_env.envs.sb3 import SlotVecEnv
from ptne_env.training.features import Products

SCENARIO = "random-energy"
TEST_SEED = 1_000_000


def digits_gained(policy: ptne_env.Policy) -> float:
    """The mean return over all players; a law is evaluated like any model."""
    env = SlotVecEnv(SCENARIO, num_envs=20, interface="local", seed=TEST_SEED)
    mean, _ = evaluate_policy(policy, env, n_eval_episodes=env.num_envs, warn=False)
    return float(mean)


def main() -> None:
    """Train, and evaluate before and after."""
    torch.set_num_threads(1)  # the network is small: a second thread costs more than it brings
    env = SlotVecEnv(SCENARIO, num_envs=64, interface="local", seed=0)
    network = {
        "log_std_init": -2.0,
        "features_extractor_class": Products,
        "features_extractor_kwargs": Products.of(env.layout),
    }
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=50,
        batch_size=2000,
        n_epochs=5,
        gamma=0.9,
        learning_rate=1e-3,
        policy_kwargs=network,
        seed=0,
        device="cpu",
    )
    before = digits_gained(model)
    model.learn(200_000)
    after = digits_gained(model)
    print(f"PPO gains {before:.2f} digits before training and {after:.2f} after {model.num_timesteps} agent-steps")
    print(f"the law gains {digits_gained(laws.Static(env.layout, kappa=2.0)):.2f}")


if __name__ == "__main__":
    main()
