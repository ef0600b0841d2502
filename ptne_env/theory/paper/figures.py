"""The paper's figures and two figures of errata, drawn with matplotlib's object-oriented interface."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import networkx as nx
import numpy as np

from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.style import COLOURS, FAINT, INK, drawing
from ptne_env.theory.paper.continuous import Run
from ptne_env.theory.paper.experiments import DEADLINE, DWELLS, GAIN, GAMMA, HOLD, KAPPA, Experiments
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
        number: of the paper's figure as printed, ``"Fig. 1"``, or of the erratum.
        original: the paper's caption; empty where the figure is ours.
        claims: names of the claims that the figure illustrates.
    """

    name: str
    caption: str
    size: tuple[float, float]
    draw: Callable[[Figure, Experiments], None]
    number: str
    original: str = ""
    claims: tuple[str, ...] = ()


def draw(spec: FigureSpec, experiments: Experiments, kind: Literal["png", "svg"]) -> bytes:
    """The figure with its caption as the bytes of a file.

    Args:
        spec: an entry of :data:`FIGURES`.
        experiments: the runs.
        kind: ``"png"`` (200 dots per inch) or ``"svg"``.

    Raises:
        ImportError: naming the extra to install when matplotlib is missing.
    """
    width, height = spec.size
    caption = f"The paper's {spec.number}. {spec.caption}" if spec.original else f"{spec.number}. {spec.caption}"
    lines = textwrap.wrap(caption, int(15.5 * width))
    band = 0.17 * len(lines) + 0.12  # inches for the caption below the axes
    options: dict[str, Any] = {"dpi": 200} if kind == "png" else {"metadata": {"Date": None}}
    buffer = io.BytesIO()
    with drawing("figures", {"svg.fonttype": "none"}):
        figure = _drawn(spec, experiments, band)
        place = 0.5, 0.08 / (height + band)
        figure.text(*place, "\n".join(lines), ha="center", va="bottom", color=INK, fontsize=8.5)
        figure.savefig(buffer, format=kind, **options)
    return buffer.getvalue()


