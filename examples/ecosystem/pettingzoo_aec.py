"""PettingZoo, turn-based (AEC): the players act in turn on the same instant.

Run it with: python examples/ecosystem/pettingzoo_aec.py
"""

import pettingzoo
from pettingzoo.test import api_test
from yardstick import EPISODES, LAW, SCENARIO, law, report

import ptne_env  # noqa: F401 - registers the environments


def main() -> None:
    """Run PettingZoo's own check, and print the law's digits."""
    env = pettingzoo.make("aec", f"ptne/{SCENARIO}-v0", **LAW)
    api_test(env, num_cycles=1000)
    policy = law(env.unwrapped.layout)
    gained = []
    for seed in range(EPISODES):
        env.reset(seed=seed)
        total = 0.0
        for _ in env.agent_iter():
            observation, reward, termination, truncation, _ = env.last()  # the reward since this player's last turn
            total += reward
            env.step(None if termination or truncation else policy.predict(observation)[0])
        gained.append(total / len(env.possible_agents))
    report(gained)


if __name__ == "__main__":
    main()
