"""Pictures of a running episode: estimates, distances and the live graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.style import COLOURS, FAINT, INK, drawing
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE, _DPI = (9.6, 5.4), 100
_STYLE = {"font.size": 11, "legend.fontsize": 11}

MOST_ESTIMATES = 200
"""The largest number of estimates of all players that a picture or a page shows beside the strategies."""

_Limits = tuple[tuple[float, float], tuple[float, float]]


class Renderer:
    """A painter of the episode so far; number 0 in the graph is the agent ``player_0``.

    Args:
        world: the world.
        mode: ``"human"`` to show pictures in a window, ``"rgb_array"`` to return them.
    """

    def __init__(self, world: World, mode: str) -> None:
        self.world = world
        self.mode = mode
        players = world.game.num_players
        self._is_crowded = world.game.dimension * players > MOST_ESTIMATES
        self._thinness = min(1.0, 10 / players)  # of links, which are thinner where there are many players
        angles = np.pi / 2 - 2 * np.pi * np.arange(players) / players  # on a circle, clockwise from the top
        self._places = np.cos(angles), np.sin(angles)
        self._states: list[State] = []
        self._figure: Figure | None = None
        self._axes: dict[str, Any] = {}

    def reset(self, state: State) -> None:
        """Forget the last episode and start with a state."""
        self._states = [state]

    def record(self, state: State) -> None:
        """Add a state to the episode."""
        self._states.append(state)

    def draw(self) -> npt.NDArray[np.uint8] | None:
        """Return the picture, (height, width, 3) uint8, or show it and return ``None`` in mode ``human``.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        with drawing("pictures of episodes", _STYLE):
            estimates, far = _histories(self._states)
            self._figure = figure = self._figure or self._open()
            figure.clear()
            self._lay_out(figure, _axis_limits(estimates, far, self._states[0]))
            self._draw_moving(figure, estimates, far)
            if self.mode == "human":
                figure.canvas.draw_idle()
                figure.canvas.flush_events()
                return None
            figure.canvas.draw()
            drawn = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]  # Agg has it
            return drawn[:, :, :3].copy()

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

    def _lay_out(self, figure: Figure, limits: _Limits) -> None:
        """Draw what stands still with the axes: the axes, equilibrium, deadline and all links that are ever up."""
        self._axes = figure.subplot_mosaic(
            [["estimates", "distance"], ["estimates", "graph"]],
            width_ratios=[3, 2],
            height_ratios=[2, 3],
            gridspec_kw={"left": 0.07, "right": 0.975, "top": 0.86, "bottom": 0.17, "wspace": 0.24, "hspace": 0.5},
        )
        estimates, distance, graph = (self._axes[name] for name in ("estimates", "distance", "graph"))
        game, clock = self._states[0].game, self.world.clock
        reading = "lines: strategies" if self._is_crowded else "thick: strategies, thin: others' estimates"
        estimates.set_title(f"{reading}, dotted: equilibrium", loc="left")
        for component, owner in enumerate(game.owners):
            estimates.axhline(game.nash_equilibria[component, 0], color=_colour(owner), linestyle=":", linewidth=1)
        if game.num_players <= 10:  # as many names as fit below the axes
            for player in range(game.num_players):
                estimates.plot([], [], color=_colour(player), linewidth=2, label=f"player_{player}")
            place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.11), "ncols": 5}
            estimates.legend(columnspacing=1.2, handlelength=1.4, **place)
        distance.set_yscale("log")
        distance.set_title("relative distance of the estimates", loc="left")
        distance.minorticks_off()
        for axes, limit in zip((estimates, distance), limits, strict=True):
            axes.set(xlim=(0, clock.t[-1]), xlabel="time t [s]", ylim=limit)
            axes.axvline(clock.deadline, color=FAINT, linewidth=1)
            at: Any = (clock.deadline, 1), (-4, -2), ("data", "axes fraction"), "offset points"
            axes.annotate("T", *at, ha="right", va="top")
        x, y = self._places
        for i, j in self.world.topology.union.edges:
            graph.plot(x[[i, j]], y[[i, j]], color=FAINT, linestyle=":", linewidth=1.5 * self._thinness, zorder=1)
        graph.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.15, 1.15))
        graph.set_title("live links")
        graph.axis("off")

    def _draw_moving(self, figure: Figure, estimates: FloatArray, far: Sequence[float]) -> None:
        """Draw what moves: strategies, estimates, distance, live links and the headline."""
        game, times, players = self._states[0].game, self.world.clock.t[: len(far)], self.world.game.num_players
        left, distance, graph = (self._axes[name] for name in ("estimates", "distance", "graph"))
        last: dict[str, Any] = {"marker": "o", "markevery": [-1], "markersize": 4}
        for component, owner in enumerate(game.owners):
            if not self._is_crowded:
                others = np.delete(estimates[:, component], owner, axis=1)
                left.plot(times, others, color=_colour(owner), linewidth=0.7, alpha=0.5)
            width = 0.9 if self._is_crowded else 2.0
            left.plot(times, estimates[:, component, owner], color=_colour(owner), linewidth=width, **last)
        distance.plot(times, np.maximum(far, distances.FLOOR), color=INK, **last)
        x, y = self._places
        mode = int(dynamics.active_mode(self.world, self._states[-1])[0])
        links = self.world.topology.graphs[mode]
        for i, j in links.edges:
            graph.plot(x[[i, j]], y[[i, j]], color=INK, linewidth=2.5 * self._thinness, zorder=1)
        for i, j in np.argwhere(links.adjacency * (links.adjacency.T == 0)):  # i hears j, and j does not hear i
            tip = {"arrowstyle": "-|>", "color": INK, "linewidth": 0, "mutation_scale": 18 * self._thinness}
            ends: Any = (x[i] + 3 * x[j]) / 4, (y[i] + 3 * y[j]) / 4
            graph.annotate("", (x[[i, j]].mean(), y[[i, j]].mean()), ends, arrowprops=tip)
        size = min(16.0, 220 / players)  # of a node, in points, so that neighbours on the circle do not touch
        ring: dict[str, Any] = {"edgecolor": [_colour(player) for player in range(players)], "zorder": 2}
        graph.scatter(x, y, s=size**2, color="white", linewidth=min(1.8, size / 4), **ring)
        centred: dict[str, Any] = {"ha": "center", "va": "center_baseline", "fontsize": "small", "zorder": 3}
        for i in range(players if players <= 14 else 0):
            graph.text(x[i], y[i], str(i), **centred)
        reached = f"error {far[-1]:.1e}" if far[-1] > distances.FLOOR else f"error below {distances.FLOOR:.0e}"
        headline = f"{self.world.scenario.name}    t = {times[-1]:.3f} s    {reached}"
        bold: dict[str, Any] = {"fontsize": 13, "fontweight": "bold", "transform": figure.transFigure}
        left.text(0.07, 0.945, headline, **bold)


def _colour(player: int) -> str:
    return COLOURS[player % len(COLOURS)]


def _histories(states: Sequence[State]) -> tuple[FloatArray, list[float]]:
    """Return the estimates, shape (instants, n, N), and their relative distance at every instant."""
    estimates = np.array([state.estimates[:, :, 0] for state in states])
    return estimates, [float(distances.estimate_distance(state.estimates, state.game)[0]) for state in states]


def _axis_limits(estimates: FloatArray, far: Sequence[float], state: State) -> _Limits:
    """Return the limits of the vertical axes: of estimates and equilibria, and of a decade of distances at least."""
    values = np.concatenate([estimates.ravel(), state.game.nash_equilibria[:, 0]])
    margin = 0.05 * (values.max() - values.min()) or 1.0
    nearest = max(min(1.0, *far), distances.FLOOR)
    farthest = max(*far, 10 * nearest)
    return (float(values.min() - margin), float(values.max() + margin)), (nearest / 1.5, 1.5 * farthest)
