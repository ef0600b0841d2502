"""The paper's figures, drawn with matplotlib's object-oriented interface."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import networkx as nx
import numpy as np

from baselines.paper.continuous import Run
from baselines.paper.experiments import DEADLINE, DWELLS, GAIN, GAMMA, HOLD, KAPPA, Experiments
from ptne_env.shared.style import COLOURS, FAINT, INK, drawing
from ptne_env.world.clock import Exponential
from ptne_env.world.graphs import Graph, cycle
from ptne_env.world.switching import TopologyClock

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CLOCK_NAMES: dict[TopologyClock, str] = {
    "physical": f"dwell {DWELLS['physical']:g} s in $t$ (as in the paper)",
    "transformed": f"dwell {DWELLS['transformed']:g} in $s$",
}


@dataclass(frozen=True)
class FigureSpec:
    """A figure.

    Attributes:
        name: file name without extension.
        caption: the content, printed below the figure after its number.
        size: width and height in inches.
        draw: fills the figure.
    """

    name: str
    caption: str
    size: tuple[float, float]
    draw: Callable[[Figure, Experiments], None]


def draw(spec: FigureSpec, experiments: Experiments) -> bytes:
    """The figure with its caption as the bytes of an SVG file.

    Args:
        spec: an entry of :data:`FIGURES`.
        experiments: the runs.

    Raises:
        ImportError: naming the extra to install when matplotlib is missing.
    """
    width, height = spec.size
    lines = textwrap.wrap(f"Fig. {1 + FIGURES.index(spec)}. {spec.caption}", int(15.5 * width))
    band = 0.17 * len(lines) + 0.12  # inches for the caption below the axes
    share = band / (height + band)
    buffer = io.BytesIO()
    with drawing("figures", {"svg.fonttype": "none"}):
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        layout = ConstrainedLayoutEngine(rect=(0, share, 1, 1 - share), w_pad=0.09, h_pad=0.07)
        figure = Figure(figsize=(width, height + band), layout=layout)
        spec.draw(figure, experiments)
        place = 0.5, 0.08 / (height + band)
        figure.text(*place, "\n".join(lines), ha="center", va="bottom", color=INK, fontsize=8.5)
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


# --- shared by several figures --------------------------------------------------------------------------------------


def _strategies(axes: Axes, run: Run, end: float) -> None:
    """All estimates x^i_j over time: a colour per estimated player j, the player's own x_j thick."""
    t, estimates, equilibrium = run.timeline.t, run.estimates, run.game.nash_equilibrium
    for j in range(run.game.dimension):
        owner = int(run.game.owners[j])
        for i in range(run.game.num_players):
            if i != owner:
                axes.plot(t, estimates[:, i, j], color=COLOURS[j], linewidth=0.6, alpha=0.55)
        axes.plot(t, estimates[:, owner, j], color=COLOURS[j], linewidth=1.7, label=f"$j={j + 1}$")
        axes.plot([0, end], [equilibrium[j]] * 2, color=COLOURS[j], linestyle=(0, (1, 2)), linewidth=0.9)
    axes.set(xlabel="time $t$ [s]", ylabel="estimates $x^i_j$", xlim=(0, end))
    axes.legend(loc="upper center", ncols=5, columnspacing=1.0, handlelength=1.2, bbox_to_anchor=(0.5, 1.0))
    low, high = estimates.min(), estimates.max()
    axes.set_ylim(low - 0.06 * (high - low), high + 0.2 * (high - low))  # room for the legend above the curves


def _relative_errors(axes: Axes, run: Run, end: float, *, floor: float = 1e-13) -> None:
    t = run.timeline.t
    axes.semilogy(t, np.maximum(run.strategy_distance, floor), color=COLOURS[0], label=r"strategies $x$")
    estimates = np.maximum(run.estimate_distance, floor)
    axes.semilogy(t, estimates, "--", color=COLOURS[1], label=r"all estimates $\mathbf{x}$")
    axes.axhline(0.005, color=FAINT, linewidth=0.8, linestyle=":")
    axes.text(0.015 * end, 0.005 / 1.3, "0.5 %", color=FAINT, fontsize=7.5, va="top")
    axes.set(xlabel="time $t$ [s]", ylabel="relative error", xlim=(0, end))
    lowest = max(floor, float(run.strategy_distance.min()))
    axes.set_ylim(bottom=min(lowest, 0.005) / 30)  # room for the legend below the curves
    axes.minorticks_off()


