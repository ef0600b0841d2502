"""Pictures of a running episode: estimates, distances and the live graph."""

from __future__ import annotations

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

_LAST: dict[str, Any] = {"marker": "o", "markevery": [-1], "markersize": 4}
"""The mark at the end of a line, where the episode is."""


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

    def reset(self, state: State) -> None:
        """Forget the last episode and start with a state, which a window shows at once."""
        self._states = []
        self.record(state)

    def record(self, state: State) -> None:
        """Add a state to the episode, which a window shows at once."""
        self._states.append(state)
        if self.mode == "human":
            self.draw()

    def draw(self) -> npt.NDArray[np.uint8] | None:
        """Return the picture, (height, width, 3) uint8, or show it and return ``None`` in mode ``human``.

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
            self._draw_estimates(axes["estimates"])
            self._draw_distance(axes["distance"])
            self._draw_links(axes["graph"])
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

    def _draw_estimates(self, axes: Any) -> None:
        """Draw strategies, others' estimates of them and the equilibrium, below the headline."""
        game, times = self._states[0].game, self._draw_time(axes)
        estimates = np.array([state.estimates[:, :, 0] for state in self._states])  # (instants, n, N)
        reading = "lines: strategies" if self._is_crowded else "thick: strategies, thin: others' estimates"
        axes.set_title(f"{reading}, dotted: equilibrium", loc="left")
        for component, owner in enumerate(game.owners):
            axes.axhline(game.nash_equilibria[component, 0], color=_colour(owner), linestyle=":", linewidth=1)
        for component, owner in enumerate(game.owners):
            if not self._is_crowded:
                others = np.delete(estimates[:, component], owner, axis=1)
                axes.plot(times, others, color=_colour(owner), linewidth=0.7, alpha=0.5)
            width = 0.9 if self._is_crowded else 2.0
            axes.plot(times, estimates[:, component, owner], color=_colour(owner), linewidth=width, **_LAST)
        if game.num_players <= 10:  # as many names as fit below the axes
            for player in range(game.num_players):
                axes.plot([], [], color=_colour(player), linewidth=2, label=f"player_{player}")
            place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.11), "ncols": 5}
            axes.legend(columnspacing=1.2, handlelength=1.4, **place)
        values = np.concatenate([estimates.ravel(), game.nash_equilibria[:, 0]])
        margin = 0.05 * (values.max() - values.min()) or 1.0
        axes.set_ylim(values.min() - margin, values.max() + margin)

    def _draw_distance(self, axes: Any) -> None:
        """Draw the relative distance of the estimates over a decade at least, and write the headline with the last."""
        times = self._draw_time(axes)
        far = [float(distances.estimate_distance(state.estimates, state.game)[0]) for state in self._states]
        axes.set_yscale("log")
        axes.set_title("relative distance of the estimates", loc="left")
        axes.minorticks_off()
        axes.plot(times, np.maximum(far, distances.FLOOR), color=INK, **_LAST)
        nearest = max(min(1.0, *far), distances.FLOOR)
        axes.set_ylim(nearest / 1.5, 1.5 * max(*far, 10 * nearest))
        reached = f"error {far[-1]:.1e}" if far[-1] > distances.FLOOR else f"error below {distances.FLOOR:.0e}"
        headline = f"{self.world.scenario.name}    t = {times[-1]:.3f} s    {reached}"
        axes.figure.text(0.07, 0.945, headline, fontsize=13, fontweight="bold")

    def _draw_time(self, axes: Any) -> FloatArray:
        """Draw the axis of time and the deadline, and return the instants so far."""
        clock = self.world.clock
        axes.set(xlim=(0, clock.t[-1]), xlabel="time t [s]")
        axes.axvline(clock.deadline, color=FAINT, linewidth=1)
        at: Any = (clock.deadline, 1), (-4, -2), ("data", "axes fraction"), "offset points"
        axes.annotate("T", *at, ha="right", va="top")
        return clock.t[: len(self._states)]

    def _draw_links(self, axes: Any) -> None:
        """Draw the players, the links that are up, and those that ever are."""
        x, y = self._places
        players, union = self.world.game.num_players, self.world.topology.union
        links = self.world.topology.graphs[int(dynamics.active_mode(self.world, self._states[-1])[0])]
        for i, j in union.edges:
            axes.plot(x[[i, j]], y[[i, j]], color=FAINT, linestyle=":", linewidth=1.5 * self._thinness, zorder=1)
        for i, j in links.edges:
            axes.plot(x[[i, j]], y[[i, j]], color=INK, linewidth=2.5 * self._thinness, zorder=1)
        for i, j in np.argwhere(links.adjacency * (links.adjacency.T == 0)):  # i hears j, and j does not hear i
            tip = {"arrowstyle": "-|>", "color": INK, "linewidth": 0, "mutation_scale": 18 * self._thinness}
            ends: Any = (x[i] + 3 * x[j]) / 4, (y[i] + 3 * y[j]) / 4
            axes.annotate("", (x[[i, j]].mean(), y[[i, j]].mean()), ends, arrowprops=tip)
        size = min(16.0, 220 / players)  # of a node, in points, so that neighbours on the circle do not touch
        ring: dict[str, Any] = {"edgecolor": [_colour(player) for player in range(players)], "zorder": 2}
        axes.scatter(x, y, s=size**2, color="white", linewidth=min(1.8, size / 4), **ring)
        centred: dict[str, Any] = {"ha": "center", "va": "center_baseline", "fontsize": "small", "zorder": 3}
        for i in range(players if players <= 14 else 0):
            axes.text(x[i], y[i], str(i), **centred)
        axes.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.15, 1.15))
        axes.set_title("live links")
        axes.axis("off")


def _colour(player: int) -> str:
    return COLOURS[player % len(COLOURS)]
