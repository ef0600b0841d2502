"""Tables as data, which the terminal and the page show: of results, certificates and verifications."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ptne_env.evaluation.metrics import METRICS, number
from ptne_env.evaluation.policy_spec import POLICIES
from ptne_env.evaluation.results import Results, standing
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.evaluation.tracks import Track
from ptne_env.execution.verification import Repetition, Verification
from ptne_env.suites.suite import LAW, Row, leaderboard
from ptne_env.theory import Certificate

FIRST_MARGIN = 0.1
"""Policies share the first place on a track if their intervals come within this many digits of the best mean."""

ORACLE_NOTE = "* an oracle: it uses information that players lack, and has no rank"
DIGITS_NOTE = "digits: 2 is an error of all estimates of 1 %, 3 is an error of 0.1 %; 12 at most"
REGRET_NOTE = "mean regret: averaged over the way to the deadline; 1 is that of standing still at the start"

_SHOWN_DIFFERENCES = 10
"""Number of differences of a verification that are listed."""

MEAN_REGRET = "mean regret"
"""The heading of the metric as a row and as a column."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: the text as it is shown.
        value: the number by which the column is sorted; a cell without one comes last.
        interval: the 95 % interval as it is shown; empty where both ends look the same.
        is_text: whether the cell holds words, which are wrapped.
    """

    text: str = "–"
    value: float | None = None
    interval: str = ""
    is_text: bool = False

    @classmethod
    def of(cls, quantity: Summary | float | None) -> Cell:
        """Return the cell of a summary, or of a number without an interval; a dash for ``None``."""
        summary = quantity if isinstance(quantity, Summary) else Summary(quantity, quantity, quantity)
        low, high = number(summary.low), number(summary.high)
        return cls(number(summary.mean), summary.mean, "" if low == high else f"[{low}, {high}]")

    @classmethod
    def plus_minus(cls, summary: Summary | None) -> Cell:
        """Return the cell of digits: the mean with two decimals, ± half of its interval."""
        if summary is None or summary.mean is None or summary.high is None:
            return cls()
        half, text = _two_decimals(summary.high - summary.mean), _two_decimals(summary.mean)
        return cls(text if half == "0.00" else f"{text} ±{half}", summary.mean)


def _two_decimals(value: float) -> str:
    return f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        label: the heading.
        cells: the cells by row.
        meaning: what the values mean, in a phrase.
    """

    label: str
    cells: Mapping[str, Cell]
    meaning: str = ""

    def __getitem__(self, row: str) -> Cell:
        """Return the cell of a row; a dash where it has none."""
        return self.cells.get(row, Cell())


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        caption: the title.
        subject: the heading of the names of the rows.
        rows: the names of the rows.
        columns: the columns beside the names.
        notes: sentences below the table.
    """

    caption: str
    subject: str
    rows: tuple[str, ...]
    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()


def text_table(
    caption: str,
    subject: str,
    headings: Iterable[str],
    rows: Iterable[tuple[str, ...]],
    notes: tuple[str, ...] = (),
) -> Table:
    """Return a table of words.

    Args:
        caption: the title.
        subject: the heading of the names of the rows.
        headings: the headings of the other columns.
        rows: the name of each row, which no other row has, and a text per heading.
        notes: sentences below the table.
    """
    texts = {name: row for name, *row in rows}
    columns = (
        Column(heading, {name: Cell(row[index], is_text=True) for name, row in texts.items()})
        for index, heading in enumerate(headings)
    )
    return Table(caption, subject, tuple(texts), tuple(columns), notes)


def join_words(words: Sequence[str], most: int | None = None) -> str:
    """Return words with commas and "and"; of more than ``most``, the first ones and how many more there are."""
    shown = list(words[:most])
    if len(words) > len(shown):
        shown.append(f"{len(words) - len(shown)} more")
    return " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))


def answer_table(results: Results) -> Table:
    """Return the digits on every track: a row per track and a column per policy, as :func:`order_policies` has them.

    The last rows are the means of digits (the score of a suite) and of mean regrets over all scored tracks. In a
    comparison only policies that play all tracks have them.
    """
    tracks, means = [track.name for track in results.tracks], means_over_tracks(results)
    score = f"mean of {len(tracks)}" if results.is_comparison else "score"
    columns = []
    for name in order_policies(results):
        cells = {track: Cell.plus_minus(results.summary(track, name, "digits")) for track in tracks}
        cells |= {track: Cell("failed") for track, policy in results.failures if policy == name}
        if name in means:
            digits, regret = means[name]
            cells |= {score: Cell.plus_minus(digits), MEAN_REGRET: Cell.of(regret.mean)}
        columns.append(Column(_mark_oracle(results, name), cells, f"digits of {name}"))
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
    """Return the mean regret on every track: a row per track and a column per policy."""
    tracks = [track.name for track in results.tracks]
    columns = (
        Column(
            _mark_oracle(results, name),
            {
                track: Cell.of(regret.mean)
                for track in tracks
                if (regret := results.summary(track, name, "mean_regret")) is not None
            },
            f"mean regret of {name}",
        )
        for name in order_policies(results)
    )
    return Table("Mean regret until the deadline", "track", tuple(tracks), tuple(columns), (REGRET_NOTE,))


def answer(results: Results) -> tuple[str, ...]:
    """Return one or two sentences: who comes closest to the equilibrium, and how far the paper's law is behind."""
    firsts = first_places(results)
    tracks = [track.name for track in results.tracks if track.scored] or [track.name for track in results.tracks]
    if not any(firsts.values()):
        return ("No policy without an oracle's information has a result.",)
    best = next(name for name in _rank_policies(results) if name in firsts)
    noun, count = "scenario" if results.is_comparison else "track", len(tracks)
    if len(firsts) == 1:
        return (f"{best} was compared with no other policy; --policy names others.",)
    where = f"on {tracks[0]}"
    if count > 1:
        near = f"or with its interval within {FIRST_MARGIN:g} digits of the closest"
        where = f"{near}, on {len(firsts[best])} of {count} {noun}s"
    equal = [name for name in _rank_policies(results) if firsts.get(name) == firsts[best]]
    come = "comes closest" if len(equal) == 1 else "cannot be told apart: they come closest"
    sentences = [f"{join_words(equal)} {come} to the Nash equilibrium by the deadline{',' * (count > 1)} {where}."]
    ends = [digits for track in tracks if LAW in (digits := _ends_of_digits(results, track))]
    gaps = [max(digits.values())[0] - digits[LAW][0] for digits in ends]
    if gaps and LAW not in equal:
        sentences.append(
            f"The paper's law ({LAW}) is {sum(gaps) / len(gaps):.2f} digits behind the closest"
            + f" on average, {max(gaps):.2f} at most" * (len(gaps) > 1)
            + "; a digit is a factor of ten in the distance from the equilibrium."
        )
    return tuple(sentences)


