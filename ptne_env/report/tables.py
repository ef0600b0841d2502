"""Tables of results as data: columns, rows and cells, which the terminal and the page show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ptne_env.evaluation.entries import POLICIES
from ptne_env.evaluation.metrics import METRICS, number
from ptne_env.evaluation.results import Results, standing
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.evaluation.tracks import Track
from ptne_env.suites.suite import LAW, Row, leaderboard

FIRST_MARGIN = 0.1
"""A policy whose interval comes within this many digits of the best mean of a track shares the first place there."""

ORACLE_NOTE = "* an oracle: it uses information that players lack, and has no rank"
"""The meaning of the mark beside a name."""

DIGITS_NOTE = "digits: at 2 the error of all estimates is 1 %, at 3 it is 0.1 %; 12 at most"
"""The meaning of the numbers of the answer."""

MEAN_REGRET = "mean regret"
"""Name of the row and column of the metric."""

REGRET_NOTE = "mean regret: of the way to the deadline; 1 is standing still at the start"
"""The meaning of :data:`MEAN_REGRET`."""


def decimals(value: float | None) -> str:
    """Digits with two decimals; a dash where there are none."""
    return "–" if value is None else f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: as it is shown.
        value: by which the column is sorted; a cell without one comes last.
        interval: the 95 % interval, as it is shown; empty where both ends look the same.
        is_text: whether the cell holds words, which are wrapped.
    """

    text: str = "–"
    value: float | None = None
    interval: str = ""
    is_text: bool = False

    @classmethod
    def of(cls, quantity: Summary | float | None) -> Cell:
        """The cell of a summary, or of a number without an interval; ``None`` where there is none."""
        summary = quantity if isinstance(quantity, Summary) else Summary(quantity, quantity, quantity)
        if summary.mean is None:
            return cls()
        low, high = number(summary.low), number(summary.high)
        return cls(number(summary.mean), summary.mean, "" if low == high else f"[{low}, {high}]")

    @classmethod
    def plus_minus(cls, summary: Summary | None) -> Cell:
        """The cell of digits: the mean with two decimals, ± half of its interval."""
        if summary is None or summary.mean is None or summary.high is None:
            return cls()
        half, text = decimals(summary.high - summary.mean), decimals(summary.mean)
        return cls(text if half == "0.00" else f"{text} ±{half}", summary.mean)

    @classmethod
    def plain(cls, summary: Summary | None) -> Cell:
        """The cell of a mean without its interval."""
        return cls() if summary is None or summary.mean is None else cls(number(summary.mean), summary.mean)

    @classmethod
    def words(cls, text: str) -> Cell:
        """The cell of a text."""
        return cls(text, is_text=True)


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        label: the heading.
        cells: by row.
        meaning: of the values, in a phrase.
    """

    label: str
    cells: Mapping[str, Cell]
    meaning: str = ""

    def __getitem__(self, row: str) -> Cell:
        """The cell of a row; a dash where it has none."""
        return self.cells.get(row, Cell())

    @property
    def is_filled(self) -> bool:
        """Whether any row has a value."""
        return any(cell.value is not None for cell in self.cells.values())


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        caption: the title.
        subject: heading of the names of the rows.
        rows: names.
        columns: the columns beside the names.
        notes: sentences below the table.
    """

    caption: str
    subject: str
    rows: tuple[str, ...]
    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()


# --- results --------------------------------------------------------------------------------------------------------


def answer_table(results: Results) -> Table:
    """The digits on every track: a row per track and a column per policy, in the order of :func:`ordered`.

    The last rows are the means of digits, the score of a suite, and of the mean regrets over all scored tracks. In a
    comparison only policies that play all of them have one.
    """
    tracks, means = [track.name for track in results.tracks], overall(results)
    score = f"mean of {len(tracks)}" if results.is_comparison else "score"
    columns = []
    for name in ordered(results):
        cells = {track: Cell.plus_minus(results.summary(track, name, "digits")) for track in tracks}
        cells |= {track: Cell("failed") for track, policy in results.failures if policy == name}
        if name in means:
            digits, regret = means[name]
            cells |= {score: Cell.plus_minus(digits), MEAN_REGRET: Cell.plain(regret)}
        columns.append(Column(_marked(results, name), cells, f"digits of {name}"))
    counts = sorted({results.episodes[track] for track in tracks})
    episodes = " to ".join(str(count) for count in dict.fromkeys([counts[0], counts[-1]]))
    notes = [DIGITS_NOTE, REGRET_NOTE]
    if unscored := [track.name for track in results.tracks if not track.scored]:
        notes.append(f"score: the mean of all tracks but {', '.join(unscored)}")
    if any(spec.is_oracle for spec in results.policies.values()):
        notes.append(ORACLE_NOTE)
    return Table(
        f"Digits at the deadline ± half of the 95 % interval, {episodes} episode{'s' * (counts[-1] > 1)}",
        "scenario" if results.is_comparison else "track",
        (*tracks, score, MEAN_REGRET) if len(tracks) > 1 and means else (*tracks, MEAN_REGRET),
        tuple(columns),
        tuple(notes),
    )


