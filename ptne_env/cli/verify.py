"""``ptne verify``: rebuild the tables of results, and run a sample of the jobs again."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ptne_env.cli import options
from ptne_env.cli.app import Command, ExitCode, app
from ptne_env.cli.console import check_writable, console, progress, say, write_json
from ptne_env.evaluation.results import read_results
from ptne_env.execution.verification import SAMPLE
from ptne_env.execution.verification import verify as run_verification
from ptne_env.report.tables import verification_tables
from ptne_env.report.terminal import draw_table
from ptne_env.shared.parts import foreign_targets


@app.command(cls=Command)
def verify(
    results: Annotated[Path, typer.Argument(help="The file results.json of a comparison or suite, or its folder.")],
    *,
    sample: Annotated[
        int, typer.Option(min=1, help="Number of jobs to run again for every policy; one for references.")
    ] = SAMPLE,
    trust: options.TrustOption = False,
    json: options.JsonOption = None,
) -> None:
    """Rebuild all tables of published results from their samples, and run some jobs of every policy again.

    On a machine with the same arithmetic every number must repeat; on another one rounding differs, and the intervals
    of every metric must overlap.

    The exit code is 0 when everything agrees, and 1 when something differs.
    """
    check_writable(json)
    trust = options.require_trust(foreign_targets(read_results(results)), trust=trust)
    with progress("verifying") as advance:
        outcome = run_verification(
            results, sample=sample, trust=trust, progress=lambda job, total: advance(total=total, description=job)
        )
    jobs = [asdict(repetition) for repetition in outcome.repetitions]
    summary = {"differences": outcome.differences, "jobs": jobs, "of": outcome.jobs}
    write_json(json, {**summary, "same_arithmetic": outcome.same_arithmetic})
    screen = console()
    for table in verification_tables(outcome):
        screen.print(draw_table(table, screen.width))
    say(f"{len(jobs)} of {outcome.jobs} jobs were run again")
    if not outcome.passes:
        raise typer.Exit(ExitCode.FAILED)