def first_places(results: Results) -> dict[str, list[str]]:
    """Return the scored tracks on which each policy, oracles apart, has a first place; see :data:`FIRST_MARGIN`."""
    firsts: dict[str, list[str]] = {name: [] for name, spec in results.policies.items() if not spec.is_oracle}
    for track in results.tracks:
        ends = _ends_of_digits(results, track.name) if track.scored else {}
        best = max((mean for mean, _ in ends.values()), default=0.0)
        for name, (_, high) in ends.items():
            if high >= best - FIRST_MARGIN:
                firsts[name].append(track.name)
    return firsts


def _ends_of_digits(results: Results, track: str) -> dict[str, tuple[float, float]]:
    """Return the mean and the upper end of its interval of all policies with digits on a track, oracles apart."""
    return {
        name: (digits.mean, digits.high)
        for name, digits in results.ranked(track).items()
        if digits.mean is not None and digits.high is not None and not results.policies[name].is_oracle
    }


def order_policies(results: Results) -> list[str]:
    """Return the policies that act somewhere: :func:`leaders`, oracles, then the rest, each group by rank.

    In this order the numbers that say most find room in a narrow terminal.
    """
    names, leading = _rank_policies(results), leaders(results)
    oracles = [name for name in names if results.policies[name].is_oracle]
    return list(dict.fromkeys([*[name for name in names if name in leading], *oracles, *names]))


def leaders(results: Results) -> dict[str, str]:
    """Return the policies that the answer is about, with what each is: ``{"static": "the paper's law", ...}``.

    They are the paper's law, the best law, the best network in a file, and the best policy that does not ship. One
    policy may be several of these.
    """
    specs = results.policies
    names = [name for name in _rank_policies(results) if not specs[name].is_oracle]
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


def _rank_policies(results: Results) -> list[str]:
    """Return the policies by rank: in a suite by the score, in a comparison by first places and mean digits."""
    means, acting = means_over_tracks(results), {name for _, name in (*results.samples, *results.failures)}
    firsts = first_places(results) if results.is_comparison else {}

    def key(name: str) -> tuple[bool, int, float, float]:
        return results.policies[name].is_oracle, -len(firsts.get(name, ())), *standing(*means.get(name, (None, None)))

    return sorted((name for name in results.policies if name in acting), key=key)


def means_over_tracks(results: Results) -> dict[str, tuple[Summary, Summary]]:
    """Return the means of digits and of mean regrets over the scored tracks of a suite, or all of a comparison.

    A policy that does not act on all tracks of a comparison has none.
    """
    board = leaderboard(results)
    if board is not None:
        return {row.policy: (row.score, row.mean_regret) for row in board}
    tracks = [track.name for track in results.tracks]
    means = {}
    for name in results.policies:
        samples = [results.samples[track, name] for track in tracks if (track, name) in results.samples]
        if len(samples) == len(tracks):
            regrets = [values for sample in samples if np.isfinite(values := sample["mean_regret"]).any()]
            means[name] = estimate([sample["digits"] for sample in samples]), estimate(regrets)
    return means


