"""Tables of a suite's results: one per track, an overall one, and what a repetition of cells has shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite

from rich.console import Group
from rich.table import Table
from rich.text import Text

from ptne_env.evaluation.benchmark import Repetition
from ptne_env.evaluation.leaderboard import THRESHOLDS, Leaderboard, TrackRow
from ptne_env.evaluation.statistics import Summary
from ptne_env.evaluation.suite import LAW, Suite
from ptne_env.report.tables import empty_table, number

_METRICS = {
    "digits": "digits",
    "regret": "regret at T",
    "log_error_area": "mean log10 error",
    "settled_share": "P(error ≤ 0.5 %)",
    "messages": "messages",
    "bits": "bits",
    "diverged_share": "diverged",
}


def leaderboard_tables(board: Leaderboard) -> Group:
    """A table per track, the best policy first, and the overall table."""
    tables: list[Table | Text] = []
    for track in board.run.tracks:
        tables += [_track_table(board, track.name), Text(track.change, style="dim")]
        tables += [
            Text(f"{row.policy}: n/a, {row.not_applicable}", style="dim")
            for row in board.rows
            if row.track == track.name and row.not_applicable is not None
        ]
    tables += _overall(board)
    tables.append(Text("* an oracle: it sees what no player can see, and has no rank", style="dim"))
    return Group(*tables)


def _track_table(board: Leaderboard, track: str) -> Table:
    metric = board.run.suite.track(track).metric
    metrics = {metric: metric.replace("_", " ")} | {name: text for name, text in _METRICS.items() if name != metric}
    by = "time to 1e-6" if track in board.saturated else metric.replace("_", " ")
    table = empty_table(f"{track}: {board.run.episodes} episodes, ranked by {by}")
    table.add_column("rank", justify="right")
    table.add_column("policy", no_wrap=True)
    columns = ["score", f"P(better than {LAW})", *metrics.values(), "time to 1e-6 [s]", "µs per decision"]
    for column in columns:
        table.add_column(Text(column), justify="right")  # Text, because brackets are no markup
    rows = [row for row in board.rows if row.track == track]
    for row in sorted(rows, key=lambda row: (row.metrics is None, row.rank or 0)):
        rank = "" if row.rank is None else str(row.rank)
        name = row.policy + " *" * board.run.participants[row.policy].is_oracle
        if row.metrics is None:
            table.add_row(rank, Text(name), *["n/a"] * len(columns))
            continue
        values = [_text(row.score, _share), _text(row.improvement, _share), _text(row.metrics[metric])]
        values += [Text(number(row.metrics[name].mean)) for name in metrics if name != metric]
        table.add_row(rank, Text(name), *values, number(row.fine_time), number(_microseconds(board, row)))
    return table


def _overall(board: Leaderboard) -> list[Table | Text]:
    if not board.overall:
        return [Text("No overall scores: there is no track that all can play and on which the law gains.")]
    table = empty_table(f"{board.run.suite.name}, seed {board.run.seed}: overall")
    table.add_column("policy", no_wrap=True)
    for column in (
        "score, interquartile mean",
        f"P(better than {LAW})",
        "unpaired",
        "mean rank",
        "P(score > 1)",
        "P(score > 2)",
    ):
        table.add_column(column, justify="right")
    profile = [THRESHOLDS.index(level) for level in (1.0, 2.0)]
    for row in board.overall:
        name = row.policy + " *" * board.run.participants[row.policy].is_oracle
        shares = (_share(row.profile[index]) for index in profile)
        rank = number(row.mean_rank)
        table.add_row(
            Text(name),
            _text(row.score, _share),
            _text(row.improvement, _share),
            _share(row.unpaired_improvement),
            rank,
            *shares,
        )
    left_out = [track.name for track in board.run.tracks if track.name not in board.common]
    told = f"Over {len(board.common)} tracks that all can play and on which the law gains: {', '.join(board.common)}."
    if left_out:
        told += f" Not over {', '.join(left_out)}."
    return [table, Text(told, style="dim")]


def _microseconds(board: Leaderboard, row: TrackRow) -> float:
    found = board.run.of(row.track, row.policy)
    return sum(measured.timings["microseconds_per_decision"] for measured in found) / len(found)


def _text(summary: Summary | None, format_: Callable[[float | None], str] = number) -> Text:
    if summary is None:
        return Text("–", justify="right")
    text = Text(format_(summary.mean), justify="right")
    if summary.low != summary.high:
        text.append(f"\n[{format_(summary.low)}, {format_(summary.high)}]", style="dim")
    return text


def _share(value: float | None) -> str:
    """Scores and probabilities, whose zero is a matter of rounding."""
    return "–" if value is None else f"{value + 0.0:.3f}".replace("-0.000", "0.000")


def repetition_table(repetitions: Sequence[Repetition], tolerance: float) -> Table:
    """Which cells were run again, and whether they reproduce."""
    table = empty_table("Cells that were run again")
    for column in ("track", "policy", "training seed", "largest difference", "verdict"):
        table.add_column(column, justify="right" if column == "largest difference" else "left")
    for one in repetitions:
        verdict = Text("reproduces", "green") if one.difference <= tolerance else Text("differs", "red")
        difference = number(one.difference) if isfinite(one.difference) else "∞"
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
