"""Options and arguments that several commands share, and the words that the shell completes."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from json import loads
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from ptne_env.cli.console import keep_stdout
from ptne_env.evaluation import POLICIES
from ptne_env.shared.parts import foreign_targets, is_part
from ptne_env.suites.suite import find_scenario, world_names
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.scenario import Scenario

World: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario by name, or a track such as ptne-v1/liar; see 'ptne list'. 'module:object' runs code of that "
        "module.",
        autocompletion=world_names,
    ),
]
Policy: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="A policy by name, .onnx or .npz file; a Stable-Baselines3 .zip and a 'module:object' run own code.",
        autocompletion=lambda: list(POLICIES),
    ),
]
Seed: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed of the random starts, games and noise.")]
Trust: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--trust",
        help="Run code from outside the library without asking: each 'module:object' and each .zip that is named. It "
        "runs with your rights.",
    ),
]
Json: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        callback=keep_stdout,
        help="Write the results as JSON to this file; '-' for stdout, where nothing else is printed then.",
    ),
]

Changes: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help="Change a field of the scenario, such as deadline=2, start=random or players=7; repeat for several.",
    ),
]


def changed(scenario: str, changes: Iterable[str] | None, *, trust: bool) -> Scenario:
    """A scenario by name with fields of ``--set``, which its name tells too. Values are JSON, or else texts.

    Raises:
        ValueError: for a change of another form, an unknown field, or code that is not trusted.
    """
    found: dict[str, Any] = {}
    for change in changes or ():
        field, equals, text = change.partition("=")
        if not equals:
            raise ValueError(f"--set takes FIELD=VALUE, such as deadline=2; got {change!r}")
        try:
            found[field] = loads(text)
        except ValueError:
            found[field] = text
    texts = [value for value in found.values() if isinstance(value, str)]
    trusted([*foreign_names(*texts), *foreign_targets(found)], trust=trust)
    chosen = find_scenario(scenario)
    return get_scenario(chosen, **{"name": " ".join([chosen.name, *(changes or ())]), **found})


def foreign_names(*names: str | None) -> list[str]:
    """The names that run code from outside the library: a ``"module:object"``, or an archive. Nothing is imported.

    Args:
        names: of policies, scenarios, suites and tracks (``"module:object/track"``), as commands take them.
    """
    found = []
    for name in filter(None, names):
        path = name.partition("=")[2] or name
        target = name.partition("/")[0]
        if path.endswith(".zip"):
            found.append(path)
        elif ":" in target and not path.endswith((".onnx", ".npz")) and not is_part(target):
            found.append(target)
    return found


def trusted(foreign: Iterable[str], *, trust: bool) -> bool:
    """Whether code from outside the library may run; without ``--trust``, a terminal is asked.

    If it may, ``module:object`` also finds files of the current folder, after all others.

    Args:
        foreign: the ``module:object`` and the files that hold such code.
        trust: the value of ``--trust``.

    Raises:
        ValueError: when there is such code, no trust and no terminal.
        typer.Abort: when the answer is no.
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
