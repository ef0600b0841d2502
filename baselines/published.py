"""The published numbers of ``results.csv``, and every table of README, docs and this folder that shows them."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from io import StringIO
from pathlib import Path
from typing import get_args

import numpy as np

from ptne_env import CATALOGUE
from ptne_env.evaluation import CODED, ENTERED, POLICIES
from ptne_env.evaluation.results import SHOWN as SHOWN_METRICS
from ptne_env.evaluation.results import Record, standing
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS, InterfaceKind
from ptne_env.shared.files import write_atomically
from ptne_env.suites.robustness import robustness
from ptne_env.world.world import World

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "baselines" / "results.csv"
TRAININGS = RESULTS.with_name("algorithms.csv")
"""The rows of :mod:`baselines.algorithms`, in the columns of ``results.csv``."""

INTERVAL = ("mean", "low", "high")
COLUMNS = ("suite", "track", "policy", "metric", *INTERVAL, "episodes")
SEEN, *FRESH = WORLDS = {"robustness": 1, "robustness-2": 2, "robustness-3": 3, "robustness-4": 4}
"""The suites of random worlds, and their seeds: on those of seed 1 laws may be tuned, the others are fresh."""

TRAINED, PPO = "recurrent-random-worlds", "ppo"
SHOWN = (
    *("static", "grounded", "routed-unknown", "relay", PPO, TRAINED),
    *("coded-relay", "coded-network", "oracle"),
)
"""The policies of the short table of the suite."""

SHOWN_ON_WORLDS = ("static", "grounded", "routed-unknown", "relay", TRAINED)
SHOWN_ON_SCENARIOS = ("static", "grounded", "routed-unknown", "relay", TRAINED, "oracle")
NEAR = 0.5
"""Digits by which a policy may miss the best one and is near."""

HEADINGS = "digits", "on the way", "worst tenth"
"""The headings of the metrics that every table shows."""

MINUS_PAPER = "digits_minus_static"
"""The digits of a policy minus those of the paper's law in the same episodes."""

LEAD = "lead"
"""The digits of the best of the best law, ``PPO`` and ``TRAINED`` minus those of the second."""

ALL = "all"
"""The track of scores, which are over all tracks."""

TRAINING_METRICS = "spread", "seeds", "million_agent_steps", "core_minutes", "last_gain"
"""Of an algorithm on a track: the standard deviation of the digits over seeds, the number of seeds, and the budget, the
time and the gain of the last fifth of one."""

Row = dict[str, str]


def interval_of(statistic: Summary | Record) -> Row:
    """The columns of a mean; empty ends where it has no interval."""
    numbers = statistic if isinstance(statistic, dict) else vars(statistic)
    return {key: "" if numbers[key] is None else f"{numbers[key]:.7g}" for key in INTERVAL}


def write_rows(path: Path, rows: Iterable[Row], columns: Sequence[str] = COLUMNS) -> None:
    """Write rows in columns, those of ``results.csv`` if left out."""
    text = StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue())


