"""Draw a phase diagram: the digits of the static law over the consensus gain κ and the number of steps.

Few steps to the deadline are long ones, with which the sampled loop becomes unstable where κ is large. The red line is
the fewest steps for which the theory predicts stability.

Prints the grid of mean digits and writes the picture phase-diagram.png.

Run it with: python examples/phase_diagram.py
"""

import math
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario, theory
from ptne_env.world.world import World

KAPPAS = (0.5, 1.0, 2.0, 4.0, 8.0)
STEPS = (100, 150, 200, 300, 400)
EPISODES = 10


def static_law(kappa: float) -> PolicySpec:
    """Return the static law with this gain."""
    return PolicySpec(f"{kappa:g}", FactorySpec.of("law:static", kappa=kappa))


def measure() -> np.ndarray:
    """Return the mean digits at the deadline, shape (len(STEPS), len(KAPPAS))."""
    rows = []
    for steps in STEPS:
        scenario = get_scenario("energy", steps=steps, input_limit=1e6)
        results = evaluate(map(static_law, KAPPAS), [scenario], episodes=EPISODES)
        rows.append([results.record("energy", f"{kappa:g}", "digits")["mean"] for kappa in KAPPAS])
    return np.array(rows)


def fewest_stable_steps() -> list[float]:
    """Return, for each κ, the number of steps to the deadline below which the loop is unstable."""
    world = World(get_scenario("energy"))
    matrices = [theory.closed_loop_matrix(world.game, world.topology.graphs[0], kappa) for kappa in KAPPAS]
    steps = [theory.largest_stable_step(matrix) for matrix in matrices]
    return [math.nan if step is None else world.clock.effective_time / step for step in steps]


def draw(digits: np.ndarray, file: Path) -> None:
    """Save a picture of the digits as colours, with the predicted boundary."""
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    mesh = axes.pcolormesh(KAPPAS, STEPS, np.maximum(digits, 0), shading="nearest", cmap="viridis")
    axes.plot(KAPPAS, fewest_stable_steps(), color="red", label="fewest stable steps, predicted")
    axes.set(xscale="log", xlabel="consensus gain κ", ylabel="steps to the deadline", title="energy, static law")
    axes.set_ylim(STEPS[0], STEPS[-1])
    axes.legend()
    figure.colorbar(mesh, label=f"digits at the deadline, mean of {EPISODES} (0 where lost)")
    figure.savefig(file, dpi=140)


if __name__ == "__main__":
    digits = measure()
    print("  κ    ", *(f"{kappa:6g}" for kappa in KAPPAS))
    for steps, row in zip(STEPS, digits, strict=True):
        print(f"K = {steps}", *(f"{value:6.2f}" for value in row))
    draw(digits, Path("phase-diagram.png"))
    print("Picture written to phase-diagram.png")
