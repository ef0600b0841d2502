"""Leaderboards, tables in Markdown, and the command-line options that the scripts share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, TypeAlias

import typer

from ptne_env.evaluation import Results
from ptne_env.evaluation.leaderboard import Leaderboard
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.statistics import Summary

Jobs: TypeAlias = Annotated[int, typer.Option(help="Tasks at a time; each takes one core.")]
Ray: TypeAlias = Annotated[str | None, typer.Option(help="Address of a Ray cluster, such as auto or HOST:6379.")]


def board_of(results: Results) -> Leaderboard:
    """The leaderboard of a suite.

    Raises:
        ValueError: for a comparison, which has none.
    """
    if results.leaderboard is None:
        raise ValueError(f"{results.suite.name} is a comparison: it has no scores")
    return results.leaderboard


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, texts: Sequence[str] = ("policy",)) -> list[str]:
    """The lines of a table.

    Args:
        headings: of the columns.
        rows: a text per column.
        texts: headings of the columns of texts, which are aligned to the left; numbers are aligned to the right.
    """
    rules = ["---" if heading in texts else "---:" for heading in headings]
    return [f"| {' | '.join(cells)} |" for cells in (headings, rules, *rows)]


def interval(summary: Summary | None) -> str:
    """A mean with its 95 % interval where the sample varies; empty without a summary, a dash without a value."""
    if summary is None:
        return ""
    if summary.low == summary.high:
        return number(summary.mean)
    return f"{number(summary.mean)} [{number(summary.low)}, {number(summary.high)}]"
