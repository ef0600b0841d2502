"""Tables of a suite's results: one per track, an overall one, and what a repetition of cells has shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from rich.console import Console, Group
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from ptne_env.experiments.benchmark import Repetition
from ptne_env.experiments.leaderboard import THRESHOLDS, Leaderboard, OverallRow, TrackRow
from ptne_env.experiments.statistics import Summary
from ptne_env.experiments.suite import LAW, Suite
from ptne_env.report.tables import empty_table, number, share

_METRICS = {
    "regret": "regret\nat T",
    "log_error_area": "mean\nlog10\nerror",
    "settled_share": "P(error\n≤ 0.5 %)",
    "diverged_share": "diverged",
    "messages": "messages",
    "bits": "bits",
}
_Column: TypeAlias = tuple[str, dict[str, Text | str]]
"""A heading, and the cell of each policy."""

_WIDE = 10_000
"""Columns of a terminal in which every table fits."""


def leaderboard_tables(board: Leaderboard, width: int = 172) -> Group:
    """A table per track, the best policy first; digits by policy and track; and the overall table.

    Args:
        board: of the suite.
        width: columns of the terminal; the last columns of a table are left out where they do not fit.
    """
    tables: list[Table | Text] = []
    left_out: list[str] = []
    for track in board.run.tracks:
        table, missing = _track_table(board, track.name, width)
        left_out += [heading for heading in missing if heading not in left_out]
        tables += [table, Text(track.change, style="dim"), *_not_applicable(board, track.name), Text()]
    tables += _digits_by_track(board, width)
    overall, missing = _overall(board, width)
    left_out += [heading for heading in missing if heading not in left_out]
    tables += overall
    tables.append(Text("* an oracle: it sees what no player can see, and has no rank", style="dim"))
    if left_out:
        told = f"Left out for want of width: {', '.join(left_out)}; results.json has everything."
        tables.append(Text(told, style="dim"))
    return Group(*tables)


def _name(board: Leaderboard, policy: str) -> str:
    return policy + " *" * board.run.participants[policy].is_oracle


def _track_table(board: Leaderboard, track: str, width: int) -> tuple[Table, list[str]]:
    metric = board.run.suite.track(track).metric
    by = "time to 1e-6" if track in board.saturated else metric.replace("_", " ")
    rows = [row for row in board.rows if row.track == track and row.metrics is not None]
    rows.sort(key=lambda row: row.rank or 0)

    def column(heading: str, cell: Callable[[TrackRow, dict[str, Summary]], Text | str]) -> _Column:
        return heading, {row.policy: cell(row, row.metrics or {}) for row in rows}

    metrics = {"digits": "digits"} if metric != "digits" else {}
    columns = [
        column("rank", lambda row, _: "" if row.rank is None else str(row.rank)),
        column(metric.replace("_", " "), lambda _, found: _text(found[metric])),
        column("score", lambda row, _: share(None if row.score is None else row.score.mean)),
        column(
            f"P(better\nthan {LAW})", lambda row, _: share(None if row.improvement is None else row.improvement.mean)
        ),
        column("time to\n1e-6 [s]", lambda row, _: number(row.fine_time)),
        *(
            column(heading, lambda _, found, name=name: number(found[name].mean))  # type: ignore[misc]
            for name, heading in (metrics | _METRICS).items()
        ),
        column("µs per\ndecision", lambda row, _: number(_microseconds(board, row))),
    ]
    title = f"{track}: {board.run.episodes} episodes, ranked by {by}"
    return _fitting(board, title, [row.policy for row in rows], columns, width)


def _fitting(
    board: Leaderboard, title: str, policies: Sequence[str], columns: Sequence[_Column], width: int
) -> tuple[Table, list[str]]:
    """A table with as many of ``columns`` as fit, two at least, and the headings of the others."""
    console = Console(width=_WIDE)
    for count in range(len(columns), 0, -1):
        table = empty_table(title)
        table.add_column("policy", no_wrap=True)
        for heading, _ in columns[:count]:
            table.add_column(Text(heading), justify="right", no_wrap=True)  # Text, because brackets are no markup
        for policy in policies:
            table.add_row(Text(_name(board, policy)), *(cells[policy] for _, cells in columns[:count]))
        if count <= 2 or Measurement.get(console, console.options, table).maximum <= width:
            break
    return table, [heading.replace("\n", " ") for heading, _ in columns[count:]]


def _not_applicable(board: Leaderboard, track: str) -> list[Text]:
    """Who cannot act on a track, by reason."""
    reasons: dict[str, list[str]] = {}
    for row in board.rows:
        if row.track == track and row.not_applicable is not None:
            reasons.setdefault(row.not_applicable, []).append(row.policy)
    return [Text(f"n/a: {', '.join(names)}: {reason}", style="dim") for reason, names in reasons.items()]


def _digits_by_track(board: Leaderboard, width: int) -> list[Table | Text]:
    """The score's metric of every policy on every track, some tracks per table."""
    policies = list(board.run.participants)
    columns: list[_Column] = []
    for track in board.run.tracks:
        found = {name: board.row(track.name, name).metrics for name in policies}
        cells: dict[str, Text | str] = {
            name: "n/a" if metrics is None else f"{metrics[track.metric].mean:.2f}" for name, metrics in found.items()
        }
        columns.append((track.name.replace("-", "-\n"), cells))
    tables: list[Table | Text] = []
    while columns:
        table, left = _fitting(board, "Digits by track", policies, columns, width)
        columns = columns[len(columns) - len(left) :]
        tables.append(table)
    return tables