class Published:
    """The rows of ``results.csv``."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = rows
        self._cells = {(row["suite"], row["track"], row["policy"], row["metric"]): row for row in rows}
        self._names: dict[tuple[str, str], dict[str, None]] = {}
        for row in rows:
            for key in ("track", "policy") * (row["track"] != ALL):
                self._names.setdefault((key, row["suite"]), {})[row[key]] = None

    def names(self, key: str, suite: str) -> list[str]:
        """The tracks or policies of a suite, in the order of the file."""
        return list(self._names.get((key, suite), ()))

    def cell(self, suite: str, track: str, policy: str, metric: str = "digits") -> Row | None:
        """A number on a track, or over all (:data:`ALL`)."""
        return self._cells.get((suite, track, policy, metric))

    def by_policy(self, suite: str, track: str, metric: str = "digits") -> dict[str, Row]:
        """The numbers of all policies that have one on a track."""
        cells = {policy: self.cell(suite, track, policy, metric) for policy in self.names("policy", suite)}
        return {policy: cell for policy, cell in cells.items() if cell is not None}

    def ranked(self, suite: str, track: str) -> list[str]:
        """The policies that act on a track, the best first, as the leaderboard has them."""
        digits, on_the_way = (self.by_policy(suite, track, metric) for metric in SHOWN_METRICS[:2])
        return sorted(digits, key=lambda name: standing(summary(digits[name]), summary(on_the_way.get(name))))


def plain(row: Row | None) -> str:
    """The mean; a dash where there is none."""
    return "–" if row is None else f"{float(row['mean']):.2f}"


def with_interval(row: Row | None) -> str:
    """The mean with its 95 % interval."""
    if row is None or not row["low"]:
        return plain(row)
    mean, low, high = (f"{float(row[key]):.2f}" for key in ("mean", "low", "high"))
    return mean if low == high else f"{mean} [{low}, {high}]"


def summary(row: Row | None) -> Summary | None:
    """The mean and its interval as numbers."""
    return row and Summary(*(float(row[key]) if row[key] else None for key in ("mean", "low", "high")))


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column is text."""
    return "\n".join(
        f"| {' | '.join(cells)} |" for cells in (headings, ["---", *["---:"] * (len(headings) - 1)], *rows)
    )


def by_track(numbers: Published, suite: str, policies: Sequence[str]) -> str:
    """A row per track and a column per policy; of a suite also the means over all scored tracks."""
    rows = [
        [track, *(plain(numbers.cell(suite, track, policy)) for policy in policies)]
        for track in numbers.names("track", suite)
    ]
    if numbers.by_policy(suite, ALL):
        rows += [
            [label, *(plain(numbers.cell(suite, ALL, policy, metric)) for policy in policies)]
            for label, metric in zip(("**score**", *HEADINGS[1:]), SHOWN_METRICS, strict=True)
        ]
    return markdown([suite.replace("comparison", "scenario"), *(POLICIES[name].label for name in policies)], rows)


def best_law(numbers: Published, suite: str, track: str) -> tuple[str, Row]:
    """The best law of a track, and its digits."""
    rows = numbers.by_policy(suite, track)
    laws = {name: row for name, row in rows.items() if POLICIES[name].is_law}
    return max(laws.items(), key=lambda item: float(item[1]["mean"]))


def headline(numbers: Published) -> str:
    """The paper's law, the best law, PPO and the recurrent network on each track of ptne-v1.

    Of the last three, the one that leads is bold: the interval of its paired difference from the second is above 0.
    """
    rows = []
    for track in (*numbers.names("track", "ptne-v1"), ALL):
        name, _ = best_law(numbers, "ptne-v1", track)
        cells = [plain(numbers.cell("ptne-v1", track, "static"))]
        for policy in (name, PPO, TRAINED):
            lead = summary(numbers.cell("ptne-v1", track, policy, LEAD))
            text = f"{plain(numbers.cell('ptne-v1', track, policy))}{f' {name}' * (policy == name)}"
            cells.append(f"**{text}**" if lead and lead.is_above_zero else text)
        rows.append(["**score**" if track == ALL else track, *cells])
    columns = "the paper's law", "best law", "PPO trained on the track", "one network for all tracks"
    return markdown(["track", *columns], rows)


def overall(numbers: Published) -> str:
    """Scores and ranks of all policies on ptne-v1, in the order of the leaderboard."""
    place = "ptne-v1", ALL, "digits"
    scored = [row["policy"] for row in numbers.rows if (row["suite"], row["track"], row["metric"]) == place]
    rows = [
        [
            POLICIES[policy].label,
            *(with_interval(numbers.cell("ptne-v1", ALL, policy, metric)) for metric in SHOWN_METRICS),
            plain(numbers.cell("ptne-v1", ALL, policy, "rank")),
        ]
        for policy in scored
    ]
    return markdown(["policy", "score", *HEADINGS[1:], "mean rank"], rows)