def _mark_deadline(axes: Axes, top: float = 1.0) -> None:
    """A line at T, from the bottom up to the fraction ``top`` of the axes, below which a legend stays clear of it."""
    axes.axvline(DEADLINE, ymax=top, color=INK, linewidth=0.8)
    place: Any = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    axes.annotate("$T$", (DEADLINE, 0.0), xytext=(3, 4), fontsize=9, **place)


def _runs(figure: Figure, runs: Mapping[str, Run], end: float = DEADLINE + HOLD, *, deadline: bool = True) -> None:
    """A row per run, named by its key: (a) the estimates, (b) the relative errors."""
    grid: Any = figure.subplots(len(runs), 2, squeeze=False)
    for row, letters, (name, run) in zip(grid, ("ab", "cd"), runs.items(), strict=False):
        _strategies(row[0], run, end)
        _relative_errors(row[1], run, end)
        row[0].set_title(f"({letters[0]}) all players' estimates{name}")
        row[1].set_title(f"({letters[1]}) relative errors{name}")
        row[1].legend(loc="lower left" if deadline else "upper right")
        if deadline:
            _mark_deadline(row[0], top=0.88)
            _mark_deadline(row[1])


def _gains(axes: Axes, run: Run, title: str) -> None:
    for link, ((i, j), gain) in enumerate(zip(run.topology.union.edges, run.gains.T, strict=True)):
        axes.plot(run.timeline.t, gain, color=COLOURS[link], label=rf"$\kappa_{{{i + 1}{j + 1}}}$")
    axes.set(xlabel="time $t$ [s]", ylabel=r"gain $\kappa_{ij}$", xlim=(0, DEADLINE + HOLD))
    axes.set_ylim(0, 1.18 * float(run.gains.max()))  # room for the legend above the curves
    axes.set_title(title)
    axes.legend(loc="upper center", ncols=len(run.topology.union.edges), columnspacing=1.0, handlelength=1.2)
    _mark_deadline(axes, top=0.86)


def _draw_network(axes: Axes, graph: Graph, union: Graph) -> None:
    """The players on a circle, clockwise from the top; links of the union that are down are grey."""
    angles = np.pi / 2 - 2 * np.pi * np.arange(graph.num_players) / graph.num_players
    places = {i: np.array([np.cos(angle), np.sin(angle)]) for i, angle in enumerate(angles)}
    down = [edge for edge in union.edges if edge not in graph.edges]
    pair = nx.from_numpy_array(union.adjacency)
    nx.draw_networkx_edges(pair, places, edgelist=down, ax=axes, edge_color=FAINT, style="dotted", width=1.0)
    nx.draw_networkx_edges(pair, places, edgelist=graph.edges, ax=axes, edge_color=INK, width=1.8)
    nx.draw_networkx_nodes(pair, places, ax=axes, node_color=COLOURS[: graph.num_players], node_size=330)
    labels = {i: str(i + 1) for i in places}
    nx.draw_networkx_labels(pair, places, labels, ax=axes, font_size=10, font_color="white", font_weight="bold")
    axes.set_aspect("equal")
    axes.margins(0.18)
    axes.axis("off")


# --- the figures ----------------------------------------------------------------------------------------------------


def _time_transformation(figure: Figure, _: Experiments) -> None:
    s, transformation = np.linspace(0, 8, 400), Exponential(DEADLINE)
    left, right = figure.subplots(1, 2)
    left.plot(s, transformation.time(s), color=COLOURS[0])
    left.axhline(DEADLINE, color=INK, linewidth=0.8, linestyle=":")
    left.text(0.15, DEADLINE + 0.02, f"$T={DEADLINE:g}$ s", color=INK)
    left.set(xlabel="transformed time $s$", ylabel=r"$\lambda(s)$ [s]", ylim=(0, 1.35), xlim=(0, 8))
    left.set_title(r"(a) $t=\lambda(s)=T(1-e^{-s})$")
    right.plot(s, transformation.derivative(s), color=COLOURS[1])
    right.set(xlabel="transformed time $s$", ylabel=r"$\lambda'(s)$ [s]", ylim=(0, 1.35), xlim=(0, 8))
    right.set_title(r"(b) $\lambda'(s)=T e^{-s}$")


def _graph(figure: Figure, _: Experiments) -> None:
    graph = cycle(5)
    _draw_network(figure.subplots(), graph, graph)


