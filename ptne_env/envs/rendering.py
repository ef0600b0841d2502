"""Pictures of a running episode: estimates, distances and the live graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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

_MOST_LINES = 200
"""Estimates by other players are drawn up to this many lines; beyond it, the strategies alone."""

_MOST_NAMES = 10
"""The legend names up to this many players."""


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
        self._estimates: list[FloatArray] = []
        self._estimate_distances: list[float] = []
        self._equilibria: list[FloatArray] = []
        self._game = world.game
        self._mode = 0
        self._limits: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._figure: Figure | None = None
        self._artists: _Artists | None = None

    def fix_axes(self, states: Sequence[State]) -> None:
        """Give every picture the axes that ``states``, the whole episode, need: in a video the axes stand still."""
        self._game = states[0].game
        self._limits = self._needed(
            np.array([state.estimates[:, :, 0] for state in states]),
            [state.game.nash_equilibria[:, 0] for state in states],
            [float(distances.estimate_distance(state.estimates, state.game)[0]) for state in states],
        )

    def reset(self, state: State) -> None:
        """Forget the last episode and start with ``state``."""
        self._estimates.clear()
        self._estimate_distances.clear()
        self._equilibria.clear()
        self._game = state.game
        self._artists = None
        self.record(state)

    def record(self, state: State) -> None:
        """Add an instant."""
        self._estimates.append(state.estimates[:, :, 0])
        self._estimate_distances.append(float(distances.estimate_distance(state.estimates, state.game)[0]))
        self._equilibria.append(state.game.nash_equilibria[:, 0])
        self._mode = int(dynamics.active_mode(self.world, state)[0])

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
        """The figure of the episode so far, for a caller that draws it.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        with drawing("pictures of episodes", _STYLE):
            if self._figure is None:
                self._figure = self._open()
            if self._artists is None:
                self._artists = self._build(self._figure)
            self._update(self._artists)
        return self._figure

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None and self.mode == "human":
            from matplotlib import pyplot as plt

            plt.close(self._figure)
        self._figure = self._artists = None

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

    def _needed(
        self, estimates: FloatArray, equilibria: Sequence[FloatArray], far: Sequence[float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of the two vertical axes: room for estimates and equilibria, and a decade of distances at least."""
        values = np.concatenate([estimates.ravel(), *equilibria])
        values = values[np.isfinite(values)]
        margin = 0.05 * (values.max() - values.min()) or 1.0
        shown = np.array(far)[np.isfinite(far)]
        nearest = max(float(shown.min(initial=1.0)), distances.FLOOR)
        farthest = max(float(shown.max(initial=nearest)), 10 * nearest)
        return (float(values.min() - margin), float(values.max() + margin)), (nearest / 1.5, 1.5 * farthest)

    def _build(self, figure: Figure) -> _Artists:
        """The parts that do not change during an episode, and empty lines for those that do."""
        figure.clear()
        axes = figure.subplot_mosaic(
            [["estimates", "distance"], ["estimates", "graph"]],
            width_ratios=[3, 2],
            height_ratios=[2, 3],
            gridspec_kw={"left": 0.07, "right": 0.975, "top": 0.86, "bottom": 0.17, "wspace": 0.24, "hspace": 0.5},
        )
        game, clock = self._game, self.world.clock
        own, others, targets = [], [], []
        crowded = game.dimension * game.num_players > _MOST_LINES
        for component, owner in enumerate(game.owners):
            colour = COLOURS[owner % len(COLOURS)]
            targets.append(axes["estimates"].plot([], [], color=colour, linestyle=":", linewidth=1)[0])
            if not crowded:
                thin: dict[str, Any] = {"color": colour, "linewidth": 0.7, "alpha": 0.5}
                others.append([axes["estimates"].plot([], [], **thin)[0] for _ in range(game.num_players - 1)])
            label = f"player_{owner}" if component == game.offsets[owner] else None
            thick: dict[str, Any] = {"color": colour, "linewidth": 0.9 if crowded else 2.0, "label": label}
            own.append(axes["estimates"].plot([], [], marker="o", markevery=[-1], markersize=4, **thick)[0])
        reading = "lines: strategies" if crowded else "thick: strategies, thin: others' estimates"
        axes["estimates"].set_title(f"{reading}, dotted: equilibrium", loc="left")
        if game.num_players <= _MOST_NAMES:
            axes["estimates"].legend(
                loc="upper left", bbox_to_anchor=(-0.02, -0.11), ncols=5, columnspacing=1.2, handlelength=1.4
            )
        distance = axes["distance"].semilogy([], [], color=INK, marker="o", markevery=[-1], markersize=4)[0]
        axes["distance"].set_title("relative distance of the estimates", loc="left")
        axes["distance"].minorticks_off()
        for each in (axes["estimates"], axes["distance"]):
            each.set(xlim=(0, clock.t[-1]), xlabel="time t [s]")
            each.axvline(clock.deadline, color=FAINT, linewidth=1)
            each.annotate(
                "T", (clock.deadline, 1), (-4, -2), ("data", "axes fraction"), "offset points", ha="right", va="top"
            )
        links = self._build_graph(axes["graph"])
        title = figure.text(0.07, 0.945, "", fontsize=13, fontweight="bold")
        return _Artists(axes["estimates"], axes["distance"], title, own, others, targets, distance, links)

    def _build_graph(self, axes: Any) -> dict[tuple[int, int], Any]:
        players = self.world.game.num_players
        angles = np.pi / 2 - 2 * np.pi * np.arange(players) / players
        x, y = np.cos(angles), np.sin(angles)
        links = {(i, j): axes.plot(x[[i, j]], y[[i, j]], zorder=1)[0] for i, j in self.world.topology.union.edges}
        colours = [COLOURS[player % len(COLOURS)] for player in range(players)]
        size = min(16.0, 220 / players)  # of a node, in points, so that neighbours on the circle do not touch
        axes.scatter(x, y, s=size**2, color="white", edgecolor=colours, linewidth=min(1.8, size / 4), zorder=2)
        if players <= 14:
            for player in range(players):
                axes.text(
                    x[player], y[player], str(player), ha="center", va="center_baseline", fontsize="small", zorder=3
                )
        axes.set(aspect="equal", xlim=(-1.4, 1.4), ylim=(-1.15, 1.15))
        axes.set_title("live links")
        axes.axis("off")
        return links

    def _update(self, artists: _Artists) -> None:
        estimates, far = np.array(self._estimates), self._estimate_distances
        times = self.world.clock.t[: len(estimates)]
        for component, (owner, line) in enumerate(zip(self._game.owners, artists.own, strict=True)):
            line.set_data(times, estimates[:, component, owner])
            if artists.others:
                rest = np.delete(estimates[:, component], owner, axis=1)
                for other, values in zip(artists.others[component], rest.T, strict=True):
                    other.set_data(times, values)
        for target, value in zip(artists.targets, self._equilibria[0], strict=True):
            target.set_data(self.world.clock.t[[0, -1]], [value, value])
        artists.distance.set_data(times, np.maximum(far, distances.FLOOR))
        values_limits, distance_limits = self._limits or self._needed(estimates, self._equilibria, far)
        artists.values_axes.set_ylim(values_limits)
        artists.distance_axes.set_ylim(distance_limits)
        live = set(self.world.topology.graphs[self._mode].edges)
        width = min(2.5, 25 / self._game.num_players)
        for link, line in artists.links.items():
            up = link in live
            line.set(color=INK if up else FAINT, linestyle="-" if up else ":", linewidth=width if up else 0.6 * width)
        reached = f"error {far[-1]:.1e}" if far[-1] > distances.FLOOR else f"error below {distances.FLOOR:.0e}"
        artists.title.set_text(f"{self.title}    t = {times[-1]:.3f} s    {reached}")


@dataclass(frozen=True)
class _Artists:
    """The parts of the figure that change from picture to picture."""

    values_axes: Any
    distance_axes: Any
    title: Any
    own: list[Any]
    others: list[list[Any]]
    targets: list[Any]
    distance: Any
    links: dict[tuple[int, int], Any]
