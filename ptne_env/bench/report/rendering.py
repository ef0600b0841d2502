"""Pictures of a running episode: estimates, distances and the live graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env.bench.report.style import COLOURS, FAINT, INK, drawing
from ptne_env.shared.arrays import FloatArray
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE, _DPI = (9.6, 5.4), 100
_STYLE = {"font.size": 11, "legend.fontsize": 11}

_MOST_LINES = 200
"""Estimates by other players are drawn up to this many lines; beyond it, the strategies alone."""

_MOST_NAMES = 10
"""The legend names up to this many players."""

_Limits = tuple[tuple[float, float], tuple[float, float]]


def pixels(figure: Figure) -> npt.NDArray[np.uint8]:
    """A figure of :class:`Renderer` as a picture of its own, (height, width, 3) uint8."""
    figure.canvas.draw()
    drawn = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]  # the Agg canvas has it
    return drawn[:, :, :3].copy()


class Renderer:
    """Draws the episode so far, with the names of the agents: number 0 in the graph is ``player_0``.

    Args:
        world: the world.
        mode: ``"human"`` shows a window where the display has one, ``"rgb_array"`` returns the picture.
        title: the beginning of the headline; the scenario's name if left out.
    """

    def __init__(self, world: World, mode: str, title: str | None = None) -> None:
        self.world = world
        self.title = world.scenario.name if title is None else title
        self.mode = mode
        self._states: list[State] = []
        self._limits: _Limits | None = None
        self._figure: Figure | None = None

    def fix_axes(self, states: Sequence[State]) -> None:
        """Give every picture the axes that ``states``, the whole episode, need: in a video the axes stand still."""
        self._limits = _needed(*_histories(states), states[0])

    def reset(self, state: State) -> None:
        """Forget the last episode and start with ``state``."""
        self._states = [state]

    def record(self, state: State) -> None:
        """Add an instant."""
        self._states.append(state)

    def draw(self) -> npt.NDArray[np.uint8] | None:
        """The picture, (height, width, 3) uint8; ``None`` in mode ``human``, which shows it instead.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        with drawing("pictures of episodes", _STYLE):
            figure = self.update()
            if self.mode == "human":
                figure.canvas.draw_idle()
                figure.canvas.flush_events()
                return None
            return pixels(figure)

    def update(self) -> Figure:
        """The figure of the episode so far, for a caller that draws it; always the same one.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        with drawing("pictures of episodes", _STYLE):
            self._figure = figure = self._figure or self._open()
            figure.clear()
            axes = figure.subplot_mosaic(
                [["estimates", "distance"], ["estimates", "graph"]],
                width_ratios=[3, 2],
                height_ratios=[2, 3],
                gridspec_kw={"left": 0.07, "right": 0.975, "top": 0.86, "bottom": 0.17, "wspace": 0.24, "hspace": 0.5},
            )
            estimates, far = _histories(self._states)
            times = self.world.clock.t[: len(far)]
            self._draw_estimates(axes["estimates"], times, estimates)
            distance = axes["distance"]
            distance.semilogy(times, np.maximum(far, distances.FLOOR), color=INK, marker="o", markevery=[-1], ms=4)
            distance.set_title("relative distance of the estimates", loc="left")
            distance.minorticks_off()
            limits = self._limits or _needed(estimates, far, self._states[0])
            for each, limit in zip((axes["estimates"], distance), limits, strict=True):
                each.set(xlim=(0, self.world.clock.t[-1]), xlabel="time t [s]", ylim=limit)
                deadline = self.world.clock.deadline
                each.axvline(deadline, color=FAINT, linewidth=1)
                each.annotate(
                    "T", (deadline, 1), (-4, -2), ("data", "axes fraction"), "offset points", ha="right", va="top"
                )
            self._draw_graph(axes["graph"])
            reached = f"error {far[-1]:.1e}" if far[-1] > distances.FLOOR else f"error below {distances.FLOOR:.0e}"
            headline = f"{self.title}    t = {times[-1]:.3f} s    {reached}"
            figure.text(0.07, 0.945, headline, fontsize=13, fontweight="bold")
            return figure

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None and self.mode == "human":
            from matplotlib import pyplot as plt

            plt.close(self._figure)
        self._figure = None

    def _open(self) -> Figure:
        if self.mode == "human":
            from matplotlib import pyplot as plt

            plt.ion()
            return plt.figure(figsize=_SIZE, dpi=_DPI)
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=_SIZE, dpi=_DPI)
        FigureCanvasAgg(figure)
        return figure

    def _draw_estimates(self, axes: Any, times: FloatArray, estimates: FloatArray) -> None:
        game = self._states[0].game
        crowded = game.dimension * game.num_players > _MOST_LINES
        for component, owner in enumerate(game.owners):
            colour = COLOURS[owner % len(COLOURS)]
            axes.axhline(game.nash_equilibria[component, 0], color=colour, linestyle=":", linewidth=1)
            if not crowded:
                others = np.delete(estimates[:, component], owner, axis=1)
                axes.plot(times, others, color=colour, linewidth=0.7, alpha=0.5)
            label = f"player_{owner}" if component == game.offsets[owner] else None
            thick: dict[str, Any] = {"color": colour, "linewidth": 0.9 if crowded else 2.0, "label": label}
            axes.plot(times, estimates[:, component, owner], marker="o", markevery=[-1], markersize=4, **thick)
        reading = "lines: strategies" if crowded else "thick: strategies, thin: others' estimates"
        axes.set_title(f"{reading}, dotted: equilibrium", loc="left")
        if game.num_players <= _MOST_NAMES:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.02, -0.11), ncols=5, columnspacing=1.2, handlelength=1.4)

    def _draw_graph(self, axes: Any) -> None:
        players = self.world.game.num_players
        angles = np.pi / 2 - 2 * np.pi * np.arange(players) / players
        x, y = np.cos(angles), np.sin(angles)
        mode = int(dynamics.active_mode(self.world, self._states[-1])[0])
        live, width = set(self.world.topology.graphs[mode].edges), min(2.5, 25 / players)
        for i, j in self.world.topology.union.edges:
            colour, style, size = (INK, "-", width) if (i, j) in live else (FAINT, ":", 0.6 * width)
            axes.plot(x[[i, j]], y[[i, j]], color=colour, linestyle=style, linewidth=size, zorder=1)
        colours = [COLOURS[player % len(COLOURS)] for player in range(players)]
        size = min(16.0, 220 / players)  # of a node, in points, so that neighbours on the circle do not touch
        axes.scatter(x, y, s=size**2, color="white", edgecolor=colours, linewidth=min(1.8, size / 4), zorder=2)
        for player in range(players if players <= 14 else 0):
            axes.text(x[player], y[player], str(player), ha="center", va="center_baseline", fontsize="small", zorder=3)
        axes.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.15, 1.15))
        axes.set_title("live links")
        axes.axis("off")


def _histories(states: Sequence[State]) -> tuple[FloatArray, list[float]]:
    """Estimates (instants, n, N) and the relative distance of all of them at every instant."""
    estimates = np.array([state.estimates[:, :, 0] for state in states])
    return estimates, [float(distances.estimate_distance(state.estimates, state.game)[0]) for state in states]


def _needed(estimates: FloatArray, far: Sequence[float], state: State) -> _Limits:
    """Limits of the two vertical axes: room for estimates and equilibria, and a decade of distances at least."""
    values = np.concatenate([estimates.ravel(), state.game.nash_equilibria[:, 0]])
    margin = 0.05 * (values.max() - values.min()) or 1.0
    nearest = max(min(1.0, *far), distances.FLOOR)
    farthest = max(*far, 10 * nearest)
    return (float(values.min() - margin), float(values.max() + margin)), (nearest / 1.5, 1.5 * farthest)
