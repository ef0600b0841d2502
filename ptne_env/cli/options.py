"""Options and arguments that several commands share, and the words that the shell completes."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

from ptne_env import policies
from ptne_env.catalogue import CATALOGUE
from ptne_env.cli.console import keep_stdout
from ptne_env.experiments import POLICIES
from ptne_env.experiments.suite import SUITES, get_suite


def complete_world() -> list[str]:
    """Names of scenarios and of tracks of suites."""
    return [*CATALOGUE, *(f"{name}/{track.name}" for name in SUITES for track in get_suite(name).tracks)]


def complete_policy(incomplete: str) -> list[str]:
    """Names of policies, after a comma too."""
    done, comma, _ = incomplete.rpartition(",")
    return [f"{done}{comma}{name}" for name in [*POLICIES, *policies.shipped()]]


World: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario by name, or a track such as ptne-v1/delay; see 'ptne list'.",
        autocompletion=complete_world,
    ),
]
Policy: TypeAlias = Annotated[
    str,
    typer.Argument(help="A policy by name, an .onnx file, or 'module:object'.", autocompletion=complete_policy),
]
Seed: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed of the random starts, games and noise.")]
Jobs: TypeAlias = Annotated[int, typer.Option(help="Tasks at a time; -1 for one per core.")]
Ray: TypeAlias = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Run the tasks on a Ray cluster: auto, local, or HOST:6379."),
]
Trust: TypeAlias = Annotated[
    bool, typer.Option("--trust", help="Load .zip files without asking, which executes code in them.")
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