def algorithms(numbers: Published) -> str:
    """What algorithms of reinforcement learning reach on the tracks on which they were trained, and at what price."""
    suite, rows = "algorithms", []
    for track in numbers.names("track", suite):
        for policy, row in numbers.by_policy(suite, track).items():
            spread, *counts, gain = (
                float(numbers.by_policy(suite, track, metric)[policy]["mean"]) for metric in TRAINING_METRICS
            )
            seeds, millions, minutes = counts
            numbers_of_runs = f"{seeds:.0f}", f"{millions:.0f} M", f"{minutes:.1f}", f"{gain:.2f}"
            rows.append([track, policy, with_interval(row), f"{spread:.2f}", *numbers_of_runs])
    columns = "digits", "spread", "seeds", "agent-steps", "core minutes", "last fifth gained"
    return markdown(["track", "algorithm", *columns], rows)


def best_on(numbers: Published, suite: str, world: str) -> tuple[str, float]:
    """The best ranked policy of a random world and its digits, but for standing still."""
    rows = numbers.by_policy(suite, world)
    rivals = [name for name in rows if POLICIES[name].is_ranked and name != "zero-input"]
    return max(((name, float(rows[name]["mean"])) for name in rivals), key=lambda item: item[1])


def fails(numbers: Published, suite: str, world: str, policy: str) -> bool:
    """Whether the paper's law leads a policy in the same episodes, or the policy diverges more often."""
    difference = summary(numbers.cell(suite, world, policy, MINUS_PAPER))
    is_worse = difference is not None and difference.high is not None and difference.high < 0
    diverged = numbers.by_policy(suite, world, "diverged_share")
    share, paper = (float(diverged[name]["mean"]) if name in diverged else 0.0 for name in (policy, "static"))
    return is_worse or share > paper


def failures(numbers: Published, suites: Iterable[str], policy: str) -> list[tuple[str, str]]:
    """The suites and names of the random worlds on which a policy fails."""
    places = [(suite, world) for suite in suites for world in numbers.names("track", suite)]
    return [place for place in places if fails(numbers, *place, policy)]


def shortfalls(numbers: Published, suites: Sequence[str]) -> str:
    """How far each policy stays behind the best one of each random world, the least mean shortfall first."""
    rows = []
    for policy in dict.fromkeys(name for suite in suites for name in numbers.names("policy", suite)):
        behind = [
            best_on(numbers, suite, world)[1] - float(cell["mean"])
            for suite in suites
            for world in numbers.names("track", suite)
            if (cell := numbers.cell(suite, world, policy)) is not None
        ]
        if behind and policy != "oracle":
            near, count = sum(shortfall <= NEAR for shortfall in behind), len(failures(numbers, suites, policy))
            interval = with_interval(interval_of(estimate([np.array([behind])])))
            cells = [POLICIES[policy].label, str(count), f"{near} of {len(behind)}", interval, f"{max(behind):.2f}"]
            rows.append((sum(behind) / len(behind), cells))
    headings = ["policy", "failures", f"within {NEAR} of the best", "mean shortfall", "worst shortfall"]
    return markdown(headings, [cells for _, cells in sorted(rows)])


def failed_worlds(numbers: Published) -> str:
    """A row per random world on which one of some policies fails: its description, their digits, and the best."""
    rows = []
    for suite, seed in WORLDS.items():
        sentences = {track.name: track.change for track in robustness(seed).tracks}
        for world in numbers.names("track", suite):
            failing = [policy for policy in SHOWN_ON_WORLDS if fails(numbers, suite, world, policy)]
            if failing:
                digits = {policy: plain(numbers.cell(suite, world, policy)) for policy in SHOWN_ON_WORLDS}
                name, best = best_on(numbers, suite, world)
                marked = [f"**{text}**" if policy in failing else text for policy, text in digits.items()]
                rows.append([f"{suite}/{world}: {sentences[world]}", *marked, f"{name} {best:.2f}"])
    return markdown(["world", *SHOWN_ON_WORLDS, "best"], rows)


