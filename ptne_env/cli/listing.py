"""``ptne list``: show the scenarios, policies, metrics and tracks of suites."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from itertools import groupby
from typing import Annotated

import typer
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, console, write_json
from ptne_env.evaluation import METRICS, OPTIONAL, POLICIES
from ptne_env.evaluation.tracks import get_suite
from ptne_env.shared.parts import names_of
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS
from ptne_env.world.world import World

MOST_LINES = 40
"""The number of names of a group that 'ptne list' prints without being asked for the kind."""


class Kind(StrEnum):
    """The kinds of names, in the order in which they are listed."""

    SCENARIOS = "scenarios"
    POLICIES = "policies"
    METRICS = "metrics"
    SUITES = "suites"


def _entries(kind: Kind) -> Iterator[tuple[str, str, str]]:
    """Yield the names of a kind, each with a sentence and facts, which may be empty."""
    match kind:
        case Kind.SCENARIOS:
            for name, scenario in CATALOGUE.items():
                world = World(scenario)
                graphs = "a fixed graph" if world.topology.is_fixed else f"{len(world.topology.graphs)} graphs"
                facts = f"{world.game.num_players} players, {graphs}, T = {scenario.deadline:g} s"
                yield name, DESCRIPTIONS[name], f"{type(world.game).__name__}, {facts}"
        case Kind.POLICIES:
            for spec in POLICIES.values():
                source = spec.to_dict()["training_seeds"][0]
                arguments = ", ".join(f"{name} = {value}" for name, value in source["arguments"].items())
                yield spec.name, spec.description, f"{source['target']} {arguments}".strip()
        case Kind.METRICS:
            for name, metric in (METRICS | OPTIONAL).items():
                better = metric.direction and f"{metric.direction} is better"
                asked = "where registered" if name in OPTIONAL else None
                yield name, metric.meaning, ", ".join(filter(None, (metric.unit, better, asked)))
        case Kind.SUITES:
            for name in names_of("suite"):
                yield from ((f"{name}/{track.name}", track.change, "") for track in get_suite(name).tracks)


@app.command("list")
def list_(
    kind: Annotated[
        list[Kind] | None,
        typer.Argument(help="The kinds to explain in full; if left out, all names, with a line of each but suites."),
    ] = None,
    json: options.JsonOption = None,
) -> None:
    """Show the scenarios, policies, metrics and tracks of suites; 'ptne list policies' explains all policies."""
    check_writable(json)
    listed = {name: list(_entries(name)) for name in kind or Kind}
    objects = {
        name: {entry: {"description": sentence, "facts": facts} for entry, sentence, facts in entries}
        for name, entries in listed.items()
    }
    write_json(json, objects)
    screen = console()
    for heading, entries in listed.items():
        screen.print(Text(f"{heading.capitalize()}\n", style="italic"))
        if not kind:
            _print_lines(entries)
            continue
        for name, *texts in entries:
            screen.print(Text(name, style="bold"))
            for text, style in zip(texts, ("", "dim"), strict=True):
                if text:
                    screen.print(Padding(Text(text, style), (0, 0, 0, 4)))
        screen.print()


def _print_lines(entries: Sequence[tuple[str, str, str]]) -> None:
    """Print names with as much of their sentences as a line has room for; of very many tracks, the first ones."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), expand=True)
    table.add_column(no_wrap=True, style="bold", min_width=max(len(name) for name, *_ in entries))
    table.add_column(no_wrap=True, overflow="ellipsis", ratio=1)
    for _, tracks in groupby(entries, key=lambda entry: entry[0].rpartition("/")[0]):
        rows = list(tracks)
        for name, sentence, _ in rows if len(rows) <= MOST_LINES else rows[:3]:
            table.add_row(Text(name), Text(sentence))
        if len(rows) > MOST_LINES:
            table.add_row("", Text(f"and {len(rows) - 3} more: 'ptne list suites'"))
    console().print(table, "")
