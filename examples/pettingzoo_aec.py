"""The turn-based (AEC) form of PettingZoo: a law moves one player at a time.

Prints the distance to the Nash equilibrium at the deadline, beside the largest that still counts as a success.

Run it with: python examples/pettingzoo_aec.py
"""

from typing import Any

import numpy as np
import pettingzoo

import ptne_env
from ptne_env import laws


def main() -> None:
    """Play an episode of Example 1 with the paper's adaptive law, whose gains are each player's own memory."""
    env = pettingzoo.make("aec", "ptne/energy-v0")  # importing ptne_env registered it
    env.reset(seed=7)
    world: ptne_env.NashSeekingEnv = env.unwrapped
    law = laws.Adaptive(world.layout)
    memories: dict[str, Any] = dict.fromkeys(env.possible_agents)
    for agent in env.agent_iter():
        observation, _, terminated, truncated, info = env.last()
        if terminated or truncated:
            action = None  # this is how PettingZoo says goodbye to an agent
            success = info["is_success"]
        else:
            action, memories[agent] = law.predict(observation, memories[agent])
        env.step(action)
    equilibrium = world.nash_equilibrium
    distance = np.linalg.norm(world.strategies - equilibrium) / np.linalg.norm(equilibrium)
    print(f"‖x − x*‖/‖x*‖ = {distance:.2e} at the deadline; success (all estimates within 0.5 %): {success}")


if __name__ == "__main__":
    main()