def _overall(board: Leaderboard, width: int) -> tuple[list[Table | Text], list[str]]:
    if not board.overall:
        return [Text("No overall scores: there is no track that all can play and on which the law gains.")], []
    rows = {row.policy: row for row in board.overall}

    def column(heading: str, cell: Callable[[OverallRow], Text | str]) -> _Column:
        return heading, {name: cell(row) for name, row in rows.items()}

    columns = [
        column("score,\ninterquartile mean", lambda row: _text(row.score, share)),
        column("mean\nrank", lambda row: number(row.mean_rank)),
        column(f"P(better than {LAW})", lambda row: _text(row.improvement, share)),
        *(
            column(f"P(score\n> {level:g})", lambda row, level=level: share(row.profile[THRESHOLDS.index(level)]))  # type: ignore[misc]
            for level in (1.0, 2.0)
        ),
        column(f"unpaired P(better\nthan {LAW})", lambda row: share(row.unpaired_improvement)),
    ]
    title = f"{board.run.suite.name}, seed {board.run.seed}: overall"
    table, missing = _fitting(board, title, list(rows), columns, width)
    left_out = [track.name for track in board.run.tracks if track.name not in board.common]
    ranked = {row.policy for row in board.overall}
    special = [name for name in board.run.participants if name not in ranked]
    told = f"Over {len(board.common)} tracks that all can play and on which the law gains: {', '.join(board.common)}."
    if special:
        told += f" Without {', '.join(special)}, which can play fewer than half of the tracks."
    if left_out:
        told += f" Not over {', '.join(left_out)}."
    return [table, Text(told, style="dim")], missing


def _microseconds(board: Leaderboard, row: TrackRow) -> float:
    found = board.run.of(row.track, row.policy)
    return sum(measured.timings["microseconds_per_decision"] for measured in found) / len(found)


def _text(summary: Summary | None, format_: Callable[[float | None], str] = number) -> Text:
    if summary is None:
        return Text("–", justify="right")
    text = Text(format_(summary.mean), justify="right")
    if summary.low != summary.high:
        text.append(f" [{format_(summary.low)}, {format_(summary.high)}]", style="dim")
    return text


def _mean(summary: Summary | None) -> float | None:
    return None if summary is None else summary.mean


def repetition_table(repetitions: Sequence[Repetition], tolerance: float) -> Table:
    """Which cells were run again, and whether they reproduce."""
    table = empty_table("Cells that were run again")
    for column in ("track", "policy", "training seed", "largest difference", "verdict"):
        table.add_column(column, justify="right" if column == "largest difference" else "left")
    for one in repetitions:
        verdict = Text("reproduces", "green") if one.difference <= tolerance else Text("differs", "red")
        difference = number(one.difference)
        cell = one.cell
        table.add_row(cell.track.name, Text(cell.participant), str(cell.run), difference, verdict)
    return table


def suite_table(suite: Suite) -> Table:
    """The tracks of a suite."""
    table = empty_table(f"Suite {suite.name}, {suite.episodes} episodes per track")
    table.add_column("track", no_wrap=True)
    table.add_column("change from the base")
    for track in suite.tracks:
        table.add_row(track.name, track.change)
    return table
