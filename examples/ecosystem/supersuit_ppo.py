"""SuperSuit: its wrappers one by one, and its conversion to a vector on which Stable-Baselines3's PPO trains.

Run it with: python examples/ecosystem/supersuit_ppo.py
"""

from collections.abc import Callable

import numpy as np
import supersuit
from pettingzoo import ParallelEnv
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed
from yardstick import EPISODES, LAW, SCENARIO, digits, law, report

import ptne_env

WRAPPERS: dict[str, Callable[[ParallelEnv], ParallelEnv]] = {
    "clip_actions_v0": supersuit.clip_actions_v0,
    "clip_reward_v0": supersuit.clip_reward_v0,
    "delay_observations_v0": lambda env: supersuit.delay_observations_v0(env, 2),
    "dtype_v0": lambda env: supersuit.dtype_v0(env, np.float64),
    "flatten_v0": supersuit.flatten_v0,
    "frame_skip_v0": lambda env: supersuit.frame_skip_v0(env, 4),
    "frame_stack_v1": lambda env: supersuit.frame_stack_v1(env, 3),
    "max_observation_v0": lambda env: supersuit.max_observation_v0(env, 2),
    "normalize_obs_v0": supersuit.normalize_obs_v0,
    "reshape_v0": lambda env: supersuit.reshape_v0(env, (24, 1)),
    "sticky_actions_v0": lambda env: supersuit.sticky_actions_v0(env, 0.25),
    "observation_lambda_v0": lambda env: supersuit.observation_lambda_v0(env, lambda row, _: row),
    "action_lambda_v1": lambda env: supersuit.action_lambda_v1(env, lambda row, _: row, lambda space: space),
    "reward_lambda_v0": lambda env: supersuit.reward_lambda_v0(env, lambda reward: 2 * reward),
    "black_death_v3": supersuit.black_death_v3,
    "agent_indicator_v0": supersuit.agent_indicator_v0,
    "pad_action_space_v0": supersuit.pad_action_space_v0,
    "pad_observations_v0": supersuit.pad_observations_v0,
}
"""All wrappers of the package but ``color_reduction_v0`` and ``resize_v1``, which are for images."""


OUTSIDE = {"agent_indicator_v0"}
"""The wrappers whose observations leave the spaces that they declare: this one declares 1 and writes the bound."""


def stays_inside(env: ParallelEnv) -> bool:
    """Whether all observations of an episode are in their spaces."""
    env.reset(seed=0)
    inside = True
    while env.agents:
        observations, *_ = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        inside &= all(row in env.observation_space(agent) for agent, row in observations.items())
    return inside


def vector(num_envs: int, base_class: str, **arguments: str) -> supersuit.vector.ConcatVecEnv:
    """The players of ``num_envs`` environments as members of one vector."""
    members = supersuit.pettingzoo_env_to_vec_env_v1(ptne_env.parallel_env(SCENARIO, **arguments))
    return supersuit.concat_vec_envs_v1(members, num_envs, base_class=base_class)


def law_digits() -> np.ndarray:
    """Return the digits that the law gains in the episodes of :func:`yardstick.report`."""
    layout = ptne_env.parallel_env(SCENARIO, **LAW).layout
    env, policy = vector(EPISODES, "gymnasium", **LAW), law(layout)
    observations, _ = env.reset(seed=0)
    gained, memory, over = np.zeros(env.num_envs), None, np.zeros(1)
    while not over.all():
        actions, memory = policy.predict(observations, memory)
        observations, rewards, over, _, _ = env.step(actions)
        gained += rewards
    return gained.reshape(EPISODES, layout.num_players).mean(axis=1)


def main() -> None:
    """Every wrapper, the law's digits, and a short training."""
    outside = {name for name, wrap in WRAPPERS.items() if not stays_inside(wrap(ptne_env.parallel_env(SCENARIO)))}
    if outside != OUTSIDE:
        raise SystemExit(f"observations of {outside} leave their spaces; expected {OUTSIDE}")

    set_random_seed(0)
    env = vector(16, "stable_baselines3")
    env.venv.reset(seed=0)  # SuperSuit's vector has no method seed(), so ``PPO(..., seed=0)`` fails after this
    model = PPO(
        "MlpPolicy", env, n_steps=50, batch_size=500, n_epochs=5, learning_rate=1e-3, gamma=0.9, gae_lambda=0.9,
        policy_kwargs={"log_std_init": -1.0}, device="cpu",
    )  # fmt: skip
    before = digits(model)
    model.learn(20_000)
    report(law_digits(), before, digits(model))


if __name__ == "__main__":
    main()
