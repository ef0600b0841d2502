# ruff: noqa: INP001, T201 - a script, and it prints
"""Draw the picture of the README (an episode) and those of the routed laws in docs/theory.md.

Run it from the project's folder with: python docs/make_pictures.py
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ptne_env
from ptne_env import theory
from ptne_env.evaluation import POLICIES
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.traces import scene
from ptne_env.shared.style import COLOURS, FAINT, drawing
from ptne_env.world.world import World

sys.path.insert(0, str(Path(__file__).parent))
import scenario_pages

IMAGES = Path(__file__).parent / "images"
SIZE = 4.5, 3.4  # inches, readable on a phone


def draw_run(path: Path) -> None:
    """Save the estimates, the error and the graph of an episode of the static law with a hold phase."""
    world = World(ptne_env.get_scenario("energy-switching-transformed", hold_steps=50))
    shown = scene(world, EpisodeSet(1).initial_state(world), {"static": POLICIES["static"]})
    with drawing("pictures"):
        figure = Figure(figsize=(4.5, 4.6), layout="constrained")  # upright, as a phone is
        axes = figure.subplot_mosaic("SS;EG", height_ratios=(3, 2), width_ratios=(3, 2))
        scenario_pages.draw_episode(world, shown, axes["S"], axes["E"], axes["G"])
        axes["S"].set_title("thick: strategies, thin: estimates of them by others,\ndotted: the equilibrium")
        axes["E"].set_title("relative error")
        axes["G"].set_title("links at the start")
        _save(figure, path)


def draw_routed(path: Path, episodes: int = 100) -> None:
    """Save the errors of laws over a switching graph."""
    with drawing("pictures"):
        figure = Figure(figsize=SIZE, layout="constrained")
        axes = figure.subplots()
        world = World(ptne_env.get_scenario("random-energy-switching-transformed"))
        start = EpisodeSet(episodes).initial_state(world)
        chosen = {name: POLICIES[name] for name in ("static", "grounded", "routed", "freshest")}
        traces = scene(world, start, chosen).traces
        for colour, (name, trace) in zip(COLOURS, traces.items(), strict=False):
            axes.fill_between(range(len(trace.errors[0])), trace.errors[0], trace.errors[2], color=colour, alpha=0.15)
            axes.semilogy(trace.errors[1], color=colour, label=name)
        axes.set(xlabel="step k", ylabel="estimate distance: median, 10 % to 90 %", ylim=(1e-12, 10))
        axes.set_title("random-energy-switching-transformed", loc="left")
        axes.legend()
        _save(figure, path)


def draw_radius(path: Path) -> None:
    """Save the radius of gradient play with delays over its step η."""
    with drawing("pictures"):
        figure = Figure(figsize=SIZE, layout="constrained")
        axes = figure.subplots()
        tracks = {"nominal, 5-cycle": "nominal", "non-quadratic, 5-cycle": "non-quadratic", "large-20": "large-20"}
        for colour, (label, name) in zip(COLOURS[4:], tracks.items(), strict=False):
            world = World(ptne_env.evaluation.get_suite("ptne-v1").track(name).scenario)
            constants = theory.problem_constants(world)
            jacobian, delays = constants.jacobian, theory.hop_delays(world.topology.graphs[0], world.game.owners)
            steps = np.linspace(0.005, 1.2, 200)
            radius = [theory.delayed_play_radius(jacobian, delays, step) for step in steps]
            axes.plot(steps, radius, label=label, color=colour)
            axes.plot(theory.largest_delayed_step(jacobian, delays), 1, "o", color=colour)
        axes.axhline(1, color=FAINT, linewidth=0.8)
        axes.set(xlabel="step η of the own gradient", ylabel="spectral radius per step", ylim=(0, 1.6))
        axes.set_title("Gradient play with delays equal to hop counts", loc="left")
        axes.legend()
        _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without the "Software" entry the same picture gives the same file under every version of matplotlib.
    figure.savefig(path, dpi=150, metadata={"Software": None})


if __name__ == "__main__":
    for name, draw in {"run": draw_run, "routed": draw_routed, "radius": draw_radius}.items():
        draw(IMAGES / f"{name}.png")
        print(f"written: {IMAGES / name}.png")
