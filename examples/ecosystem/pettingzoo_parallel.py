"""PettingZoo, parallel: all players act at once, each in its own entry of the dictionaries.

Run it with: python examples/ecosystem/pettingzoo_parallel.py
"""

import numpy as np
import pettingzoo
from pettingzoo.test import parallel_api_test
from yardstick import EPISODES, LAW, SCENARIO, law, report

import ptne_env  # noqa: F401 - registers the environments


def main() -> None:
    """Run PettingZoo's own check, and print the law's digits."""
    env = pettingzoo.make("parallel", f"ptne/{SCENARIO}-v0", **LAW)
    parallel_api_test(env, num_cycles=1000)
    policy = law(env.unwrapped.layout)
    gained = []
    for seed in range(EPISODES):
        observations, _ = env.reset(seed=seed)
        total = dict.fromkeys(env.agents, 0.0)
        while env.agents:
            actions, _ = policy.predict(np.stack(list(observations.values())))
            observations, rewards, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
            total = {agent: total[agent] + reward for agent, reward in rewards.items()}
        gained.append(np.mean(list(total.values())))
    report(gained)


if __name__ == "__main__":
    main()