def rows_by_policy(numbers: Published, suite: str) -> str:
    """A row per policy and a column per track."""
    names = numbers.names("track", suite)
    rows = [
        [POLICIES[policy].label, *(plain(numbers.cell(suite, name, policy)) for name in names)]
        for policy in numbers.names("policy", suite)
    ]
    return markdown(["policy", *names], rows)


def all_policies(numbers: Published, suite: str) -> str:
    """All policies on every track, the best first, with intervals."""
    rows = [
        [
            track,
            POLICIES[policy].label,
            *(with_interval(numbers.cell(suite, track, policy, metric)) for metric in SHOWN_METRICS),
        ]
        for track in numbers.names("track", suite)
        for policy in numbers.ranked(suite, track)
    ]
    return markdown([suite.replace("comparison", "scenario"), "policy", *HEADINGS], rows)


def fields(_: Published) -> str:
    """The fields of the observation, and where they are under each kind of interface, in ``energy``."""
    kinds = get_args(InterfaceKind)
    slices = [Encoder(World(CATALOGUE["energy"]), kind).layout.slices for kind in kinds]
    rows = [["Slice", "Size", *(f"`{kind}`" for kind in kinds), "Content"], ["---"] * (len(kinds) + 3)]
    for name, field in FIELDS.items():
        places = [f"{part[name].start}:{part[name].stop}" if name in part else "–" for part in slices]
        rows.append([f"`{name}`", field.size, *places, field.content])
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


TABLES: dict[str, Callable[[Published], str]] = {
    "fields": fields,
    "headline": headline,
    "ptne-v1": lambda numbers: by_track(numbers, "ptne-v1", SHOWN),
    "ptne-v1-overall": overall,
    "ptne-v1-tracks": lambda numbers: all_policies(numbers, "ptne-v1"),
    "robustness": lambda numbers: shortfalls(numbers, WORLDS),
    "robustness-seen": lambda numbers: shortfalls(numbers, [SEEN]),
    "robustness-fresh": lambda numbers: shortfalls(numbers, FRESH),
    "robustness-failures": failed_worlds,
    "edge-cases": lambda numbers: rows_by_policy(numbers, "edge-cases"),
    "directed-graphs": lambda numbers: rows_by_policy(numbers, "directed-graphs"),
    "algorithms": algorithms,
    "catalogue": lambda numbers: by_track(numbers, "comparison", SHOWN_ON_SCENARIOS),
    "catalogue-all": lambda numbers: all_policies(numbers, "comparison"),
}
"""The tables by name."""


def fill_tables(text: str, numbers: Published) -> str:
    """A document with its tables.

    Raises:
        KeyError: for a table of an unknown name.
    """
    return fill_marks(text, "table", "end", lambda name: TABLES[name](numbers))


def fill_marks(text: str, kind: str, end: str, content_of: Callable[[str], str]) -> str:
    """A document with the content of each name between its mark, ``<!-- kind NAME -->``, and the end."""
    mark = re.compile(rf"(<!-- {kind} ([\w-]+) -->(\n?)).*?(<!-- {end} -->)", re.DOTALL)
    return mark.sub(lambda match: f"{match[1]}{content_of(match[2])}{match[3]}{match[4]}", text)


def missing(numbers: Published) -> list[str]:
    """The named policies and the scenarios that have no published numbers yet."""
    known = {row[key] for row in numbers.rows for key in ("policy", "track")}
    return [name for name in (*ENTERED, *CODED, *CATALOGUE) if name not in known]


def documents() -> list[Path]:
    """The documents with tables."""
    return [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md")), *sorted(ROOT.glob("baselines/*.md"))]


def read(path: Path = RESULTS) -> Published:
    """The published numbers, with those of the algorithms."""
    rows: list[Row] = []
    for source in (path, TRAININGS):
        with source.open(encoding="utf-8", newline="") as file:
            rows += csv.DictReader(file)
    return Published(rows)
