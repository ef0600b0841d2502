"""A picture of a running episode: strategies, distances and the live graph. Needs matplotlib, imported when drawing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.dynamics import Dynamics, State

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE, _DPI = (9.6, 4.8), 100


class Renderer:
    """Draws the episode so far.

    Args:
        dynamics: the world.
        mode: ``"human"`` shows a window where the display has one, ``"rgb_array"`` returns the picture.
    """

    def __init__(self, dynamics: Dynamics, mode: str) -> None:
        self.dynamics = dynamics
        self.mode = mode
        self._strategies: list[FloatArray] = []
        self._estimate_distances: list[float] = []
        self._mode = 0
        self._figure: Figure | None = None

    def reset(self, state: State) -> None:
        """Forget the last episode and start with ``state``."""
        self._strategies.clear()
        self._estimate_distances.clear()
        self.record(state)

    def record(self, state: State) -> None:
        """Add an instant."""
        equilibrium = self.dynamics.game.nash_equilibrium
        self._strategies.append(self.dynamics.strategies(state)[:, 0])
        self._estimate_distances.append(float(distances.estimate_distance(state.estimates, equilibrium)[0]))
        self._mode = int(state.mode[0])

    def draw(self) -> npt.NDArray[np.uint8] | None:
        """The picture, (height, width, 3) uint8; ``None`` in mode ``human``, which shows it instead.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        figure = self._open()
        figure.clear()
        self._draw_strategies(figure.add_subplot(1, 2, 1))
        self._draw_distance(figure.add_subplot(2, 2, 2))
        self._draw_graph(figure.add_subplot(2, 2, 4))
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

    def _draw_strategies(self, axes: Any) -> None:
        game, clock = self.dynamics.game, self.dynamics.clock
        strategies = np.array(self._strategies)
        times = clock.t[: len(strategies)]
        for component, owner in enumerate(game.owners):
            colour = f"C{owner % 10}"
            first = component == game.offsets[owner]
            label = f"player {owner}" if first and game.num_players <= 10 else None
            axes.plot(times, strategies[:, component], color=colour, label=label)
            axes.axhline(game.nash_equilibrium[component], color=colour, linestyle=":", linewidth=1)
        axes.axvline(clock.deadline, color="0.4", linewidth=1)
        axes.set(
            xlim=(0, clock.t[-1]), xlabel="time t [s]", ylabel="strategy", title="Strategies and equilibrium (dotted)"
        )
        if game.num_players <= 10:
            axes.legend(loc="upper left", fontsize="small", framealpha=0.8)

    def _draw_distance(self, axes: Any) -> None:
        clock = self.dynamics.clock
        values = np.maximum(self._estimate_distances, distances.FLOOR)
        axes.semilogy(clock.t[: len(values)], values, color="C0")
        axes.axvline(clock.deadline, color="0.4", linewidth=1)
        axes.set(xlim=(0, clock.t[-1]), xlabel="time t [s]", title="Relative distance of the estimates")

    def _draw_graph(self, axes: Any) -> None:
        players = self.dynamics.game.num_players
        angles = np.pi / 2 - 2 * np.pi * np.arange(players) / players
        x, y = np.cos(angles), np.sin(angles)
        live = set(self.dynamics.signal.graphs[self._mode].edges)
        for i, j in self.dynamics.signal.union.edges:
            style = {"color": "C0", "linewidth": 2.5} if (i, j) in live else {"color": "0.8", "linewidth": 1}
            axes.plot(x[[i, j]], y[[i, j]], zorder=1, **style)
        axes.scatter(x, y, s=160, color="white", edgecolor="C0", zorder=2)
        if players <= 20:
            for player in range(players):
                axes.annotate(str(player), (x[player], y[player]), ha="center", va="center", fontsize="small", zorder=3)
        axes.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.3, 1.3), title="Live links")
        axes.axis("off")
