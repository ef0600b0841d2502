"""``ptne verify``: rebuild the tables of results, and run a sample of the jobs again."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ptne_env.cli import options
from ptne_env.cli.app import ExitCode, app
from ptne_env.cli.console import check_writable, console, progress, say, write_json
from ptne_env.evaluation.results import read_results
from ptne_env.execution.verification import SAMPLE
from ptne_env.execution.verification import verify as run_verification
from ptne_env.report.tables import verification_table
from ptne_env.report.terminal import draw_table
from ptne_env.shared.parts import foreign_targets, names_of


@app.command()
def verify(
    results: Annotated[Path, typer.Argument(help="The file results.json of a comparison or suite, or its folder.")],
    *,
    sample: Annotated[int, typer.Option(min=1, help="Number of jobs of every policy that run again.")] = SAMPLE,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, help="Seed of the fresh episodes and of the choice of jobs.", show_default="unpredictable, and shown"
        ),
    ] = None,
    trust: options.TrustOption = False,
    json: options.JsonOption = None,
) -> None:
    """Rebuild all tables of published results from their samples, and run some jobs of every policy again.

    On a machine with the same arithmetic every number must repeat; on another one rounding differs, and the differences
    in the same episodes must be those of chance. Policies that do not ship also play fresh episodes, on which they may
    not have fewer digits than chance explains.

    The exit code is 0 when everything agrees, and 1 when something differs. Where nothing could be compared, it is
    another one: 2 for wrong usage or an error of the program, 3 for a file that is missing, damaged or unreadable.
    """
    check_writable(json)
    data = read_results(results)
    trust = options.require_trust(foreign_targets(data), trust=trust)
    with progress("verifying") as advance:
        outcome = run_verification(results, sample=sample, seed=seed, trust=trust, progress=advance)
    jobs = [asdict(repetition) for repetition in outcome.repetitions]
    summary = {"differences": outcome.differences, "jobs": jobs, "of": outcome.jobs, "seed": outcome.seed}
    write_json(json, {**summary, "same_arithmetic": outcome.same_arithmetic})
    screen = console()
    screen.print(draw_table(verification_table(outcome), screen.width))
    is_published = data["name"] in names_of("suite")
    rules = "those of the published suite" if is_published else "its own: no suite of this name is published"
    say(f"The rules of {data['name']!r} are {rules}")
    say(f"{len(jobs)} of {outcome.jobs} jobs were run again; --seed {outcome.seed} repeats this verification")
    if not outcome.passes:
        raise typer.Exit(ExitCode.FAILED)
