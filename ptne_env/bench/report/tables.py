"""Tables of results: columns, rows and values, for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from ptne_env.evaluation.leaderboard import TrackRow
from ptne_env.evaluation.metrics import METRICS, number, share
from ptne_env.evaluation.policy_specs import DIVISIONS, PolicySpec
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.evaluation.suite import LAW, Track

Row = TypeVar("Row")

FIRST_MARGIN = 0.1
"""A policy whose interval comes within this many digits of the best mean of a track shares the first place there."""

_MOST_NAMED = 3
"""Tracks of a specialist that a cell names; of more, it says how many."""

_COMPLETE, _SPECIALISTS = "entries that play every track", "specialists"
"""Words for entries with values on every track, and for all others."""

_PERCENT = "\N{NO-BREAK SPACE}%"

MARKS = {"honest": "", "oracle": "*"}
"""The marks of policies by division."""

MARK_NOTES = {
    "oracle": "* an oracle: it uses information that players lack, and has no rank",
}
"""The meaning of the marks by division."""

_SCORE = "0 is zero input; 1 is 12 digits"


def decimals(value: float | None) -> str:
    """Digits with two decimals; a dash where there are none."""
    return "–" if value is None else f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")


@dataclass(frozen=True)
class Value:
    """A cell of a table.

    Attributes:
        text: as it is shown.
        value: by which the column is sorted; a cell without one comes last.
        interval: the 95 % interval, as it is shown; empty where both ends look the same.
    """

    text: str = "–"
    value: float | None = None
    interval: str = ""

    @classmethod
    def of(cls, quantity: Summary | float | None, write: Callable[[float | None], str] = number) -> Value:
        """The cell of a summary, or of a number without an interval.

        Args:
            quantity: ``None`` where there is none.
            write: makes the text of a number.
        """
        summary = quantity if isinstance(quantity, Summary) else Summary(quantity, quantity, quantity)
        if summary.mean is None:
            return cls()
        low, high = write(summary.low), write(summary.high)
        return cls(write(summary.mean), summary.mean, "" if low == high else f"[{low}, {high}]")

    @classmethod
    def plus_minus(cls, summary: Summary | None) -> Value:
        """The cell of digits: the mean with two decimals, ± half of its interval."""
        if summary is None or summary.mean is None or summary.high is None:
            return cls()
        half, text = decimals(summary.high - summary.mean), decimals(summary.mean)
        return cls(text if half == "0.00" else f"{text} ±{half}", summary.mean)

    @classmethod
    def count(cls, number: int | None) -> Value:
        """The cell of a whole number."""
        return cls() if number is None else cls(str(number), number)

    def __str__(self) -> str:
        return f"{self.text} {self.interval}".rstrip()


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        label: the heading.
        meaning: of the values, in a phrase.
        values: by name of the row.
        descending: whether large values are good, so that the first click on the heading puts them first.
    """

    label: str
    meaning: str
    values: Mapping[str, Value]
    descending: bool = False

    def __getitem__(self, name: str) -> Value:
        """The value of a row; a dash where it has none."""
        return self.values.get(name, Value())

    @property
    def is_filled(self) -> bool:
        """Whether any row has a value."""
        return any(value.value is not None for value in self.values.values())


@dataclass(frozen=True)
class Table:
    """A table with a row per policy, honest entries first, then coded ones, then oracles; or a row per track.

    Attributes:
        caption: the title.
        columns: the columns beside the names.
        rows: the names of policies with their divisions; of tracks, with the division of honest entries.
        notes: sentences below the table.
        subject: heading of the names: "policy" or "track".
    """

    caption: str
    columns: tuple[Column, ...]
    rows: Mapping[str, str]
    notes: tuple[str, ...] = ()
    subject: str = "policy"

    @property
    def sections(self) -> dict[str, list[str]]:
        """The names by division, in order."""
        found: dict[str, list[str]] = {}
        for name, division in self.rows.items():
            found.setdefault(division, []).append(name)
        return found

    def pieces(self, most: int) -> list[Table]:
        """The same rows in as few tables of ``most`` columns or fewer as need be, of about equal width."""
        count = max(1, math.ceil(len(self.columns) / most))
        ends = [round(part * len(self.columns) / count) for part in range(count + 1)]
        return [
            replace(
                self,
                caption=f"{self.caption}, part {part} of {count}" if count > 1 else self.caption,
                columns=self.columns[ends[part - 1] : ends[part]],
            )
            for part in range(1, count + 1)
        ]


