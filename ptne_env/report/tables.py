"""Tables as data, which the terminal and the page show: of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from ptne_env.evaluation.comparison import LAW
from ptne_env.evaluation.metrics import METRICS, MOST_DIGITS, number
from ptne_env.evaluation.policy_spec import MARKS, POLICIES
from ptne_env.evaluation.results import SHOWN, Results, standing
from ptne_env.evaluation.statistics import Summary
from ptne_env.evaluation.tracks import Track
from ptne_env.suites.leaderboard import leaderboard

DIGITS_NOTE = "digits: 2 is an error of all estimates of 1 %, 3 is an error of 0.1 %; 12 at most"
BESIDE_NOTE = "on the way: mean digits after every step; worst tenth: mean digits of the worst tenth of the episodes"

BESIDE = "on the way", "worst tenth"
"""The rows and columns beside the digits at the deadline: those of the other metrics of every table."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: the text as it is shown.
        value: the number by which the column is sorted; a cell without one comes last.
        interval: the 95 % interval as it is shown; empty where both ends look the same.
    """

    text: str = "–"
    value: float | None = None
    interval: str = ""

    @classmethod
    def of(cls, quantity: Summary | float | None) -> Cell:
        """Return the cell of a summary, or of a number without an interval; a dash for ``None``."""
        summary = quantity if isinstance(quantity, Summary) else Summary(quantity, quantity, quantity)
        low, high = number(summary.low), number(summary.high)
        interval = "" if low == high else f"[{low}, {high}]"
        lacks_one = summary.low is None and summary.mean is not None
        return cls(number(summary.mean), summary.mean, "n/a" if lacks_one else interval)

    @classmethod
    def plus_minus(cls, summary: Summary | None) -> Cell:
        """Return the cell of digits: the mean with two decimals, ± half of its interval."""
        if summary is None or summary.mean is None:
            return cls()
        reach = MOST_DIGITS + 1 if summary.high is None else summary.high - summary.mean
        half = f"{reach:z.2f}" if reach <= MOST_DIGITS else "n/a"  # a longer interval says nothing
        text = f"{summary.mean:z.2f}".replace("-", "−")
        return cls(text if half == "0.00" else f"{text} ±{half}", summary.mean)


@dataclass(frozen=True)
class Column:
    """A column of a table: its heading, the cells by row, and what they mean, in a phrase."""

    label: str
    cells: Mapping[str, Cell]
    meaning: str = ""

    def __getitem__(self, row: str) -> Cell:
        """Return the cell of a row; a dash where it has none."""
        return self.cells.get(row, Cell())


@dataclass(frozen=True)
class Table:
    """A table, with the heading of the names of its rows as ``subject``, and sentences below it as ``notes``.

    ``totals`` are the names of further rows, which stay last when the others are sorted.
    """

    caption: str
    subject: str
    rows: tuple[str, ...]
    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()
    totals: tuple[str, ...] = ()


def join_words(words: Sequence[str], most: int | None = None) -> str:
    """Return words with commas and "and"; of more than ``most``, the first ones and how many more there are."""
    shown = list(words[:most])
    if len(words) > len(shown):
        shown.append(f"{len(words) - len(shown)} more")
    return " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))


def answer_table(results: Results) -> Table:
    """Return the digits on every track: a row per track and a column per policy, as :func:`order_policies` has them.

    The totals are the means over all scored tracks of digits (the score of a suite), of digits on the way, of digits
    in the worst tenth of the episodes, and of the ranks in a suite. In a comparison only policies that play all tracks
    have them.
    """
    tracks, means = [track.name for track in results.tracks], means_over_tracks(results)
    ranks = {row.policy: {"mean rank": Cell.of(row.mean_rank)} for row in leaderboard(results) or ()}
    score = (f"mean of {len(tracks)}" if results.is_comparison else "score") if len(tracks) > 1 else ""
    columns = []
    for name in order_policies(results):
        cells = {
            track: _find_verdict(results, track, name) or Cell.plus_minus(results.summary(track, name, "digits"))
            for track in tracks
        }
        if name in means:
            cells |= dict(zip((score, *BESIDE), map(Cell.plus_minus, means[name]), strict=True)) | ranks.get(name, {})
        columns.append(Column(results.policies[name].label, cells, f"digits of {name}"))
    counts = sorted({results.episodes[track] for track in tracks})
    episodes = " to ".join(map(str, dict.fromkeys([counts[0], counts[-1]])))
    notes = [DIGITS_NOTE, BESIDE_NOTE]
    if any("n/a" in cell.text and cell.value is not None for column in columns for cell in column.cells.values()):
        notes.append("±n/a: too few random episodes or training seeds for an interval")
    if unscored := [track.name for track in results.tracks if not track.scored]:
        notes.append(f"score: the mean of all tracks but {', '.join(unscored)}")
    if ranks:
        notes.append("a policy counts as zero input where it cannot act or failed; policies with a mark have no rank")
    present = {spec.mark for spec in results.policies.values()}
    notes += [f"{mark} {meaning}" for mark, meaning in MARKS.items() if mark in present]
    return Table(
        f"Digits at the deadline ± half of the 95 % interval, {episodes} episode{'s' * (counts[-1] > 1)}",
        place_noun(results),
        tuple(tracks),
        tuple(columns),
        (*notes, *_list_reasons(results, tracks)),
        tuple(filter(None, (score, *BESIDE, "mean rank" * bool(ranks)))) if means else (),
    )


def place_noun(results: Results) -> str:
    """Return the word for what policies play: a comparison has scenarios, and a suite has tracks."""
    return "scenario" if results.is_comparison else "track"


def answer(results: Results) -> tuple[str, ...]:
    """Return sentences: who comes closest to the equilibrium, and what the paper's law and policies of the user do.

    One policy leads another one where the 95 % interval of their difference, paired by episodes, is clear of 0.
    """
    tracks, noun = results.counted_tracks, place_noun(results)
    rivals = [name for name, spec in results.policies.items() if spec.is_ranked]
    ranked = [name for name in order_policies(results) if name in rivals and _list_tracks(results, name)]
    own = [name for name in rivals if name not in POLICIES]
    sentences = []
    if not ranked:
        sentences.append("No policy that is ranked has a result.")
    elif len(rivals) == 1:
        sentences.append(f"{ranked[0]} was compared with no other policy; --policy names others.")
    else:
        best, *rest = ranked
        where = f"on average over {len(tracks)} {noun}s" if len(tracks) > 1 else f"on {tracks[0]}"
        whole = [name for name in rest if _list_tracks(results, name) == _list_tracks(results, best)]
        equal = [name for name in whole if not _leads(results, best, name)]
        come = "cannot be told apart: they come closest" if equal else "comes closest"
        sentences.append(f"{join_words([best, *equal])} {come} to the Nash equilibrium by the deadline {where}.")
        others = [name for name in rest if (name == LAW or name in own) and name not in equal]
        sentences += [_compare(results, best, other, noun) for other in others]
    for name in own:
        if missing := [track for track, policy in results.reasons if policy == name]:
            sentences.append(f"{name} has no result on {join_words(missing, most=3)}, for the reason below the table.")
    return tuple(sentences)


def _leads(results: Results, best: str, other: str) -> bool:
    """Return whether a policy with more digits leads another one on average over its tracks; one episode decides."""
    lead = results.difference(best, other, _list_tracks(results, best))
    return lead.is_above_zero or (lead.low is None and lead.mean is not None and lead.mean > 0)


def _compare(results: Results, best: str, other: str, noun: str) -> str:
    """Return a sentence about the digits by which the best policy leads another one."""
    shared = [track for track in _list_tracks(results, best) if track in _list_tracks(results, other)]
    difference, name = results.difference(best, other, shared), f"the paper's law ({LAW})" if other == LAW else other
    if difference.mean is None:
        return f"{best} and {name} have no {noun} in common."
    where = f"on {shared[0]}" if len(shared) == 1 else f"on average over {len(shared)} {noun}s"
    if difference.low is None or difference.high is None:
        return f"{best} is {difference.mean:.2f} digits ahead of {name} {where}; one episode has no interval."
    digits = f"{difference.mean:.2f} digits [{difference.low:.2f}, {difference.high:.2f}] {where}"
    if difference.is_above_zero:
        return f"{best} leads {name} by {digits}."
    return f"{best} and {name} cannot be told apart: they differ by {digits}."


def _list_tracks(results: Results, policy: str) -> list[str]:
    """Return the counted tracks on which a policy has values."""
    return [track for track in results.counted_tracks if (track, policy) in results.samples]


def leaders(results: Results) -> dict[str, str]:
    """Return the policies that the answer is about, with what each is: ``{"static": "the paper's law", ...}``.

    They are the paper's law, the best law, the best network in a file, and the best policy that does not ship, of those
    with a result. One policy may be several of these.
    """
    specs = results.policies
    names = [name for name in order_policies(results) if specs[name].is_ranked and _list_tracks(results, name)]
    kinds = {
        "the paper's law": [name for name in names if name == LAW],
        "the best law": [name for name in names if specs[name].is_law],
        "the best learned policy": [name for name in names if specs[name].files],
        "yours": [name for name in names if name not in POLICIES],
    }
    leading: dict[str, list[str]] = {}
    for kind, candidates in kinds.items():
        for name in candidates[:1]:
            leading.setdefault(name, []).append(kind)
    return {name: ", ".join(labels) for name, labels in leading.items()}


def order_policies(results: Results) -> list[str]:
    """Return all policies by rank: by the score of a suite, or by the mean over all tracks of a comparison.

    What does not play all tracks of a comparison, or none of a suite, comes after what does, and oracles come last.
    """
    means = means_over_tracks(results)

    def key(name: str) -> tuple[bool, bool, int, float, float]:
        missing = 0 if name in means else sum(policy == name for _, policy in results.reasons)
        spec = results.policies[name]
        return spec.is_oracle, not spec.is_ranked, missing, *standing(*means.get(name, (None, None))[:2])

    return sorted(results.policies, key=key)


@lru_cache(maxsize=4)
def means_over_tracks(results: Results) -> dict[str, tuple[Summary, ...]]:
    """Return the means of :data:`SHOWN` over the scored tracks of a suite, or all of a comparison.

    A policy that does not act on all tracks of a comparison has none.
    """
    board = leaderboard(results)
    if board is not None:
        return {row.policy: (row.score, row.on_the_way, row.worst_tenth) for row in board}
    tracks = [track.name for track in results.tracks]
    whole = [name for name in results.policies if all((track, name) in results.samples for track in tracks)]
    return {name: tuple(results.mean_over_tracks(tracks, metric, name) for metric in SHOWN) for name in whole}


def track_tables(results: Results, track: Track) -> list[Table]:
    """Return a table per block of metrics of a track, without the metrics that have no value there."""
    names, blocks = order_policies(results), dict[str, list[Column]]()
    for metric in METRICS.values():
        cells = {
            results.policies[name].label: _find_verdict(results, track.name, name)
            or Cell.of(results.summary(track.name, name, metric.name))
            for name in names
        }
        if any(cell.value is not None for cell in cells.values()):
            blocks.setdefault(metric.block, []).append(Column(metric.label, cells, metric.meaning))
    rows, notes = tuple(results.policies[name].label for name in names), _list_reasons(results, [track.name])
    return [
        Table(f"{track.name}: {block.lower()}", "policy", rows, tuple(columns), () if index else notes)
        for index, (block, columns) in enumerate(blocks.items())
    ] or [Table(f"{track.name}: no policy has values", "policy", (), (), notes)]


def _find_verdict(results: Results, track: str, policy: str) -> Cell | None:
    """Return the cell ``n/a`` or ``failed`` of a policy that has no values on a track."""
    reason = results.reasons.get((track, policy))
    return None if reason is None else Cell(reason.partition(":")[0])


def _list_reasons(results: Results, tracks: Sequence[str]) -> tuple[str, ...]:
    """Return a note for each policy without values on some of the tracks; the reason is that of the first of them."""
    places: dict[tuple[str, str], list[str]] = {}
    for (track, policy), reason in results.reasons.items():
        if track in tracks:
            places.setdefault((policy, reason.partition(":")[0]), []).append(track)
    return tuple(
        f"{verdict}: {policy} on {join_words(found, most=3)}: {results.reasons[found[0], policy].partition(': ')[2]}"
        for (policy, verdict), found in places.items()
    )
