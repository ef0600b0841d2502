"""A picture of a running episode: estimates, distances and the live graph. Needs matplotlib, imported when drawing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.dynamics import Dynamics, State

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE, _DPI = (9.6, 4.8), 100
_LINES = 200
"""Others' estimates are drawn up to this many lines; beyond, the strategies alone."""
_NAMES = 10
"""Players are told apart by colour and legend up to this many."""


class Renderer:
    """Draws the episode so far.

    Args:
        dynamics: the world.
        mode: ``"human"`` shows a window where the display has one, ``"rgb_array"`` returns the picture.
    """

    def __init__(self, dynamics: Dynamics, mode: str) -> None:
        self.dynamics = dynamics
        self.mode = mode
        self._estimates: list[FloatArray] = []
        self._estimate_distances: list[float] = []
        self._game = dynamics.game
        self._mode = 0
        self._figure: Figure | None = None
        self._limits: tuple[tuple[float, float], tuple[float, float]] | None = None

    def foresee(self, states: Sequence[State]) -> None:
        """Give all pictures the axes that these states of an episode need, so that a film of them does not jump."""
        values = np.array([state.estimates[:, :, 0] for state in states])
        far = [float(distances.estimate_distance(state.estimates, state.game)[0]) for state in states]
        nash = states[0].game.nash_equilibria[:, 0]
        low, high = min(values.min(), nash.min()), max(values.max(), nash.max())
        margin = 0.05 * (high - low)
        nearest = max(min(far), distances.FLOOR)
        self._limits = (low - margin, high + margin), (nearest / 1.5, 1.5 * max(*far, nearest))

    def reset(self, state: State) -> None:
        """Forget the last episode and start with ``state``."""
        self._estimates.clear()
        self._estimate_distances.clear()
        self._game = state.game
        self.record(state)

    def record(self, state: State) -> None:
        """Add an instant."""
        self._estimates.append(state.estimates[:, :, 0])
        self._estimate_distances.append(float(distances.estimate_distance(state.estimates, self._game)[0]))
        self._mode = int(state.mode[0])

    def draw(self) -> npt.NDArray[np.uint8] | None:
        """The picture, (height, width, 3) uint8; ``None`` in mode ``human``, which shows it instead.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        figure = self._open()
        figure.clear()
        axes = figure.subplot_mosaic([["estimates", "distance"], ["estimates", "graph"]], width_ratios=[3, 2])
        self._draw_estimates(axes["estimates"])
        self._draw_distance(axes["distance"])
        self._draw_graph(axes["graph"])
        if self.mode == "human":
            figure.canvas.draw_idle()
            figure.canvas.flush_events()
            return None
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]  # the Agg canvas has it
        return pixels[:, :, :3].copy()

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None and self.mode == "human":
            from matplotlib import pyplot as plt

            plt.close(self._figure)
        self._figure = None

    def _open(self) -> Figure:
        if self._figure is None:
            try:
                from matplotlib import pyplot as plt
                from matplotlib.backends.backend_agg import FigureCanvasAgg
                from matplotlib.figure import Figure
            except ImportError as error:
                raise ImportError('rendering needs matplotlib: pip install "ptne-env[bench]"') from error
            if self.mode == "human":
                plt.ion()
                self._figure = plt.figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
            else:
                self._figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
                FigureCanvasAgg(self._figure)
        return self._figure

    def _draw_estimates(self, axes: Any) -> None:
        game, estimates = self._game, np.array(self._estimates)
        times = self.dynamics.clock.t[: len(estimates)]
        for component, owner in enumerate(game.owners):
            colour = f"C{owner % 10}"
            if game.dimension * game.num_players <= _LINES:
                others = np.delete(estimates[:, component], owner, axis=1)
                axes.plot(times, others, color=colour, linewidth=0.6, alpha=0.5)
            label = f"player {owner}" if component == game.offsets[owner] else None
            axes.plot(times, estimates[:, component, owner], color=colour, linewidth=1.8, label=label)
            axes.axhline(self._game.nash_equilibria[component, 0], color=colour, linestyle=":", linewidth=1)
        if self._limits is not None:
            axes.set_ylim(self._limits[0])
        self._mark_time(axes, "Strategies (thick), others' estimates (thin), equilibrium (dotted)")
        if game.num_players <= _NAMES:
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=5, fontsize="small", frameon=False)

    def _draw_distance(self, axes: Any) -> None:
        values = np.maximum(self._estimate_distances, distances.FLOOR)
        axes.semilogy(self.dynamics.clock.t[: len(values)], values, color="0.2")
        if self._limits is not None:
            axes.set_ylim(self._limits[1])
        self._mark_time(axes, "Relative distance of the estimates")

    def _mark_time(self, axes: Any, title: str) -> None:
        clock = self.dynamics.clock
        axes.axvline(clock.deadline, color="0.4", linewidth=1)
        axes.annotate(
            "T", (clock.deadline, 1), (-3, -3), ("data", "axes fraction"), "offset points", ha="right", va="top"
        )
        axes.set(xlim=(0, clock.t[-1]), xlabel="time t [s]")
        axes.set_title(title, fontsize="medium")

    def _draw_graph(self, axes: Any) -> None:
        players = self.dynamics.game.num_players
        angles = np.pi / 2 - 2 * np.pi * np.arange(players) / players
        x, y = np.cos(angles), np.sin(angles)
        live = set(self.dynamics.signal.graphs[self._mode].edges)
        for i, j in self.dynamics.signal.union.edges:
            style = {"color": "0.2", "linewidth": 2.5} if (i, j) in live else {"color": "0.75", "linestyle": ":"}
            axes.plot(x[[i, j]], y[[i, j]], zorder=1, **style)
        colours = [f"C{player % 10}" for player in range(players)]
        axes.scatter(x, y, s=200, color="white", edgecolor=colours, linewidth=1.8, zorder=2)
        if players <= 20:
            for player in range(players):
                axes.text(
                    x[player], y[player], str(player), ha="center", va="center_baseline", fontsize="small", zorder=3
                )
        axes.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.2, 1.3))
        axes.set_title("Live links", fontsize="medium")
        axes.axis("off")
