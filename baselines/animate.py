"""Animate one episode of every track of ptne-v1: ``python -m baselines.animate`` writes ``docs/images/tracks.gif``.

A panel per track. Left: all players' strategies (thick), the estimates of them by the others (thin) and the equilibrium
(dotted); the axis is the root of the step, because most happens early. Right: the players and the links over which
messages arrive.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

from ptne_env.envs.rendering import MOST_ESTIMATES
from ptne_env.evaluation import get_policy_spec
from ptne_env.evaluation.trajectories import Trajectories, play
from ptne_env.shared.files import write_atomically
from ptne_env.shared.style import COLOURS, FAINT, INK, drawing
from ptne_env.suites import get_suite

COLUMNS, PICTURES, PER_SECOND = 3, 60, 10


class Panel:
    """The two axes of a track, and the lines that grow."""

    def __init__(self, title: str, run: Trajectories, left: Any, right: Any) -> None:
        self.run, game = run, run.rollout.world.game
        colours = np.array([COLOURS[owner % len(COLOURS)] for owner in game.owners])
        lines, kinds = [run.strategies[..., 0].T], [(colours, 1.3, 1.0)]
        if game.dimension * game.num_players <= MOST_ESTIMATES:
            lines.insert(0, run.estimates[..., 0].T.reshape(-1, len(run.t)))
            kinds.insert(0, (np.repeat(colours, game.num_players), 0.5, 0.5))
        self.steps = np.sqrt(np.arange(len(run.t)))
        self.lines = lines
        self.drawn = [LineCollection([], colors=each, linewidths=width, alpha=alpha) for each, width, alpha in kinds]
        shown = np.concatenate([run.nash_equilibria[:, 0], run.strategies[0, :, 0]])
        room = 0.4 * np.ptp(shown)
        left.set(xlim=(0, self.steps[-1]), ylim=(shown.min() - room, shown.max() + room), xticks=[], yticks=[])
        left.hlines(run.nash_equilibria[:, 0], 0, self.steps[-1], colours, linestyles=":", linewidth=0.7)
        left.set_title(title, fontsize=9, loc="left", pad=3)
        for each in self.drawn:
            left.add_collection(each)
        angles = np.pi / 2 - 2 * np.pi * np.arange(game.num_players) / game.num_players
        self.places = np.column_stack([np.cos(angles), np.sin(angles)])
        right.set(aspect="equal", xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
        right.axis("off")
        right.add_collection(LineCollection(self.places[run.links], colors=FAINT, linewidths=0.3, linestyles=":"))
        self.links = LineCollection([], colors=INK, linewidths=0.8 if len(angles) < 15 else 0.2)
        right.add_collection(self.links)
        nodes = [COLOURS[player % len(COLOURS)] for player in range(len(angles))]
        right.scatter(*self.places.T, s=18 if len(angles) < 15 else 5, color=nodes, zorder=3)

    def show(self, share: float) -> None:
        """The episode up to a share of its steps."""
        last = 1 + round(share**2 * (len(self.steps) - 1))
        for drawn, values in zip(self.drawn, self.lines, strict=True):
            drawn.set_segments([np.column_stack([self.steps[:last], line[:last]]) for line in values])
        self.links.set_segments(self.places[self.run.links[self.run.weights[last - 1, :, 0] > 0]])


def pictures(policy: str, count: int) -> Iterator[Any]:
    """The frames of all tracks, side by side."""
    suite, spec = get_suite("ptne-v1"), get_policy_spec(policy)
    rows = -(-len(suite.tracks) // COLUMNS)
    with drawing("animations", {"axes.grid": False, "axes.spines.left": False, "axes.spines.bottom": False}):
        figure = Figure(figsize=(3.2 * COLUMNS, 1.35 * rows), dpi=100, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots(rows, 2 * COLUMNS, width_ratios=COLUMNS * [2, 1], squeeze=False)
        for each in axes.flat:
            each.axis("off")
        panels = []
        for place, track in enumerate(suite.tracks):
            left, right = axes[place // COLUMNS, 2 * (place % COLUMNS) : 2 * (place % COLUMNS) + 2]
            run = play(track, spec, suite.episode_set(track.name, 1), kept=1)
            left.axis("on")
            panels.append(Panel(track.name, run, left, right))
        for share in np.linspace(0, 1, count):
            for panel in panels:
                panel.show(share)
            canvas.draw()
            yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def encode_gif(pictures: Iterator[Any], per_second: int) -> bytes:
    """Return pictures, uint8 of shape (height, width, 3), as a GIF that stays on the last one for two seconds."""
    # Matplotlib's PillowWriter gives every picture its own palette: colours flicker, and files are ten times larger.
    images = [Image.fromarray(picture) for picture in pictures]
    palette = images[-1].quantize(colors=256)  # the last picture has every colour
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [1000 // per_second] * (len(images) - 1) + [2000]
    buffer = io.BytesIO()
    images[0].save(buffer, "gif", save_all=True, append_images=images[1:], duration=durations, loop=0)
    return buffer.getvalue()


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", default="relay")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "images" / "tracks.gif")
    given = parser.parse_args()
    write_atomically(given.out, encode_gif(pictures(given.policy, PICTURES), PER_SECOND))
    print(f"written: {given.out}, {given.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
