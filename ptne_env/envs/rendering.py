"""A picture of a running episode: estimates, distances and the live graph. Needs matplotlib, imported when drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env import distances, dynamics
from ptne_env.arrays import FloatArray
from ptne_env.dynamics import State
from ptne_env.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#c46a9b", "#b58900", "#2f93cf", "#8c6bb1", "#7f7f7f", "#a0522d", "#e7298a",
)  # fmt: skip
"""Of players, in turn, here and on pages: distinct for colour-blind readers, contrast 3:1 on white and on black."""

_SIZE, _DPI = (9.6, 5.4), 100
_LINES = 200
"""Others' estimates are drawn up to this many lines; beyond, the strategies alone."""
_NAMES = 10
"""Players are told apart by legend up to this many."""
_STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 11,
    "axes.edgecolor": "0.3",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "legend.frameon": False,
}


class Renderer:
    """Draws the episode so far.

    Args:
        world: the world.
        mode: ``"human"`` shows a window where the display has one, ``"rgb_array"`` returns the picture.
        title: what the headline begins with; the scenario's name if left out.
    """

    def __init__(self, world: World, mode: str, title: str | None = None) -> None:
        self.world = world
        self.title = world.scenario.name if title is None else title
        self.mode = mode
        self._estimates: list[FloatArray] = []
        self._estimate_distances: list[float] = []
        self._game = world.game
        self._mode = 0
        self._limits: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._figure: Figure | None = None
        self._artists: _Artists | None = None

    def foresee(self, states: Sequence[State]) -> None:
        """Give all pictures the axes that these states of an episode need, so that a film of them does not jump."""
        self._game = states[0].game
        self._limits = self._needed(
            np.array([state.estimates[:, :, 0] for state in states]),
            [float(distances.estimate_distance(state.estimates, state.game)[0]) for state in states],
        )

    def reset(self, state: State) -> None:
        """Forget the last episode and start with ``state``."""
        self._estimates.clear()
        self._estimate_distances.clear()
        self._game = state.game
        self._artists = None
        self.record(state)

    def record(self, state: State) -> None:
        """Add an instant."""
        self._estimates.append(state.estimates[:, :, 0])
        self._estimate_distances.append(float(distances.estimate_distance(state.estimates, self._game)[0]))
        self._mode = int(dynamics.active_mode(self.world, state)[0])

    def draw(self) -> npt.NDArray[np.uint8] | None:
        """The picture, (height, width, 3) uint8; ``None`` in mode ``human``, which shows it instead.

        Raises:
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        figure = self._open()
        from matplotlib import rc_context

        with rc_context(_STYLE):
            if self._artists is None:
                self._artists = self._build(figure)
            self._update(self._artists)
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
        self._figure = self._artists = None

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
                self._figure = plt.figure(figsize=_SIZE, dpi=_DPI)
            else:
                self._figure = Figure(figsize=_SIZE, dpi=_DPI)
                FigureCanvasAgg(self._figure)
        return self._figure

    def _needed(self, estimates: FloatArray, far: Sequence[float]) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of the two vertical axes: room for estimates and equilibrium, and a decade of distances at least."""
        values = np.concatenate([estimates.ravel(), self._game.nash_equilibria[:, 0]])
        values = values[np.isfinite(values)]
        margin = 0.05 * (values.max() - values.min()) or 1.0
        shown = np.array(far)[np.isfinite(far)]
        nearest = max(float(shown.min(initial=1.0)), distances.FLOOR)
        farthest = max(float(shown.max(initial=nearest)), 10 * nearest)
        return (float(values.min() - margin), float(values.max() + margin)), (nearest / 1.5, 1.5 * farthest)

    def _build(self, figure: Figure) -> _Artists:
        """Everything that does not change during an episode, and empty lines for what does."""
        figure.clear()
        axes = figure.subplot_mosaic(
            [["estimates", "distance"], ["estimates", "graph"]],
            width_ratios=[3, 2],
            height_ratios=[2, 3],
            gridspec_kw={"left": 0.07, "right": 0.975, "top": 0.86, "bottom": 0.17, "wspace": 0.24, "hspace": 0.5},
        )
        game, clock = self._game, self.world.clock
        own, others = [], []
        crowded = game.dimension * game.num_players > _LINES
        for component, owner in enumerate(game.owners):
            colour = COLOURS[owner % len(COLOURS)]
            axes["estimates"].axhline(game.nash_equilibria[component, 0], color=colour, linestyle=":", linewidth=1)
            if not crowded:
                thin: dict[str, Any] = {"color": colour, "linewidth": 0.7, "alpha": 0.5}
                others.append([axes["estimates"].plot([], [], **thin)[0] for _ in range(game.num_players - 1)])
            label = f"player {owner}" if component == game.offsets[owner] else None
            thick: dict[str, Any] = {"color": colour, "linewidth": 0.9 if crowded else 2.0, "label": label}
            own.append(axes["estimates"].plot([], [], marker="o", markevery=[-1], markersize=4, **thick)[0])
        reading = "lines: strategies" if crowded else "thick: strategies, thin: others' estimates"
        axes["estimates"].set_title(f"{reading}, dotted: equilibrium", loc="left")
        if game.num_players <= _NAMES:
            axes["estimates"].legend(
                loc="upper left", bbox_to_anchor=(-0.02, -0.11), ncols=5, columnspacing=1.2, handlelength=1.4
            )
        distance = axes["distance"].semilogy([], [], color="0.2", marker="o", markevery=[-1], markersize=4)[0]
        axes["distance"].set_title("relative distance of the estimates", loc="left")
        axes["distance"].minorticks_off()
        for each in (axes["estimates"], axes["distance"]):
            each.set(xlim=(0, clock.t[-1]), xlabel="time t [s]")
            each.axvline(clock.deadline, color="0.3", linewidth=1)
            each.annotate(
                "T", (clock.deadline, 1), (-4, -2), ("data", "axes fraction"), "offset points", ha="right", va="top"
            )
        links = self._build_graph(axes["graph"])
        title = figure.text(0.07, 0.945, "", fontsize=13, fontweight="bold")
        return _Artists(axes["estimates"], axes["distance"], title, own, others, distance, links)

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
        artists.distance.set_data(times, np.maximum(far, distances.FLOOR))
        values_limits, distance_limits = self._limits or self._needed(estimates, far)
        artists.values_axes.set_ylim(values_limits)
        artists.distance_axes.set_ylim(distance_limits)
        live = set(self.world.topology.graphs[self._mode].edges)
        width = min(2.5, 25 / self._game.num_players)
        for link, line in artists.links.items():
            up = link in live
            line.set(
                color="0.2" if up else "0.75", linestyle="-" if up else ":", linewidth=width if up else 0.6 * width
            )
        reached = f"error {far[-1]:.1e}" if far[-1] > distances.FLOOR else f"error below {distances.FLOOR:.0e}"
        artists.title.set_text(f"{self.title}    t = {times[-1]:.3f} s    {reached}")


@dataclass(frozen=True)
class _Artists:
    """What changes from picture to picture."""

    values_axes: Any
    distance_axes: Any
    title: Any
    own: list[Any]
    others: list[list[Any]]
    distance: Any
    links: dict[tuple[int, int], Any]