def track_tables(results: Results, track: Track) -> list[Table]:
    """A track: a table per block of metrics. Metrics without any value, and policies without one, are left out.

    Args:
        results: of a comparison or of another suite.
        track: one of its tracks.
    """
    name, specs, board = track.name, results.policies_on(track.name), results.leaderboard
    rows = {} if board is None else {row.policy: row for row in board.rows if row.track == name}
    means = {policy: results.record(name, policy, track.metric)["mean"] or 0.0 for policy in specs}
    order = sorted(
        specs,
        key=lambda policy: (
            DIVISIONS.index(specs[policy].division),
            (rows[policy].rank or 0) if policy in rows else 0,
            -means[policy],
        ),
    )
    blocks = {"How close": [] if board is None else _ranking_columns(rows)}
    for metric in sorted(METRICS.values(), key=lambda metric: metric.name != track.metric):
        values = {policy: Value.of(results.summary(name, policy, metric.name), metric.format) for policy in order}
        label, descending = metric.label.replace(" %", _PERCENT), metric.direction == "higher"
        blocks.setdefault(metric.block, []).append(Column(label, metric.meaning, values, descending))
    notes = {
        "How close": _without_values(results, name),
    }
    tables = [
        Table(
            f"{name}: {block.lower()}",
            tuple(column for column in columns if column.is_filled),
            {policy: specs[policy].division for policy in order if _is_filled(policy, columns)},
            tuple(notes.get(block, ())),
        )
        for block, columns in blocks.items()
        if any(column.is_filled for column in columns)
    ]
    return tables or [Table(f"{name}: no policy has values", (), {}, tuple(notes["How close"]))]


def _is_filled(policy: str, columns: Iterable[Column]) -> bool:
    return any(column[policy].value is not None for column in columns)


def track_rules(results: Results, track: Track) -> str:
    """The number of episodes of a track, the metric that ranks its policies, and its physics, in sentences."""
    count = results.episodes[track.name]
    by = METRICS[track.metric].heading
    return f"{count} episode{'s' * (count > 1)}, ranked by {by}. {track.change}"


def _ranking_columns(rows: Mapping[str, TrackRow]) -> list[Column]:
    return [
        _column(
            "rank",
            "1 is best; honest and coded entries apart",
            rows,
            lambda row: Value.count(row.rank),
            descending=False,
        ),
        _column("score", _SCORE, rows, lambda row: Value.of(row.score, share)),
        _column(
            f"P(better than {LAW})",
            "probability of improvement, paired by episode",
            rows,
            lambda row: Value.of(row.improvement, share),
        ),
    ]


def _column(
    label: str, meaning: str, rows: Mapping[str, Row], read: Callable[[Row], Value], *, descending: bool = True
) -> Column:
    return Column(label, meaning, {policy: read(row) for policy, row in rows.items()}, descending)


