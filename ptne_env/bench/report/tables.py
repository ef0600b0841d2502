"""Tables of results as data: columns, rows and cells, which the terminal and the page show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from ptne_env.bench.leaderboard import leaderboard
from ptne_env.bench.suite import LAW
from ptne_env.evaluation.metrics import METRICS, number, share
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.evaluation.tracks import Track

FIRST_MARGIN = 0.1
"""A policy whose interval comes within this many digits of the best mean of a track shares the first place there."""

ORACLE_NOTE = "* an oracle: it uses information that players lack, and has no rank"
"""The meaning of the mark beside a name."""


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
    def of(cls, quantity: Summary | float | None, write: Callable[[float | None], str] = number) -> Cell:
        """The cell of a summary, or of a number without an interval; ``None`` where there is none.

        Args:
            quantity: the summary or the number.
            write: makes the text of a number.
        """
        summary = quantity if isinstance(quantity, Summary) else Summary(quantity, quantity, quantity)
        if summary.mean is None:
            return cls()
        low, high = write(summary.low), write(summary.high)
        return cls(write(summary.mean), summary.mean, "" if low == high else f"[{low}, {high}]")

    @classmethod
    def plus_minus(cls, summary: Summary | None) -> Cell:
        """The cell of digits: the mean with two decimals, ± half of its interval."""
        if summary is None or summary.mean is None or summary.high is None:
            return cls()
        half, text = decimals(summary.high - summary.mean), decimals(summary.mean)
        return cls(text if half == "0.00" else f"{text} ±{half}", summary.mean)

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
    """The metric of every track, such as digits: a row per track and a column per policy, the paper's law first.

    The last row is the mean over all tracks, of the policies that play all of them.

    Args:
        results: of a comparison or of another suite.
    """
    mean = f"mean of {len(results.tracks)}"
    columns = []
    for name in ranked(results):
        cells = {
            track.name: Cell.plus_minus(results.summary(track.name, name, track.metric)) for track in results.tracks
        }
        cells |= {track: Cell("failed") for track, policy in results.failures if policy == name}
        if len(cells) > 1 and all(cell.value is not None for cell in cells.values()):
            cells[mean] = Cell.plus_minus(mean_digits(results, name))
        if results.policies[name].is_oracle or any(cell != Cell() for cell in cells.values()):
            columns.append(Column(_marked(results, name), cells, f"digits of {name}"))
    counts = sorted({results.episodes[track.name] for track in results.tracks})
    episodes = " to ".join(str(count) for count in dict.fromkeys([counts[0], counts[-1]]))
    return Table(
        f"Digits at the deadline ± half of the 95 % interval, {episodes} episodes",
        "scenario" if results.is_comparison else "track",
        (*(track.name for track in results.tracks), *([mean] if len(results.tracks) > 1 else [])),
        tuple(columns),
        (ORACLE_NOTE,) * any(spec.is_oracle for spec in results.policies.values()),
    )


def answer(results: Results) -> tuple[str, ...]:
    """One or two sentences: which policy is closest to the equilibrium, and how far the paper's law is behind.

    Args:
        results: of a comparison or of another suite.
    """
    firsts, count = first_places(results), len(results.tracks)
    if not any(firsts.values()):
        return ("No policy without an oracle's information has a result.",)
    best = max(firsts, key=lambda name: len(firsts[name]))
    noun = "scenario" if results.is_comparison else "track"
    where = f"on {results.tracks[0].name}"
    if count > 1:
        where = f"or within {FIRST_MARGIN:g} digits of the closest, on {len(firsts[best])} of {count} {noun}s"
    sentences = [f"{best} comes closest to the Nash equilibrium by the deadline{',' * (count > 1)} {where}."]
    reached = [digits for track in results.tracks if LAW in (digits := _reached(results, track))]
    gaps = [max(digits.values())[0] - digits[LAW][0] for digits in reached]
    if gaps and best != LAW:
        sentences.append(
            f"The paper's law ({LAW}) is {sum(gaps) / len(gaps):.2f} digits behind the closest"
            + f" on average, {max(gaps):.2f} at most" * (len(gaps) > 1)
            + "; a digit is a factor of ten in the distance from the equilibrium."
        )
    return tuple(sentences)


def _reached(results: Results, track: Track) -> dict[str, tuple[float, float]]:
    """The mean, and the upper end of its interval, of the policies with values on a track, oracles apart."""
    found = {}
    for name, spec in results.policies.items():
        summary = results.summary(track.name, name, track.metric)
        if summary is not None and summary.mean is not None and summary.high is not None and not spec.is_oracle:
            found[name] = summary.mean, summary.high
    return found


def first_places(results: Results) -> dict[str, list[str]]:
    """The tracks on which each policy, oracles apart, is the best or within :data:`FIRST_MARGIN` of it."""
    firsts: dict[str, list[str]] = {name: [] for name, spec in results.policies.items() if not spec.is_oracle}
    for track in results.tracks:
        found = _reached(results, track)
        best = max((mean for mean, _ in found.values()), default=0.0)
        for name, (_, high) in found.items():
            if high >= best - FIRST_MARGIN:
                firsts[name].append(track.name)
    return firsts


def ranked(results: Results) -> list[str]:
    """The names of the policies: the paper's law, then those with the most first places and digits, then oracles."""
    firsts = first_places(results)

    def key(name: str) -> tuple[bool, bool, int, float]:
        mean = mean_digits(results, name).mean
        return results.policies[name].is_oracle, name != LAW, -len(firsts.get(name, ())), -(mean or 0.0)

    return sorted(results.policies, key=key)