def track_tables(results: Results, track: Track) -> list[Table]:
    """Return a table per block of metrics of a track, without the metrics and the policies that have no value there."""
    names = [name for name in order_policies(results) if (track.name, name) in results.samples]
    blocks: dict[str, list[Column]] = {}
    for metric in METRICS.values():
        cells = {_mark_oracle(results, name): Cell.of(results.summary(track.name, name, metric.name)) for name in names}
        if any(cell.value is not None for cell in cells.values()):
            blocks.setdefault(metric.block, []).append(Column(metric.label, cells, metric.meaning))
    rows = tuple(_mark_oracle(results, name) for name in names)
    notes = _without_values(results, track.name)
    return [
        Table(f"{track.name}: {block.lower()}", "policy", rows, tuple(columns), () if index else notes)
        for index, (block, columns) in enumerate(blocks.items())
    ] or [Table(f"{track.name}: no policy has values", "policy", (), (), notes)]


def _without_values(results: Results, track: str) -> tuple[str, ...]:
    """Return a note for each reason why policies have no values on a track."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for verdict, places in (("n/a", results.not_applicable), ("failed", results.failures)):
        for (place, policy), reason in places.items():
            if place == track:
                reasons.setdefault((verdict, reason), []).append(policy)
    return tuple(f"{verdict}: {', '.join(policies)}: {reason}" for (verdict, reason), policies in reasons.items())


def leaderboard_table(results: Results) -> Table | None:
    """Return the scores of the policies of a suite over all tracks; ``None`` for a comparison, which has none."""
    board = leaderboard(results)
    if board is None:
        return None
    rows = {_mark_oracle(results, row.policy): row for row in board}

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


def _mark_oracle(results: Results, name: str) -> str:
    return f"{name} *" if results.policies[name].is_oracle else name


def certificate_tables(certificate: Certificate) -> tuple[Table, Table]:
    """Return the paper's assumptions with the number that decides each, and the predictions of a certificate."""
    assumptions = text_table(
        f"{certificate.scenario}: what the paper assumes",
        "",
        ("verdict", "assumption", "decided by"),
        (
            (check.name, check.verdict, check.statement, f"{number(check.value)}: {check.meaning}")
            for check in certificate.assumptions
        ),
    )
    clock, step = ("s", "Θ") if certificate.clock == "effective" else ("t", "Δt")
    rows = {"the law's own condition": "it promises nothing"}
    if (condition := certificate.condition) is not None:
        verdict = "holds" if condition.holds else "fails (sufficient, not necessary)"
        rows = {condition.name: f"{number(condition.value)} against {number(condition.bound)}: {verdict}"}
    if certificate.rate is not None:
        rows[f"rate r, error ~ e^(−r {clock})"] = number(certificate.rate)
    if certificate.digits is not None:
        exactness = "exact" if certificate.digits_are_exact else "not exact, see the notes"
        rows["digits at the deadline"] = f"{number(certificate.digits)} ({exactness})"
    if certificate.largest_step is not None:
        stable = "none" if certificate.largest_stable_step is None else number(certificate.largest_stable_step)
        rows[f"largest step {step}, and the largest stable one"] = f"{number(certificate.largest_step)}, {stable}"
    rows["short of the deadline, 1 − t_K/T"] = f"{certificate.shortfall:.3%}"
    notes = tuple(f"Note: {note}" for note in certificate.notes)
    title = f"{certificate.scenario}: {certificate.law}"
    return assumptions, text_table(title, "prediction", ("value",), rows.items(), notes)


def verification_tables(verification: Verification) -> tuple[Table, Table]:
    """Return whether the tables of results follow from their samples, and the jobs that were run again."""
    shown = [("differs", text) for text in verification.differences[:_SHOWN_DIFFERENCES]]
    if (hidden := len(verification.differences) - _SHOWN_DIFFERENCES) > 0:
        shown.append(("differs", f"{hidden} more numbers or texts"))
    rebuilt = text_table(
        "Tables rebuilt from the samples",
        "",
        ("verdict", ""),
        ((str(index), *texts) for index, texts in enumerate(shown or [("agree", "every number follows")], 1)),
    )
    rows = (
        (
            f"{job.track}: {job.policy}" + f", training seed {job.training_seed}" * (job.training_seed > 0),
            _verdict(job, same_arithmetic=verification.same_arithmetic),
            number(job.difference),
            job.reason or "",
        )
        for job in verification.repetitions
    )
    title = f"{len(verification.repetitions)} of {verification.jobs} jobs were run again"
    note = "The processor, BLAS or libraries differ, so rounding does too, and jobs agree where intervals overlap."
    notes = () if verification.same_arithmetic else (note,)
    return rebuilt, text_table(title, "job", ("verdict", "largest difference", "reason"), rows, notes)


def _verdict(repetition: Repetition, *, same_arithmetic: bool) -> str:
    if not repetition.agrees:
        return "differs" if repetition.reason is None else "fails"
    return "reproduces" if same_arithmetic else "agrees within its intervals"