def _without_values(results: Results, track: str) -> list[str]:
    """The policies without values on a track, by reason."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for verdict, found in (("n/a", results.not_applicable), ("failed", results.failures)):
        for (place, policy), reason in found.items():
            if place == track:
                reasons.setdefault((verdict, reason), []).append(policy)
    return [f"{verdict}: {', '.join(policies)}: {reason}" for (verdict, reason), policies in reasons.items()]


def call(spec: PolicySpec) -> str:
    """The policy of the first training seed with its arguments; with spaces, at which a narrow column breaks."""
    source = spec.to_dict()["training_seeds"][0]
    arguments = ", ".join(
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value!r}"
        for name, value in source.get("arguments", {}).items()
    )
    return f"{source['target'].partition(':')[2]} ({arguments})".removesuffix(" ()")


def complete(results: Results) -> list[str]:
    """The names of the policies that have values on every track, in the order of tables."""
    return [name for name in results.policies if all((track.name, name) in results.samples for track in results.tracks)]


def summary_tables(results: Results) -> list[Table]:
    """All tracks: complete entries, specialists, the digits on each track, and the room that each track leaves.

    Args:
        results: of a comparison or of another suite; a comparison has no full marks, and so no last table.
    """
    tables = overview(results)
    return [*tables, *(_digits_table(results, table) for table in tables)]


def overview(results: Results) -> list[Table]:
    """The entries that play every track, with means over all of them; then the specialists, with their own tracks.

    Args:
        results: of a comparison or of another suite.
    """
    policies, board = results.policies, results.leaderboard
    scores = {} if board is None else {row.policy: row for row in board.overall}
    firsts, everywhere = first_places(results), complete(results)
    means = {policy: mean_digits(results, policy) for policy in policies}
    best = sorted(
        policies,
        key=lambda policy: (
            DIVISIONS.index(policies[policy].division),
            -len(firsts.get(policy, ())),
            -(means[policy].mean or 0.0),
        ),
    )
    order = dict.fromkeys([*scores, *best])
    score = _column("score", f"mean over all tracks: {_SCORE}", scores, lambda row: Value.of(row.score, share))
    first = _column(
        "first",
        f"tracks on which no entry of its kind is more than {FIRST_MARGIN:g} digits better, with certainty",
        firsts,
        lambda tracks: Value.count(len(tracks)),
    )
    shared = [
        score,
        first,
    ]
    over_all = [
        _column("mean digits", "over all tracks", means, partial(Value.of, write=decimals)),
        _column(
            f"P(better than {LAW})",
            "probability of improvement, paired by episode",
            scores,
            lambda row: Value.of(row.improvement, share),
        ),
        _column(
            "mean rank",
            "over all tracks; honest and coded entries apart",
            scores,
            lambda row: Value.of(row.mean_rank),
            descending=False,
        ),
    ]
    played = {policy for _, policy in results.samples | results.failures}
    specialists = [policy for policy in order if policy not in everywhere and policy in played]
    against = _against_complete(results, specialists, everywhere)
    parts = (
        (_COMPLETE, [policy for policy in order if policy in everywhere], over_all),
        (f"{_SPECIALISTS}, on the tracks that they play", specialists, against),
    )
    tables = [_part(results, part, names, [*columns, *shared]) for part, names, columns in parts if names]
    notes = [] if board is None else [*_scope()]
    if absent := [policy for policy in order if policy not in played]:
        notes.append(f"n/a on every track: {', '.join(absent)}.")
    return [replace(table, notes=tuple(notes)) if table is tables[-1] else table for table in tables]


def _part(results: Results, part: str, policies: Iterable[str], columns: Iterable[Column]) -> Table:
    """A table of some policies, without columns that say nothing about them."""
    rows = {policy: results.policies[policy].division for policy in policies}
    filled = tuple(column for column in columns if not rows.keys().isdisjoint(column.values))
    return Table(f"{results.suite.name}, seed {results.seed}: {part}", filled, rows)


def _against_complete(results: Results, specialists: Sequence[str], everywhere: Sequence[str]) -> list[Column]:
    """The tracks of specialists, and their digits beside those of the best complete honest entry on the same tracks."""
    honest = [name for name in everywhere if results.policies[name].division == "honest"]
    best = {
        name: max(honest, key=lambda other: mean_digits(results, other, on=name).mean or 0.0)
        for name in specialists
        if honest and mean_digits(results, name).mean is not None
    }
    played = {
        name: [track.name for track in results.tracks if (track.name, name) in results.samples] for name in specialists
    }

    def means(name: str, **other: str) -> Value:
        return Value.of(mean_digits(results, name, **other), decimals)

    columns: list[tuple[str, str, Iterable[str], Callable[[str], Value]]] = [
        ("digits there", "mean over the tracks that it plays", best, means),
        ("tracks", "that the policy plays", played, lambda name: _names(played[name], len(results.tracks))),
        (
            "best of the above there",
            "the entry that plays every track and has the most digits on these",
            best,
            lambda name: Value(best[name]),
        ),
        ("its digits there", "mean over the same tracks", best, lambda name: means(best[name], on=name)),
        (
            "ahead",
            "digits of the specialist above these, paired by episode",
            best,
            lambda name: means(name, minus=best[name]),
        ),
    ]
    return [_column(label, meaning, {name: name for name in rows}, read) for label, meaning, rows, read in columns]


def _names(tracks: Sequence[str], count: int) -> Value:
    """A cell that names a few tracks, or says how many there are."""
    text = ",\n".join(tracks) if 0 < len(tracks) <= _MOST_NAMED else f"{len(tracks)} of {count}"
    return Value(text, len(tracks))


def _digits_table(results: Results, table: Table) -> Table:
    """The metric of each track, a row per track on which any of the policies of ``table`` acts, which are columns."""
    tracks = {
        track.name: track
        for track in results.tracks
        if any((track.name, name) in results.samples | results.failures for name in table.rows)
    }
    columns = (
        _column(
            f"{name} {MARKS[division]}".rstrip(), f"digits of {name}", tracks, partial(_score, results, policy=name)
        )
        for name, division in table.rows.items()
    )
    return Table(f"{table.caption}: digits", tuple(columns), dict.fromkeys(tracks, "honest"), subject="track")


def _score(results: Results, track: Track, *, policy: str) -> Value:
    """The digits of a policy on a track, or the reason in a word why there are none."""
    summary = results.summary(track.name, policy, track.metric)
    if summary is None:
        return Value("failed" if (track.name, policy) in results.failures else "n/a")
    return Value.of(summary, decimals)


def _scope() -> Iterator[str]:
    """The tracks of the scores."""
    yield "Scores are means over all tracks; n/a and failed count as zero input."


def first_places(results: Results) -> dict[str, list[str]]:
    """The tracks on which each policy, oracles apart, is the best of its division or within :data:`FIRST_MARGIN`.
