"""Table I of the paper: settling times, measured and printed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from baselines.paper.experiments import DEADLINE, GAIN, KAPPA, Experiments
from ptne_env.shared.arrays import FloatArray
from ptne_env.theory import closed_loop_matrix
from ptne_env.world.graphs import Graph

PLAIN = {"Gadjov–Pavel": (1.0, 21.0), "Corollary 1": (10.0, 13.0)}
"""κ and the paper's time in seconds of the two algorithms without the time gain."""


@dataclass(frozen=True)
class TableRow:
    """One algorithm of Table I.

    Attributes:
        algorithm: its name.
        kappa: κ.
        gain: c in 1/s; 0 where there is no time gain.
        paper: the paper's time in seconds.
        ours: seconds until the relative error of the strategies stays within 0.5 %; ``None`` if it never does.
        at_paper_time: relative error of the strategies at the paper's time.
    """

    algorithm: str
    kappa: float
    gain: float
    paper: float
    ours: float | None
    at_paper_time: float


def table_one(experiments: Experiments) -> tuple[TableRow, ...]:
    """The three rows of Table I, on Example 1 and the 5-cycle (our choice; the paper's graph is not available)."""
    plain = zip(PLAIN.items(), (experiments.gadjov_pavel, experiments.corollary_one), strict=True)
    rows = [
        *((name, kappa, 0.0, paper, run) for (name, (kappa, paper)), run in plain),
        ("Proposed (Theorem 1)", KAPPA, GAIN, DEADLINE, experiments.static),
    ]
    return tuple(
        TableRow(name, kappa, gain, paper, run.settling_time(), run.strategy_distance_at(paper))
        for name, kappa, gain, paper, run in rows
    )


def labelled_graphs() -> tuple[Graph, ...]:
    """The 728 connected graphs on five labelled players, whose costs and starts differ."""
    pairs = np.array(list(itertools.combinations(range(5), 2)))
    graphs = []
    for chosen in itertools.product((False, True), repeat=len(pairs)):
        adjacency = np.zeros((5, 5))
        rows, columns = pairs[list(chosen)].T
        adjacency[rows, columns] = adjacency[columns, rows] = 1.0
        graphs.append(Graph(adjacency))
    return tuple(graph for graph in graphs if graph.is_connected)


def misfits(experiments: Experiments, graphs: Sequence[Graph], thresholds: FloatArray) -> FloatArray:
    """How far each graph is from the two times of Table I without the time gain, by the paper's own start and gains.

    Args:
        experiments: Example 1 and its start.
        graphs: on five players.
        thresholds: relative errors of the strategies that count as settled, shape (M,).

    Returns:
        The larger of the two relative deviations from 21 s and 13 s, at the threshold that suits the graph best, shape
        (len(graphs),); infinite for a graph that settles after 40 s at all of them.
    """
    step, instants = 0.05, 801
    game = experiments.energy
    own = (game.owners, np.arange(game.dimension))
    deviations = []
    for kappa, paper in PLAIN.values():
        propagators = linalg.expm(-step * np.stack([closed_loop_matrix(game, graph, kappa) for graph in graphs]))
        errors = np.tile((experiments.start - game.nash_equilibrium).reshape(1, -1, 1), (len(graphs), 1, 1))
        distances = np.empty((instants, len(graphs)))
        for k in range(instants):
            strategies = errors.reshape(len(graphs), game.num_players, -1)[:, *own]
            distances[k] = np.linalg.norm(strategies, axis=1) / game.equilibrium_scale[0]
            errors = propagators @ errors
        # The largest error from an instant on, from the last instant backwards: it increases, as interpolation asks.
        largest_later = np.log(np.maximum.accumulate(distances[::-1]))
        times = step * np.arange(instants)[::-1]
        settled = [np.interp(np.log(thresholds), later, times, left=np.inf) for later in largest_later.T]
        deviations.append(np.abs(np.array(settled) / paper - 1))
    return np.asarray(np.max(deviations, axis=0).min(axis=1))