def regret_table(results: Results) -> Table:
    """The mean regret on every track: a row per track and a column per policy, in the order of :func:`ordered`."""
    tracks = [track.name for track in results.tracks]
    columns = (
        Column(
            _marked(results, name),
            {track: Cell.plain(results.summary(track, name, "mean_regret")) for track in tracks},
            f"mean regret of {name}",
        )
        for name in ordered(results)
    )
    return Table("Mean regret until the deadline", "track", tuple(tracks), tuple(columns), (REGRET_NOTE,))


def answer(results: Results) -> tuple[str, ...]:
    """One or two sentences: which policy is closest to the equilibrium, and how far the paper's law is behind."""
    firsts = first_places(results)
    tracks = [track.name for track in results.tracks if track.scored] or [track.name for track in results.tracks]
    if not any(firsts.values()):
        return ("No policy without an oracle's information has a result.",)
    best = next(name for name in _best_first(results) if name in firsts)
    noun, count = "scenario" if results.is_comparison else "track", len(tracks)
    if len(firsts) == 1:
        return (f"{best} was compared with nothing; --policy names others.",)
    where = f"on {tracks[0]}"
    if count > 1:
        near = f"or with its interval within {FIRST_MARGIN:g} digits of the closest"
        where = f"{near}, on {len(firsts[best])} of {count} {noun}s"
    equal = [name for name in _best_first(results) if firsts.get(name) == firsts[best]]
    names = best if len(equal) == 1 else f"{', '.join(equal[:-1])} and {equal[-1]}"
    come = "comes closest" if len(equal) == 1 else "are not told apart: they come closest"
    sentences = [f"{names} {come} to the Nash equilibrium by the deadline{',' * (count > 1)} {where}."]
    reached = [digits for track in tracks if LAW in (digits := _reached(results, track))]
    gaps = [max(digits.values())[0] - digits[LAW][0] for digits in reached]
    if gaps and LAW not in equal:
        sentences.append(
            f"The paper's law ({LAW}) is {sum(gaps) / len(gaps):.2f} digits behind the closest"
            + f" on average, {max(gaps):.2f} at most" * (len(gaps) > 1)
            + "; a digit is a factor of ten in the distance from the equilibrium."
        )
    return tuple(sentences)


def _reached(results: Results, track: str) -> dict[str, tuple[float, float]]:
    """The mean, and the upper end of its interval, of the policies with values on a track, oracles apart."""
    found = {}
    for name, summary in results.ranked(track).items():
        if summary.mean is not None and summary.high is not None and not results.policies[name].is_oracle:
            found[name] = summary.mean, summary.high
    return found


def first_places(results: Results) -> dict[str, list[str]]:
    """The scored tracks on which each policy, oracles apart, has a first place; see :data:`FIRST_MARGIN`."""
    firsts: dict[str, list[str]] = {name: [] for name, spec in results.policies.items() if not spec.is_oracle}
    for track in results.tracks:
        found = _reached(results, track.name) if track.scored else {}
        best = max((mean for mean, _ in found.values()), default=0.0)
        for name, (_, high) in found.items():
            if high >= best - FIRST_MARGIN:
                firsts[name].append(track.name)
    return firsts


def ordered(results: Results) -> list[str]:
    """The policies: :func:`leaders`, oracles, then the rest, each part by rank.

    So the numbers that say most find room in a narrow terminal. Policies that act nowhere are left out.
    """
    names, leading = _best_first(results), leaders(results)
    oracles = [name for name in names if results.policies[name].is_oracle]
    return list(dict.fromkeys([*[name for name in names if name in leading], *oracles, *names]))


def leaders(results: Results) -> dict[str, str]:
    """The policies that the answer is about, with what each is: ``{"static": "the paper's law", ...}``.

    They are the best law, the best network in a file, the best policy that does not ship, and the paper's law. One
    policy may be several of these.
    """
    specs, found = results.policies, dict[str, str]()
    names = [name for name in _best_first(results) if not specs[name].is_oracle]
    kinds = {
        "the paper's law": [name for name in names if name == LAW],
        "the best law": [name for name in names if specs[name].is_law],
        "the best learned policy": [name for name in names if specs[name].files],
        "yours": [name for name in names if name not in POLICIES],
    }
    for kind, of_kind in kinds.items():
        for name in of_kind[:1]:
            found[name] = f"{found[name]}, {kind}" if name in found else kind
    return found


