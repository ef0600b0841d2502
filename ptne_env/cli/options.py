"""Options and arguments that several commands share, and the trust in code from outside the library."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from json import loads
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from ptne_env.cli.console import keep_stdout
from ptne_env.evaluation import POLICIES
from ptne_env.shared.parts import foreign_targets, is_part, read_call
from ptne_env.world.catalogue import get_scenario, scenario_names
from ptne_env.world.scenario import Scenario

ScenarioArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario by name, or a track such as ptne-v1/liar; see 'ptne list'. 'module:object' runs code of that "
        "module.",
        autocompletion=scenario_names,
    ),
]
PolicyArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="POLICY",
        help="A policy by name, as static or static(kappa=4), or an .npz file; a Stable-Baselines3 .zip and a "
        "'module:object' run their own code.",
        autocompletion=lambda: list(POLICIES),
    ),
]
SeedOption: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed of the random starts, games and noise.")]
TrustOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--trust",
        help="Run code from outside the library without asking: each 'module:object' and each .zip that is named. It "
        "runs with your rights.",
    ),
]
JsonOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        callback=keep_stdout,
        help="Write the results as JSON to this file, or to stdout for '-'; then nothing else is printed there.",
    ),
]
SetOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help="Change a field of the scenario, such as deadline=2, players=7 or channel=noise(std=0.1); repeat for "
        "several.",
    ),
]


def read_scenario(name: str, changes: Iterable[str] | None, *, trust: bool) -> Scenario:
    """Return a scenario by name with the fields of ``--set``, which its new name tells too."""
    values = read_changes(changes)
    texts = [value for value in values.values() if isinstance(value, str)]
    require_trust([*foreign_names(*texts), *foreign_targets(values)], trust=trust)
    scenario = get_scenario(name)
    return get_scenario(scenario, **{"name": " ".join([scenario.name, *(changes or ())]), **values})


def read_changes(changes: Iterable[str] | None) -> dict[str, Any]:
    """Return the values of ``--set`` by field: in ``FIELD=VALUE`` a value is JSON, or else a text."""
    values: dict[str, Any] = {}
    for change in changes or ():
        field, equals, text = change.partition("=")
        if not equals:
            raise ValueError(f"--set takes FIELD=VALUE, such as deadline=2; got {change!r}")
        try:
            values[field] = loads(text)
        except ValueError:
            values[field] = text
    return values


def split_policies(values: Iterable[str]) -> list[str]:
    """Return the names in values of ``--policy``, at whose commas they are split, but within parentheses."""
    names: list[str] = []
    for part in [part for value in values for part in value.split(",")]:
        if names and names[-1].count("(") > names[-1].count(")"):
            names[-1] += f",{part}"
        else:
            names.append(part)
    return [name for name in names if name]


def foreign_names(*names: str | None) -> list[str]:
    """Return the names, as commands take them, that run code from outside the library, without importing anything.

    They are each ``"module:object"`` (with tracks, ``"module:object/track"``) and each archive.
    """
    foreign = []
    for text in filter(None, names):
        name, arguments = read_call(text) or (text, {})
        foreign += foreign_targets(arguments)
        path = name.partition("=")[2] or name
        target = name.partition("/")[0]
        if path.endswith(".zip"):
            foreign.append(path)
        elif ":" in target and not path.endswith(".npz") and not is_part(target):
            foreign.append(target)
    return foreign


def require_trust(foreign: Iterable[str], *, trust: bool) -> bool:
    """Return whether code from outside the library may run, after asking the user where there is no ``--trust``.

    If it may, ``module:object`` also finds files of the current folder, after all others.

    Raises:
        ValueError: when there is such code, no ``--trust`` and no terminal on which to ask.
        typer.Abort: when the user does not trust the code.
    """
    named = ", ".join(dict.fromkeys(map(repr, foreign)))  # repr shows control characters as text
    if not named:
        return trust
    if not trust:
        if not sys.stdin.isatty():
            raise ValueError(f"{named} would run code from outside the library: say --trust if you trust it")
        typer.confirm(f"{named} will run code from outside the library. Do you trust it?", abort=True, err=True)
    sys.path.append(str(Path.cwd()))
    return True
