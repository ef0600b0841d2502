"""Options and arguments that several commands share, and the words that the shell completes."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from ptne_env.bench.suite import world_names
from ptne_env.cli.console import keep_stdout
from ptne_env.evaluation import POLICIES
from ptne_env.shared.parts import is_part

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
