"""Gymnasium's vector API: 64 environments in one array, all players of each as one agent.

Prints the digits gained by the paper's static law in the first episode of every environment: mean, smallest, largest.

Run it with: python examples/gymnasium_vector.py
"""

import gymnasium
import numpy as np

from ptne_env import laws


def main() -> None:
    """Every environment draws its own game. When an episode ends, the next step starts another one (NEXT_STEP)."""
    envs = gymnasium.make_vec("ptne_env:ptne/random-energy-joint-v0", num_envs=64)
    law = laws.Static(envs.unwrapped.layout, kappa=2.0)
    observations, _ = envs.reset(seed=7)
    returns, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    while running.any():
        # A joint observation is the players' observations one after the other; the law takes one player per row.
        actions, _ = law.predict(observations.reshape(-1, law.layout.size))
        observations, rewards, terminated, truncated, _ = envs.step(actions.reshape(envs.num_envs, -1))
        returns += np.where(running, rewards, 0.0)
        running &= ~(terminated | truncated)
    envs.close()
    print(f"digits gained in {envs.num_envs} games: {returns.mean():.2f}, {returns.min():.2f} to {returns.max():.2f}")


if __name__ == "__main__":
    main()
