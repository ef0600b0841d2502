"""Gymnasium: all players as one agent, whose observations and actions are those of the players, concatenated.

Run it with: python examples/ecosystem/gymnasium_make.py
"""

import gymnasium
from gymnasium.utils.env_checker import check_env
from yardstick import EPISODES, LAW, SCENARIO, law, report


def main() -> None:
    """Run Gymnasium's own check, and print the law's digits."""
    check_env(gymnasium.make(f"ptne_env:ptne/{SCENARIO}-joint-v0").unwrapped, skip_render_check=True)
    env = gymnasium.make(f"ptne_env:ptne/{SCENARIO}-joint-v0", **LAW)
    layout = env.unwrapped.layout
    policy = law(layout)
    gained = []
    for seed in range(EPISODES):
        observation, _ = env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            actions, _ = policy.predict(observation.reshape(layout.num_players, layout.size))
            observation, reward, terminated, truncated, _ = env.step(actions.ravel())
            total, over = total + reward, terminated or truncated
        gained.append(total)
    report(gained)


if __name__ == "__main__":
    main()
