"""``ptne list``: scenarios, policies, metrics and suites."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any

import typer
from rich.padding import Padding
from rich.text import Text

from ptne_env.bench.suite import SUITES, get_suite
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, console, json_text, write_json
from ptne_env.evaluation import METRICS, POLICIES
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS
from ptne_env.world.world import World


class Kind(StrEnum):
    """The kinds of names, in the order in which they are listed."""

    SCENARIOS = "scenarios"
    POLICIES = "policies"
    METRICS = "metrics"
    SUITES = "suites"


def _scenarios() -> dict[str, dict[str, Any]]:
    found = {}
    for name, scenario in CATALOGUE.items():
        world = World(scenario)
        graphs = "a fixed graph" if world.topology.is_fixed else f"{len(world.topology.graphs)} graphs"
        facts = f"{type(world.game).__name__}, {world.game.num_players} players, {graphs}, T = {scenario.deadline:g} s"
        found[name] = {"description": DESCRIPTIONS[name], "facts": facts, **scenario.to_dict()}
    return found


def _policies() -> dict[str, dict[str, Any]]:
    found = {}
    for spec in POLICIES.values():
        data = spec.to_dict()
        source = data["training_seeds"][0]
        arguments = ", ".join(f"{name} = {value}" for name, value in source.get("arguments", {}).items())
        found[spec.name] = {
            "description": spec.description,
            "facts": f"{source['target']} ({arguments})",
            **data,
        }
    return found


def _metrics() -> dict[str, dict[str, Any]]:
    return {
        name: {
            "description": metric.meaning,
            "facts": "; ".join(filter(None, (metric.unit, metric.direction and f"{metric.direction} is better"))),
            "unit": metric.unit,
            "direction": metric.direction,
        }
        for name, metric in METRICS.items()
    }


def _suites() -> dict[str, dict[str, Any]]:
    return {
        f"{name}/{track.name}": {"description": track.change, "facts": "", **track.to_dict()}
        for name in SUITES
        for track in get_suite(name).tracks
    }


_LISTS: dict[Kind, Callable[[], dict[str, dict[str, Any]]]] = {
    Kind.SCENARIOS: _scenarios,
    Kind.POLICIES: _policies,
    Kind.METRICS: _metrics,
    Kind.SUITES: _suites,
}


@app.command("list")
def list_(
    kind: Annotated[list[Kind] | None, typer.Argument(help="The kinds of names. All if left out.")] = None,
    json: options.Json = None,
) -> None:
    """Show the scenarios, policies, metrics and tracks of suites, each with a sentence."""
    check_writable(json)
    listed = {each: _LISTS[each]() for each in kind or Kind}
    write_json(json, json_text(listed))
    screen = console()
    for each, entries in listed.items():
        screen.print(Text(f"{each.capitalize()}\n", style="italic"))
        for name, entry in entries.items():
            screen.print(Text(name, style="bold"))
            for text in filter(None, (Text(entry["description"]), Text(entry["facts"], style="dim"))):
                screen.print(Padding(text, (0, 0, 0, 4)))
        screen.print()
