"""Draw an episode: the estimates of all players, and their error over time.

The paper's static law plays the scenario ``energy-switching-transformed`` from the paper's start, with a hold phase
after the deadline. Thick lines are the strategies, thin lines the other players' estimates of them, and dotted lines
the Nash equilibrium.

Writes run.png, the picture of the README, to the current folder.

Run it with: python examples/draw_episode.py
"""

import numpy as np
from matplotlib import pyplot as plt

import ptne_env
from ptne_env import laws


def play(env: ptne_env.NashSeekingEnv) -> tuple[np.ndarray, np.ndarray]:
    """Return the instants t_k, shape (K + 1,), and the estimates, shape (K + 1, N, n)."""
    observations, _ = env.reset(seed=0)
    law, memory = laws.Static(env.layout), None
    times, estimates = [env.time], [env.estimates]
    while env.agents:
        actions, memory = law.predict(np.stack(list(observations.values())), state=memory)
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
        times.append(env.time)
        estimates.append(env.estimates)
    return np.array(times), np.array(estimates)


def main() -> None:
    """Play the episode and draw it."""
    env = ptne_env.parallel_env(
        "energy-switching-transformed", interface=laws.Static.interface, start="paper", hold_steps=50
    )
    times, estimates = play(env)
    errors = np.linalg.norm(estimates - env.nash_equilibrium, axis=(1, 2))
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(4.5, 4.6), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    for player in range(len(env.possible_agents)):
        colour = f"C{player}"
        others = np.delete(estimates[:, :, player], player, axis=1)
        top.plot(times, others, color=colour, linewidth=0.6, alpha=0.55)
        top.plot(times, estimates[:, player, player], color=colour, linewidth=1.7)
        top.axhline(env.nash_equilibrium[player], color=colour, linestyle=":", linewidth=0.9)
    top.set(ylabel="strategies and estimates of them")
    bottom.semilogy(times, errors / errors[0], color="black")
    bottom.set(xlabel="time t in s", ylabel="error / error at the start")
    for axes in (top, bottom):
        axes.axvline(env.scenario.deadline, color="grey", linewidth=0.8)
    figure.savefig("run.png", dpi=150)
    print(f"written: run.png, {len(times) - 1} steps")


if __name__ == "__main__":
    main()
