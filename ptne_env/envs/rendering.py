"""Pictures of a running episode: estimates, distances and the live graph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env.shared.style import COLOURS, FAINT, INK, drawing
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ESTIMATES = 200
"""Largest number of estimates of all players that are drawn beside the strategies."""

_SIZE, _DPI = (9.6, 5.4), 100
_STYLE = {"font.size": 11, "legend.fontsize": 11}


class Renderer:
    """A painter of the episode so far; number 0 in the graph is the agent ``player_0``.

    Args:
        world: the world.
        mode: ``"human"`` to show pictures in a window, ``"rgb_array"`` to return them.
        title: the beginning of the headline; the name of the scenario if left out.
    """

    def __init__(self, world: World, mode: str, title: str | None = None) -> None:
        self.world = world
        self.title = world.scenario.name if title is None else title
        self.mode = mode
        self._states: list[State] = []
        self._figure: Figure | None = None
        players = world.game.num_players
        self._colours = [COLOURS[player % len(COLOURS)] for player in range(players)]
        angles = np.pi / 2 - 2 * np.pi * np.arange(players) / players  # clockwise from the top
        self._places = np.column_stack([np.cos(angles), np.sin(angles)])

    def reset(self, state: State) -> None:
        """Forget the last episode and start with a state."""
        self._states = []
        self.record(state)

    def record(self, state: State) -> None:
        """Add a state to the episode; in mode ``human`` it is shown."""
        self._states.append(state)
        if self.mode == "human":
            self.draw()

    def draw(self, instants: int | None = None) -> npt.NDArray[np.uint8] | None:
        """Return the picture, (height, width, 3) uint8, or show it and return ``None`` in mode ``human``.

        Args:
            instants: the number of instants that the picture shows, all if left out. The axes fit all of them, so they
                stand still in a video.

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
            shown = len(self._states) if instants is None else instants
            headline = self._draw_curves(axes["estimates"], axes["distance"], shown)
            self._draw_graph(axes["graph"], self._states[shown - 1])
            figure.text(0.07, 0.945, headline, fontsize=13, fontweight="bold")
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

    def _draw_curves(self, left: Any, right: Any, shown: int) -> str:
        """Draw estimates and their distance at the first instants, and return the headline."""
        game, clock = self._states[0].game, self.world.clock
        estimates = np.array([state.estimates[:, :, 0] for state in self._states])
        far = np.array([distances.estimate_distance(state.estimates, state.game)[0] for state in self._states])
        values = np.concatenate([estimates.ravel(), game.nash_equilibria[:, 0]])
        margin = 0.05 * np.ptp(values) or 1.0
        nearest = max(min(1.0, far.min()), distances.FLOOR)
        left.set_ylim(values.min() - margin, values.max() + margin)
        right.set(ylim=(nearest / 1.5, 1.5 * max(far.max(), 10 * nearest)), yscale="log")  # a decade at least
        right.set_title("relative distance of the estimates", loc="left")
        right.minorticks_off()
        for axes in (left, right):
            axes.set(xlim=(0, clock.t[-1]), xlabel="time t [s]")
            axes.axvline(clock.deadline, color=FAINT, linewidth=1)
            at: Any = (clock.deadline, 1), (-4, -2), ("data", "axes fraction"), "offset points"
            axes.annotate("T", *at, ha="right", va="top")
        is_crowded = game.dimension * game.num_players > MOST_ESTIMATES
        reading = "lines: strategies" if is_crowded else "thick: strategies, thin: others' estimates"
        left.set_title(f"{reading}, dotted: equilibrium", loc="left")
        times, last = clock.t[:shown], {"marker": "o", "markevery": [-1], "markersize": 4}
        for component, owner in enumerate(game.owners):
            colour, of_all = self._colours[owner], estimates[:shown, component]
            is_named = game.num_players <= 10 and owner not in game.owners[:component]  # as many fit below the axes
            left.axhline(game.nash_equilibria[component, 0], color=colour, linestyle=":", linewidth=1)
            if not is_crowded:
                left.plot(times, np.delete(of_all, owner, axis=1), color=colour, linewidth=0.7, alpha=0.5)
            label = f"player_{owner}" if is_named else None
            left.plot(times, of_all[:, owner], color=colour, linewidth=0.9 if is_crowded else 2.0, label=label, **last)
        if game.num_players <= 10:
            place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.02, -0.11), "ncols": 5}
            left.legend(columnspacing=1.2, handlelength=1.4, **place)
        right.plot(times, np.maximum(far[:shown], distances.FLOOR), color=INK, **last)
        error = far[shown - 1]
        reached = f"error {error:.1e}" if error > distances.FLOOR else f"error below {distances.FLOOR:.0e}"
        return f"{self.title}    t = {times[-1]:.3f} s    {reached}"

    def _draw_graph(self, axes: Any, state: State) -> None:
        """Draw the players on a circle, dotted all links that are ever up, and those that are up in a state."""
        from matplotlib.collections import LineCollection

        players, places = len(self._places), self._places
        thinness = min(1.0, 10 / players)  # of links, where there are many players
        live = self.world.topology.graphs[int(dynamics.active_mode(self.world, state)[0])]
        styles = {(":", 1.5, FAINT): self.world.topology.union, ("-", 2.5, INK): live}
        for (style, width, colour), graph in styles.items():
            ends = [places[[i, j]] for i, j in graph.edges]
            axes.add_collection(LineCollection(ends, colors=colour, linestyles=style, linewidths=width * thinness))
        for i, j in np.argwhere(live.adjacency * (live.adjacency.T == 0)):  # i hears j, and j does not hear i
            tip = {"arrowstyle": "-|>", "color": INK, "linewidth": 0, "mutation_scale": 18 * thinness}
            axes.annotate("", (places[i] + places[j]) / 2, (places[i] + 3 * places[j]) / 4, arrowprops=tip)
        size = min(16.0, 220 / players)  # of a node, in points, so that neighbours on the circle do not touch
        ring: dict[str, Any] = {"edgecolor": self._colours, "linewidth": min(1.8, size / 4), "zorder": 2}
        axes.scatter(*places.T, s=size**2, color="white", **ring)
        centred: dict[str, Any] = {"ha": "center", "va": "center_baseline", "fontsize": "small", "zorder": 3}
        for player in range(players if players <= 14 else 0):
            axes.text(*places[player], str(player), **centred)
        axes.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.15, 1.15))
        axes.set_title("live links")
        axes.axis("off")