def _best_first(results: Results) -> list[str]:
    """The names of the policies by rank: in a suite by the score, in a comparison by first places and mean digits."""
    means, acting = overall(results), {name for _, name in (*results.samples, *results.failures)}
    firsts = first_places(results) if results.is_comparison else {}

    def key(name: str) -> tuple[bool, int, float, float]:
        return results.policies[name].is_oracle, -len(firsts.get(name, ())), *standing(*means.get(name, (None, None)))

    return sorted((name for name in results.policies if name in acting), key=key)


def overall(results: Results) -> dict[str, tuple[Summary, Summary]]:
    """The means of digits and of mean regrets over tracks: of a suite's scored ones, or of all of a comparison."""
    board = leaderboard(results)
    if board is not None:
        return {row.policy: (row.score, row.mean_regret) for row in board}
    tracks = [track.name for track in results.tracks]
    found = {name: [results.samples.get((track, name)) for track in tracks] for name in results.policies}
    return {
        name: (
            estimate([each["digits"] for each in samples]),
            estimate([each["mean_regret"] for each in samples if np.isfinite(each["mean_regret"]).any()]),
        )
        for name, given in found.items()
        if len(samples := [each for each in given if each is not None]) == len(tracks)
    }


def track_tables(results: Results, track: Track) -> list[Table]:
    """A track: a table per block of metrics. Metrics without any value, and policies without one, are left out."""
    names = [name for name in ordered(results) if (track.name, name) in results.samples]
    blocks: dict[str, list[Column]] = {}
    for metric in METRICS.values():
        cells = {_marked(results, name): Cell.of(results.summary(track.name, name, metric.name)) for name in names}
        if (column := Column(metric.label, cells, metric.meaning)).is_filled:
            blocks.setdefault(metric.block, []).append(column)
    rows = tuple(_marked(results, name) for name in names)
    notes = _without_values(results, track.name)
    return [
        Table(f"{track.name}: {block.lower()}", "policy", rows, tuple(columns), () if index else notes)
        for index, (block, columns) in enumerate(blocks.items())
    ] or [Table(f"{track.name}: no policy has values", "policy", (), (), notes)]


def _without_values(results: Results, track: str) -> tuple[str, ...]:
    """The policies without values on a track, by reason."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for verdict, found in (("n/a", results.not_applicable), ("failed", results.failures)):
        for (place, policy), reason in found.items():
            if place == track:
                reasons.setdefault((verdict, reason), []).append(policy)
    return tuple(f"{verdict}: {', '.join(policies)}: {reason}" for (verdict, reason), policies in reasons.items())


def leaderboard_table(results: Results) -> Table | None:
    """The scores of the policies of a suite over all tracks; ``None`` for a comparison, which has none."""
    board = leaderboard(results)
    if board is None:
        return None
    rows = {_marked(results, row.policy): row for row in board}

    def column(label: str, meaning: str, cell: Callable[[Row], Cell]) -> Column:
        return Column(label, {name: cell(row) for name, row in rows.items()}, meaning)

    return Table(
        f"{results.name}: all scored tracks; a policy counts as zero input where it cannot act or failed",
        "policy",
        tuple(rows),
        (
            column("score", "mean digits over tracks", lambda row: Cell.plus_minus(row.score)),
            column(
                MEAN_REGRET, "mean over tracks whose games have best responses", lambda row: Cell.of(row.mean_regret)
            ),
            column("mean rank", "over tracks, oracles apart", lambda row: Cell.of(row.mean_rank)),
        ),
    )


def _marked(results: Results, name: str) -> str:
    return f"{name} *" if results.policies[name].is_oracle else name


def text_table(
    caption: str,
    subject: str,
    headings: Iterable[str],
    rows: Iterable[tuple[str, ...]],
    notes: tuple[str, ...] = (),
) -> Table:
    """A table of words: every row is its name and a text per heading.

    Args:
        caption: the title.
        subject: heading of the names.
        headings: of the other columns.
        rows: the name, which no other row has, and the texts.
        notes: sentences below the table.
    """
    found = {name: texts for name, *texts in rows}
    columns = (
        Column(heading, {name: Cell.words(texts[index]) for name, texts in found.items()})
        for index, heading in enumerate(headings)
    )
    return Table(caption, subject, tuple(found), tuple(columns), notes)
