"""Watch a training in TensorBoard, for which Stable-Baselines3 writes what its callbacks and environments report.

``rollout/ep_rew_mean`` is the mean number of digits that players gain in an episode.
Needs ``pip install tensorboard``.

Run it with: python examples/log_to_tensorboard.py, and then: tensorboard --logdir runs
"""

from stable_baselines3 import PPO

from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.training import defaults

env = PlayerVecEnv("random-energy", num_envs=32, seed=0)
model = PPO("MlpPolicy", env, tensorboard_log="runs", seed=0, **defaults.PPO)
model.learn(150_000, log_interval=1)
print(f"written: {model.logger.dir}")
