"""Watch a training in Weights & Biases, through its callback for Stable-Baselines3.

``rollout/ep_rew_mean`` is the mean number of digits that players gain in an episode. The run is stored on this machine
until ``wandb sync`` uploads it; without ``mode="offline"`` it is uploaded at once.

Needs ``pip install tensorboard wandb``.

Run it with: python examples/log_to_wandb.py
"""

import wandb
from stable_baselines3 import PPO
from wandb.integration.sb3 import WandbCallback

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.training import defaults

with wandb.init(project="ptne", mode="offline", sync_tensorboard=True) as run:
    env = PlayerVecEnv("random-energy", num_envs=32, seed=0)
    model = PPO("MlpPolicy", env, tensorboard_log="runs", seed=0, **defaults.PPO)
    model.learn(150_000, callback=WandbCallback(), log_interval=1)
    print(f"written: {run.dir}")
