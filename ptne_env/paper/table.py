"""Table 1 of the paper: settling times, measured and printed."""

from __future__ import annotations

from dataclasses import dataclass

from ptne_env.paper.experiments import DEADLINE, GAIN, KAPPA, Experiments


@dataclass(frozen=True)
class TableRow:
    """One algorithm of Table 1.

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
    """The three rows of Table 1, on Example 1 and the 5-cycle (our choice; the paper's graph is not available)."""
    rows = [
        ("Gadjov–Pavel", 1.0, 0.0, 21.0, experiments.gadjov_pavel),
        ("Corollary 1", 10.0, 0.0, 13.0, experiments.corollary_one),
        ("Proposed (Theorem 1)", KAPPA, GAIN, DEADLINE, experiments.static),
    ]
    return tuple(
        TableRow(name, kappa, gain, paper, run.settling_time(), run.strategy_distance_at(paper))
        for name, kappa, gain, paper, run in rows
    )
