"""Draw an episode: the estimates of all players, and their error over time.

The paper's static law plays the scenario ``energy-switching-transformed`` from the paper's start, with a hold phase
after the deadline T. Thick lines are the strategies, thin lines the other players' estimates of them, and dotted lines
the Nash equilibrium.

Writes run.png, the picture of the README, to the current folder.

Run it with: python examples/draw_episode.py
"""

import ptne_env

scenario = ptne_env.get_scenario("energy-switching-transformed", start="paper", hold_steps=50)
run = ptne_env.record("static", scenario)
run.plot(estimates=True).savefig("run.png", dpi=200)
print(f"written: run.png, {len(run.t) - 1} steps")
print(f"error at the deadline: {run.errors[run.t <= scenario.deadline][-1, 0]:.1%}, at the end {run.errors[-1, 0]:.1%}")
