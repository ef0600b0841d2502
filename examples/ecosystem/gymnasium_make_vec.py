"""Gymnasium, many environments in one call: an environment that has ended starts again in the next step.

Run it with: python examples/ecosystem/gymnasium_make_vec.py
"""

import gymnasium
import numpy as np
from yardstick import EPISODES, LAW, SCENARIO, law, report


def main() -> None:
    """Print the law's digits, through the end of the first episodes and into the second ones."""
    envs = gymnasium.make_vec(f"ptne_env:ptne/{SCENARIO}-joint-v0", num_envs=EPISODES, **LAW)
    layout = envs.unwrapped.layout
    policy = law(layout)
    observations, _ = envs.reset(seed=0)  # environment b gets seed 0 + b
    gained, over = np.zeros(EPISODES), np.zeros(EPISODES, dtype=bool)
    while not over.all():
        actions, _ = policy.predict(observations.reshape(-1, layout.size))
        observations, rewards, terminated, truncated, _ = envs.step(actions.reshape(EPISODES, -1))
        gained += np.where(over, 0.0, rewards)  # the step that starts an environment again ignores its action
        over |= terminated | truncated
    observations, rewards, terminated, _, _ = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
    clocks = layout.select(observations.reshape(-1, layout.size), "clock")
    if rewards.any() or terminated.any() or clocks[:, 0].any():
        raise SystemExit("the step after the end must start all environments again, at t = 0 and without a reward")
    report(gained)


if __name__ == "__main__":
    main()
