"""Tables for terminals, drawn with rich. Every function returns renderables and prints nothing."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Iterator, Sequence
from enum import StrEnum

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from ptne_env import learn as policies
from ptne_env.bench.report.answer import answer, answer_table
from ptne_env.bench.report.tables import (
    MARK_NOTES,
    MARKS,
    Column,
    Table,
    call,
    overview,
    summary_tables,
    track_rules,
    track_tables,
)
from ptne_env.evaluation import METRICS, POLICIES, Results, get_suite
from ptne_env.evaluation.check import Check, Repetition
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.policy_specs import PolicySpec, learned_policy
from ptne_env.evaluation.suite import SUITES
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS
from ptne_env.world.switching import SwitchingTopology
from ptne_env.world.world import World

_HEADING_WIDTH = 10
"""Headings of columns are broken into lines of about this length, long ones into three lines."""

_NAME_WIDTH = 24
"""Names of tracks in the table of the answer are broken at hyphens into lines of at most this length."""

_TEXT_WIDTH = 100
"""Sentences are broken into lines of at most this length."""

_GAP = 3
"""Columns of the terminal between two columns of a table."""

_EDGES = 2
"""Columns of the terminal beside the first and the last column of a table."""

_SHOWN_DIFFERENCES = 10
"""Differences of a check that are listed."""


def result_tables(results: Results, width: int = 172) -> Group:
    """The tables of every track, and the table over all tracks last.

    With a leaderboard the tables of a track show means alone, as intervals would double their length.

    Args:
        results: of a comparison or of another suite.
        width: columns of the terminal; a table that is wider is split by columns.
    """
    drawn: list[RichTable | Text] = []
    for track in results.tracks:
        drawn.append(Text.assemble((track.name, "bold"), f": {track_rules(results, track)}\n"))
        for table in track_tables(results, track):
            drawn += _drawn(table, width, intervals=results.leaderboard is None)
    total = summary_tables(results)
    overall = len(overview(results))
    for table in total[overall:]:
        drawn += _drawn(table, width, intervals=results.leaderboard is None)
    for table in total[:overall]:
        drawn += _drawn(table, width, intervals=True)
    divisions = {policy.division for policy in results.policies.values()}
    drawn += [Text(note, style="dim") for division, note in MARK_NOTES.items() if division in divisions]
    return Group(*drawn)


def answer_tables(results: Results, width: int = 172) -> Group:
    """One table of digits that fits the terminal, and three sentences on it.

    Args:
        results: of a comparison or of another suite.
        width: columns of the terminal; policies that find no room are named below the table.
    """
    table = answer_table(results)
    names = {name: textwrap.fill(name, _NAME_WIDTH) for name in table.rows}
    drawn: list[RichTable | Text] = [Text(table.caption, style="italic")]
    shown: list[Column] = []
    if table.columns:
        room = width - max(cell_len(line) for name in names.values() for line in name.splitlines()) - _EDGES
        shown = next(_split(table, room, intervals=False))
        drawn.append(_piece(table, names, shown, intervals=False))
    if hidden := [column.label for column in table.columns if column not in shown]:
        drawn.append(Text(f"A wider terminal, or --details, also shows {', '.join(hidden)}.", style="dim"))
    drawn += [Text(note, style="dim") for note in table.notes]
    sentences = (textwrap.fill(sentence, min(width, _TEXT_WIDTH)) for sentence in answer(results))
    return Group(*drawn, *(Text(f"\n{sentence}") for sentence in sentences), Text())


def _drawn(table: Table, width: int, *, intervals: bool) -> list[RichTable | Text]:
    """A table in as many pieces as the width asks for, and its notes."""
    names = {name: f"{name} {MARKS[division]}".rstrip() for name, division in table.rows.items()}
    room = width - max(map(cell_len, names.values()), default=0) - _EDGES
    return [
        Text(table.caption, style="italic"),
        *(_piece(table, names, columns, intervals=intervals) for columns in _split(table, room, intervals=intervals)),
        *(Text(note, style="dim") for note in table.notes),
        Text(),
    ]


def _split(table: Table, room: int, *, intervals: bool) -> Iterator[list[Column]]:
    """The columns of a table in groups that fit beside the names; a group has one column at least."""
    group: list[Column] = []
    left = room
    for column in table.columns:
        lines = [*_heading(column).splitlines()]
        for name in table.rows:
            lines += [*column[name].text.splitlines(), column[name].interval * intervals]
        needed = _GAP + max(map(cell_len, lines))
        if group and needed > left:
            yield group
            group, left = [], room
        group.append(column)
        left -= needed
    if group:
        yield group


def _piece(table: Table, names: dict[str, str], columns: Sequence[Column], *, intervals: bool) -> RichTable:
    piece = empty_table()
    piece.add_column(table.subject, no_wrap=True)
    for column in columns:
        piece.add_column(Text(_heading(column)), justify="right", no_wrap=True)  # Text, because brackets are no markup
    for section in table.sections.values():
        for name in section:
            cells = []
            for column in columns:
                cell = Text(column[name].text, justify="right")
                if intervals and column[name].interval:
                    cell.append(f"\n{column[name].interval}", style="dim")
                cells.append(cell)
            piece.add_row(Text(names[name]), *cells, end_section=name == section[-1])
    return piece


def _heading(column: Column) -> str:
    width = max(_HEADING_WIDTH, len(column.label) // 3 + 2)
    return textwrap.fill(column.label, width, break_long_words=False)


def empty_table(title: str | None = None, *, show_header: bool = True) -> RichTable:
    """A table without rows, in the style of all."""
    return RichTable(
        title=title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False, show_header=show_header, expand=False
    )


def check_tables(check: Check, tolerance: float) -> Group:
    """The outcome of a check: whether the tables follow from the jobs, and the jobs that were run again.

    Args:
        check: of :func:`~ptne_env.evaluation.check.check`.
        tolerance: the largest difference that counts as the same.
    """
    tables = empty_table("Tables that were rebuilt from the stored jobs", show_header=False)
    for text in check.differences[:_SHOWN_DIFFERENCES]:
        tables.add_row(Text("differs", "red"), Text(text))
    if (hidden := len(check.differences) - _SHOWN_DIFFERENCES) > 0:
        tables.add_row(Text("differs", "red"), Text(f"{hidden} more numbers or texts"))
    if not check.differences:
        tables.add_row(Text("agree", "green"), Text("every number follows from the stored jobs"))
    if check.left_out:
        tables.add_row(Text("left out", "yellow"), Text(", ".join(METRICS[name].heading for name in check.left_out)))
    for text in check.missing:
        tables.add_row(Text("not repeated", "yellow"), Text(text))
    jobs = empty_table("Jobs that were run again, on the published episodes and on fresh ones")
    jobs.add_column("job", overflow="fold")
    for heading in ("largest\ndifference", "published\nscore", "fresh\nscore", "p"):
        jobs.add_column(heading, justify="right", no_wrap=True)
    jobs.add_column("verdict", no_wrap=True)
    reasons = []
    for repetition in check.repetitions:
        job = repetition.job
        seed = f"\ntraining seed {job.training_seed}" * (job.training_seed > 0)
        jobs.add_row(
            Text(f"{job.track.name}\n{job.policy.name}{seed}"),
            number(repetition.difference),
            number(repetition.published),
            number(repetition.fresh),
            number(repetition.probability),
            _verdict(repetition, tolerance),
        )
        place = f"{job.policy.name} on {job.track.name}"
        if repetition.knows_episodes:
            reasons.append(Text(f"too good: {place} is better on the published episodes than on fresh ones"))
        elif repetition.failure is not None:
            reasons.append(Text(f"failed: {place}: {repetition.failure}"))
    return Group(tables, jobs, *reasons)


def _verdict(repetition: Repetition, tolerance: float) -> Text:
    if repetition.knows_episodes:
        return Text("too good", "red")
    if repetition.difference > tolerance:
        return Text("differs" if repetition.failure is None else "fails", "red")
    return Text("reproduces" if repetition.failure is None else "fails again", "green")


class Kind(StrEnum):
    """The kinds of names, in the order in which they are listed."""

    SCENARIOS = "scenarios"
    POLICIES = "policies"
    METRICS = "metrics"
    SUITES = "suites"


def catalogue(kinds: Collection[Kind] = tuple(Kind)) -> Group:
    """The scenarios, policies, metrics and suites: a sentence about each, and its facts, below its name.

    Args:
        kinds: those that are listed.
    """
    listings = {
        Kind.SCENARIOS: _scenarios,
        Kind.POLICIES: _policies,
        Kind.METRICS: _metrics,
        Kind.SUITES: _suites,
    }
    return Group(*(line for kind, lines in listings.items() if kind in kinds for line in lines()))


def _entry(name: str, sentence: str, facts: str = "") -> Iterator[RenderableType]:
    """A name, and below it a sentence and facts, which are wrapped at spaces."""
    yield Text(name, style="bold")
    for text in filter(None, (Text(sentence), Text(facts, style="dim"))):
        yield Padding(text, (0, 0, 0, 4))


def _scenarios() -> Iterator[RenderableType]:
    yield Text("Scenarios\n", style="italic")
    for name, scenario in CATALOGUE.items():
        world = World(scenario)
        game = f"{type(world.game).__name__}, {world.game.num_players} players"
        clock = f"T={scenario.deadline:g}s, c={scenario.gain:g}/s, {scenario.steps} steps, s_end={scenario.s_end:g}"
        yield from _entry(name, DESCRIPTIONS[name], f"{game}; {_topology(world.topology)}; {clock}")
    yield Text()


def _topology(topology: SwitchingTopology) -> str:
    if topology.is_fixed:
        return f"fixed graph, λ2={number(topology.union.algebraic_connectivity)}"
    unit = "s of t" if topology.clock == "physical" else "of s"
    return f"{len(topology.graphs)} graphs, {number(topology.mean_dwell)} {unit} each"


def _policies() -> Iterator[RenderableType]:
    yield Text("Policies: laws, references, and learned policies\n", style="italic")
    for spec in [*POLICIES.values(), *map(learned_policy, policies.shipped())]:
        made = f"learned on {', '.join(sorted(spec.scenarios))}" if spec.scenarios else call(spec)
        yield from _entry(spec.name, spec.description, "; ".join(filter(None, (made, _acts(spec)))))
    yield Text()


def _acts(spec: PolicySpec) -> str:
    """The interface where it is another one than that of most laws."""
    return f"interface {spec.interface.kind}" * (spec.interface.kind != "physical")


def _metrics() -> Iterator[RenderableType]:
    yield Text("Metrics\n", style="italic")
    for name, metric in METRICS.items():
        facts = [
            f"in {metric.unit}" if metric.unit else "",
            f"{metric.direction} is better" if metric.direction else "",
        ]
        yield from _entry(name, metric.meaning, "; ".join(filter(None, facts)))
    yield Text()


def _suites() -> Iterator[RenderableType]:
    for name in SUITES:
        suite = get_suite(name)
        yield Text(
            f"Suite {name}: tracks of {suite.episodes} episodes, each with its difference to the base\n", "italic"
        )
        for track in suite.tracks:
            yield from _entry(f"{name}/{track.name}", track.change)
        yield Text()