def mean_digits(results: Results, policy: str) -> Summary:
    """The mean of a policy over the tracks on which it was run, with its 95 % interval.

    Args:
        results: of a comparison or of another suite.
        policy: its name.
    """
    places = ((results.samples.get((track.name, policy)), track.metric) for track in results.tracks)
    scores = [samples[metric] for samples, metric in places if samples is not None]
    return estimate(scores) if scores else Summary(None, None, None)


def track_tables(results: Results, track: Track) -> list[Table]:
    """A track: a table per block of metrics. Metrics without any value, and policies without one, are left out.

    Args:
        results: of a comparison or of another suite.
        track: one of its tracks.
    """
    names = [name for name in ranked(results) if (track.name, name) in results.samples]
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
    """The scores of the policies of a suite over all tracks; ``None`` for a comparison, which has none.

    Args:
        results: of a comparison or of another suite.
    """
    board = leaderboard(results)
    if board is None:
        return None
    rows = {_marked(results, row.policy): row for row in board.overall}

    def column(label: str, meaning: str, cell: Callable[..., Cell]) -> Column:
        return Column(label, {name: cell(row) for name, row in rows.items()}, meaning)

    return Table(
        f"{results.name}: all tracks; a policy counts as zero input where it cannot act or failed",
        "policy",
        tuple(rows),
        (
            column("score", "mean over tracks: 0 is zero input, 1 is 12 digits", lambda row: Cell.of(row.score, share)),
            column("mean rank", "over tracks, oracles apart", lambda row: Cell.of(row.mean_rank)),
            column(
                f"P(better than {LAW})",
                "paired by episode, mean over tracks",
                lambda row: Cell.of(row.improvement, share),
            ),
        ),
    )


def _marked(results: Results, name: str) -> str:
    return f"{name} *" if results.policies[name].is_oracle else name


def text_table(caption: str, subject: str, headings: Iterable[str], rows: Iterable[tuple[str, ...]]) -> Table:
    """A table of words: every row is its name and a text per heading.

    Args:
        caption: the title.
        subject: heading of the names.
        headings: of the other columns.
        rows: the name, which no other row has, and the texts.
    """
    found = {name: texts for name, *texts in rows}
    columns = (
        Column(heading, {name: Cell.words(texts[index]) for name, texts in found.items()})
        for index, heading in enumerate(headings)
    )
    return Table(caption, subject, tuple(found), tuple(columns))