"""
    firsts: dict[str, list[str]] = {name: [] for name, spec in results.policies.items() if not spec.is_oracle}
    for track in results.tracks:
        for division in DIVISIONS:
            found = {
                policy: summary
                for policy in firsts
                if results.policies[policy].division == division
                and (summary := results.summary(track.name, policy, track.metric))
            }
            best = max((summary.mean or 0.0 for summary in found.values()), default=0.0)
            for policy, summary in found.items():
                if (summary.high or 0.0) >= best - FIRST_MARGIN:
                    firsts[policy].append(track.name)
    return firsts


def mean_digits(results: Results, policy: str, *, minus: str | None = None, on: str | None = None) -> Summary:
    """The mean over tracks of the metric that scores each, with its 95 % interval.

    Args:
        results: of a comparison or of another suite.
        policy: its name; the tracks are those on which it was run.
        minus: a policy whose value is subtracted, episode by episode, on the tracks on which both were run.
        on: another policy that was run on the tracks.
    """
    needed = {policy, minus or policy, on or policy}
    scores = [
        results.samples[track.name, policy][track.metric]
        - (0.0 if minus is None else results.samples[track.name, minus][track.metric])
        for track in results.tracks
        if all((track.name, name) in results.samples for name in needed)
    ]
    return estimate(scores) if scores else Summary(None, None, None)