def _drawn(spec: FigureSpec, experiments: Experiments, band: float) -> Figure:
    """The figure above ``band`` inches of free space."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    width, height = spec.size
    share = band / (height + band)
    layout = ConstrainedLayoutEngine(rect=(0, share, 1, 1 - share), w_pad=0.09, h_pad=0.07)
    figure = Figure(figsize=(width, height + band), layout=layout)
    FigureCanvasAgg(figure)
    spec.draw(figure, experiments)
    return figure


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


def draw_network(axes: Axes, graph: Graph, union: Graph, first: int = 0) -> None:
    """The players on a circle, clockwise from the top; links of the union that are down are grey.

    Args:
        axes: to draw in.
        graph: the links that are up.
        union: all links.
        first: number of the first player: 0 as in the names of agents, 1 as in the paper.
    """
    angles = np.pi / 2 - 2 * np.pi * np.arange(graph.num_players) / graph.num_players
    places = {i: np.array([np.cos(angle), np.sin(angle)]) for i, angle in enumerate(angles)}
    down = [edge for edge in union.edges if edge not in graph.edges]
    pair = union.to_networkx()
    nx.draw_networkx_edges(pair, places, edgelist=down, ax=axes, edge_color=FAINT, style="dotted", width=1.0)
    nx.draw_networkx_edges(pair, places, edgelist=graph.edges, ax=axes, edge_color=INK, width=1.8)
    nx.draw_networkx_nodes(pair, places, ax=axes, node_color=COLOURS[: graph.num_players], node_size=330)
    labels = {i: str(i + first) for i in places}
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
    from matplotlib.colors import to_rgba

    left, right = figure.subplots(1, 2)
    graph = cycle(5)
    draw_network(left, graph, graph, first=1)
    left.set_title(r"(a) fixed graph $\mathcal{G}$")
    laplacian = graph.laplacian
    cells = np.array([to_rgba(COLOURS[0], 0.25), (0, 0, 0, 0), to_rgba(COLOURS[1], 0.45)])  # on a light or a dark page
    right.imshow(cells[np.sign(laplacian).astype(int) + 1])
    for (i, j), value in np.ndenumerate(laplacian):
        right.text(j, i, f"{value:.0f}".replace("-", "−"), ha="center", va="center", color=INK, fontsize=10)
    right.set_xticks(range(5), [str(i + 1) for i in range(5)])
    right.set_yticks(range(5), [str(i + 1) for i in range(5)])
    right.tick_params(length=0)
    right.grid(visible=False)
    right.spines[:].set_visible(False)
    right.set_title(rf"(b) Laplacian $\mathcal{{L}}$, $\lambda_2={graph.algebraic_connectivity:.3f}$")


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
    period, dwell = topology.period, topology.dwells[0]
    for m, (axes, graph) in enumerate(zip(figure.subplots(1, 4), topology.graphs, strict=True)):
        draw_network(axes, graph, topology.union, first=1)
        interval = f"[{m * dwell:.1f}, {(m + 1) * dwell:.1f})"
        axes.set_title(rf"$\mathcal{{G}}_{m + 1}$: $t$ mod {period:g} s in {interval}", fontsize=8.5)


def _by_clock(runs: Mapping[TopologyClock, Run]) -> dict[str, Run]:
    return {f", {_CLOCK_NAMES[clock]}": run for clock, run in runs.items()}


def _switching_gains(figure: Figure, experiments: Experiments) -> None:
    for axes, (clock, run) in zip(figure.subplots(1, 2), experiments.switching.items(), strict=True):
        _gains(axes, run, _CLOCK_NAMES[clock])


def _erratum_2(figure: Figure, experiments: Experiments) -> None:
    axes, runs = figure.subplots(), experiments.by_period
    errors = [run.estimate_distance[-1] for run in runs.values()]
    axes.loglog(list(runs), errors, "o-", color=COLOURS[1], label="topology dwells in $t$, period Γ")
    transformed = experiments.switching["transformed"]
    error = float(transformed.estimate_distance[transformed.timeline.deadline_index])
    axes.axhline(error, color=COLOURS[0], linestyle="--", label="topology dwells 0.25 in $s$")
    axes.set(xlabel="period Γ of the topology in $t$ [s]", ylabel="relative error of the estimates at $T$")
    axes.set_xticks(list(runs), [f"{period:g}" for period in runs])
    axes.minorticks_off()
    axes.set_ylim(1e-8, 10)
    axes.legend(loc="center right")


def _erratum_3(figure: Figure, experiments: Experiments) -> None:
    run = experiments.static_exact
    # T − t = T e^{−s} is exact where T − t itself has long been rounded away.
    upto = slice(0, int(np.searchsorted(run.timeline.s, 20.0)))
    s = run.timeline.s[upto]
    remaining: FloatArray = experiments.transformation.derivative(s)
    inputs = np.linalg.norm(run.inputs[upto], axis=(1, 2))
    axes = figure.subplots()
    axes.loglog(remaining, inputs, color=COLOURS[0], label=r"$\Vert \mathbf{u}\Vert$")
    velocities = (GAIN + 1 / remaining) * inputs
    axes.loglog(remaining, velocities, "--", color=COLOURS[1], label=r"$\Vert g\,\mathbf{u}\Vert$, the velocity")
    axes.invert_xaxis()
    axes.set(xlabel="time left $T-t$ [s]", ylabel="norm over all players")
    axes.minorticks_off()
    axes.legend(loc="upper center")


_STATIC = f"static law, κ = {KAPPA:g}, c = {GAIN:g}/s, T = {DEADLINE:g} s"
_READING = "Thick lines: the players' own strategies; thin: the estimates of others; dotted: the Nash equilibrium."
_ONE, _TWO = "One run from the paper's start.", "Two runs, one per row, from the paper's start."

_SIMULATED = (
    "Simulated results of the proposed {}algorithm in ({}): (a) all players' estimated strategies x^i_j(t), i, j ∈ V; "
)
_GAINS_OF = "The plot of all players' dynamic gain κ_ij(t), i, j ∈ V generated by ({})."
_RELATIVE = "and (b) relative errors of all players' actions."
_SWITCHING_CLAIMS = "Theorem 4, dwelling in t (as stated)", "Theorem 4, dwelling in s"

FIGURES: tuple[FigureSpec, ...] = (
    FigureSpec(
        "time-transformation",
        "The time transformation λ and its derivative, drawn from their formulas, without a run.",
        (6.6, 2.5),
        _time_transformation,
        "Fig. 1",
        "The illustration of the time transformation function λ(s) and λ'(s).",
        ("Lemma 1",),
    ),
    FigureSpec(
        "graph",
        "The fixed graph of the runs and its Laplacian. The paper's drawing is not available; the 5-cycle is ours.",
        (6.0, 2.7),
        _graph,
        "Fig. 2",
        "The communication network for a group of five players in the game: (a) fixed graph G; (b) Laplacian matrix L.",
        ("Proposition 1", "Erratum 4, the gain of the simulations"),
    ),
    FigureSpec(
        "static",
        f"Example 1, {_STATIC}. {_ONE} {_READING}",
        (8.2, 3.3),
        lambda figure, experiments: _runs(figure, {"": experiments.static}),
        "Fig. 3",
        _SIMULATED.format("prescribed-time NE seeking ", 10) + "and (b) relative errors.",
        ("Theorem 1", "Theorem 2, hold", "Theorem 2, boundedness of u"),
    ),
    FigureSpec(
        "corollary-one",
        f"Example 1 without the time gain. {_TWO} {_READING}",
        (8.2, 6.0),
        _comparison,
        "Fig. 4",
        "Simulated results of the algorithms in Corollary 1 and of Gadjov and Pavel, respectively.",
        ("Corollary 1", "Erratum 5a, Corollary 1's coupling", "Erratum 5b, Corollary 1's assumptions"),
    ),
    FigureSpec(
        "adaptive",
        f"Example 1, adaptive law. {_ONE} {_READING}",
        (8.2, 3.3),
        lambda figure, experiments: _runs(figure, {"": experiments.adaptive}),
        "Fig. 5",
        _SIMULATED.format("", 36) + _RELATIVE,
        ("Theorem 3",),
    ),
    FigureSpec(
        "adaptive-gains",
        "The gains of the adaptive law on the links of Example 1, in the run of Fig. 5.",
        (5.2, 3.0),
        lambda figure, experiments: _gains(
            figure.subplots(), experiments.adaptive, rf"fixed graph, $\gamma={GAMMA:g}$"
        ),
        "Fig. 6",
        _GAINS_OF.format(36),
        ("Theorem 3",),
    ),
    FigureSpec(
        "switching-graphs",
        "The four modes of the topology of these runs, each disconnected, jointly connected. The paper's drawing "
        "is not available; these are our choice.",
        (8.2, 2.1),
        _switching_graphs,
        "Fig. 7",
        "The jointly switching topologies G_i with P = {1, 2, 3, 4}.",
        _SWITCHING_CLAIMS,
    ),
    FigureSpec(
        "switching",
        "Example 1, adaptive law over switching graphs: with dwell times in t the error at T does not vanish. "
        f"{_TWO} {_READING}",
        (8.2, 6.2),
        lambda figure, experiments: _runs(figure, _by_clock(experiments.switching)),
        "Fig. 8",
        _SIMULATED.format("", 47) + _RELATIVE,
        (*_SWITCHING_CLAIMS, "Erratum 2, switching in t"),
    ),
    FigureSpec(
        "switching-gains",
        "The gains of the adaptive law over switching graphs, in the two runs of Fig. 8.",
        (8.2, 3.0),
        _switching_gains,
        "Fig. 9",
        _GAINS_OF.format(47),
        (*_SWITCHING_CLAIMS, "Erratum 5c, the switching law after T"),
    ),
    FigureSpec(
        "non-quadratic",
        f"Example 2 (corrected), adaptive law over switching graphs. {_TWO} {_READING}",
        (8.2, 6.2),
        lambda figure, experiments: _runs(figure, _by_clock(experiments.non_quadratic_switching)),
        "Fig. 10",
        _SIMULATED.format("", 47) + _RELATIVE,
        ("Erratum 1, equilibrium of Example 2", "Erratum 1, assumptions of Example 2"),
    ),
    FigureSpec(
        "erratum-2",
        "The error at T when the topology dwells in t, against its period: a run per point. Not in the paper.",
        (5.2, 3.2),
        _erratum_2,
        "Erratum 2",
        claims=("Erratum 2, switching in t",),
    ),
    FigureSpec(
        "erratum-3",
        f"Input and velocity near T, Example 1, {_STATIC}. One run. Not in the paper.",
        (5.2, 3.2),
        _erratum_3,
        "Erratum 3",
        claims=(
            "Erratum 3, velocity near T",
            "Theorem 2, smoothness of u",
            "Theorem 2, boundedness of the plant's input",
        ),
    ),
)
"""All figures, in the order of the paper; the last two are ours."""
