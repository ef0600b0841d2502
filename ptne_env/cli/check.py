"""``ptne check``: rebuild the tables of results, and run a sample of the jobs again."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from ptne_env.bench import report
from ptne_env.cli import options
from ptne_env.cli.app import ExitCode, app
from ptne_env.cli.console import check_writable, console, json_text, progress, write_json
from ptne_env.evaluation.check import check as run_check
from ptne_env.evaluation.check import foreign_code


@app.command()
def check(
    results: Annotated[Path, typer.Argument(help="The file results.json of a comparison or suite, or its folder.")],
    *,
    sample: Annotated[int, typer.Option(min=1, help="Number of jobs to run again.")] = 5,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Largest |new − old|/(1 + |old|) of a number that counts as the same.")
    ] = 0.0,
    trust: options.Trust = False,
    json: options.Json = None,
) -> None:
    """Rebuild all tables of published results from the stored jobs, and run a random sample of the jobs again.

    Each of these jobs runs on the published episodes, where every number must repeat, and on as many fresh episodes,
    where the score must not be worse than chance allows.

    The exit code is 0 when everything agrees, 1 when something differs, and 3 when nothing differs but the files of
    some policies are missing, so that their jobs cannot run again.
    """
    check_writable(json)
    trust = options.trusted(foreign_code(results), trust=trust)
    with progress("checking") as advance:
        outcome = run_check(
            results,
            sample=sample,
            tolerance=tolerance,
            trust=trust,
            progress=lambda job, total: advance(total=total, description=job),
        )
    rows = [
        {
            "track": repetition.job.track.name,
            "policy": repetition.job.policy.name,
            "training_seed": repetition.job.training_seed,
            "difference": repetition.difference if isfinite(repetition.difference) else None,
            "failure": repetition.failure,
            "published": repetition.published,
            "fresh": repetition.fresh,
            "probability": repetition.probability,
            "passes": repetition.passes(tolerance),
        }
        for repetition in outcome.repetitions
    ]
    found = {"differences": outcome.differences, "missing": outcome.missing, "jobs": rows}
    write_json(json, json_text(found))
    screen = console()
    for table in report.check_tables(outcome, tolerance):
        screen.print(report.show(table, screen.width))
    if not outcome.passes(tolerance):
        raise typer.Exit(ExitCode.FILE if outcome.agrees(tolerance) else ExitCode.FAILED)