def _comparison(figure: Figure, experiments: Experiments) -> None:
    runs = {
        r", Corollary 1 ($\kappa=10$)": experiments.corollary_one,
        r", Gadjov–Pavel ($\kappa=1$)": experiments.gadjov_pavel,
    }
    _runs(figure, runs, 30.0, deadline=False)
    offset: Any = {"xytext": (-6, -13), "textcoords": "offset points"}
    for axes, run in zip(figure.axes[1::2], runs.values(), strict=True):
        settled = run.settling_time()
        axes.set_ylim(1e-5, 10)
        if settled is not None:
            axes.plot(settled, 0.005, "o", color=INK, markersize=4)
            axes.annotate(f"{settled:.2f} s", (settled, 0.005), color=INK, ha="right", **offset)


def _switching_graphs(figure: Figure, experiments: Experiments) -> None:
    topology = experiments.switching["physical"].topology
    period, dwell = topology.period, topology.mode_dwells[0]
    for m, (axes, graph) in enumerate(zip(figure.subplots(1, 4), topology.graphs, strict=True)):
        _draw_network(axes, graph, topology.union)
        interval = f"[{m * dwell:.1f}, {(m + 1) * dwell:.1f})"
        axes.set_title(rf"$\mathcal{{G}}_{m + 1}$: $t$ mod {period:g} s in {interval}", fontsize=8.5)


def _by_clock(runs: Mapping[TopologyClock, Run]) -> dict[str, Run]:
    return {f", {_CLOCK_NAMES[clock]}": run for clock, run in runs.items()}


def _switching_gains(figure: Figure, experiments: Experiments) -> None:
    for axes, (clock, run) in zip(figure.subplots(1, 2), experiments.switching.items(), strict=True):
        _gains(axes, run, _CLOCK_NAMES[clock])


_STATIC = f"static law, κ = {KAPPA:g}, c = {GAIN:g}/s, T = {DEADLINE:g} s"
_READING = "Thick lines: the players' own strategies; thin: the estimates of others; dotted: the Nash equilibrium."
_ONE, _TWO = "One run from the paper's start.", "Two runs, one per row, from the paper's start."

FIGURES: tuple[FigureSpec, ...] = (
    FigureSpec(
        "time-transformation",
        "The time transformation λ and its derivative, drawn from their formulas, without a run.",
        (6.6, 2.5),
        _time_transformation,
    ),
    FigureSpec(
        "graph",
        "The fixed graph of the runs. The paper's drawing is not available; the 5-cycle is ours.",
        (2.7, 2.7),
        _graph,
    ),
    FigureSpec(
        "static",
        f"Example 1, {_STATIC}. {_ONE} {_READING}",
        (8.2, 3.3),
        lambda figure, experiments: _runs(figure, {"": experiments.static}),
    ),
    FigureSpec("corollary-one", f"Example 1 without the time gain. {_TWO} {_READING}", (8.2, 6.0), _comparison),
    FigureSpec(
        "adaptive",
        f"Example 1, adaptive law. {_ONE} {_READING}",
        (8.2, 3.3),
        lambda figure, experiments: _runs(figure, {"": experiments.adaptive}),
    ),
    FigureSpec(
        "adaptive-gains",
        "The gains of the adaptive law on the links of Example 1, in the run of Fig. 5.",
        (5.2, 3.0),
        lambda figure, experiments: _gains(
            figure.subplots(), experiments.adaptive, rf"fixed graph, $\gamma={GAMMA:g}$"
        ),
    ),
    FigureSpec(
        "switching-graphs",
        "The four modes of the topology of these runs, each disconnected, jointly connected. The paper's drawing "
        "is not available; these are our choice.",
        (8.2, 2.1),
        _switching_graphs,
    ),
    FigureSpec(
        "switching",
        "Example 1, adaptive law over switching graphs: with dwell times in t the error at T does not vanish. "
        f"{_TWO} {_READING}",
        (8.2, 6.2),
        lambda figure, experiments: _runs(figure, _by_clock(experiments.switching)),
    ),
    FigureSpec(
        "switching-gains",
        "The gains of the adaptive law over switching graphs, in the two runs of Fig. 8.",
        (8.2, 3.0),
        _switching_gains,
    ),
    FigureSpec(
        "non-quadratic",
        f"Example 2 (corrected), adaptive law over switching graphs. {_TWO} {_READING}",
        (8.2, 6.2),
        lambda figure, experiments: _runs(figure, _by_clock(experiments.non_quadratic_switching)),
    ),
)
"""All figures, in the order of the paper, which gives their numbers."""
