"""``ptne sweep``: phase diagrams."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptne_env.bench import report
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, progress, say, write_json
from ptne_env.evaluation.sweep import SWEEPS, run_sweep
from ptne_env.evaluation.workers import Workers


@app.command()
def sweep(
    diagram: Annotated[
        list[str] | None,
        typer.Argument(
            help=f"The diagrams: {', '.join(SWEEPS)}. All if left out.", autocompletion=lambda: list(SWEEPS)
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(help="Folder of the pictures and of the finished points, from which an interrupted run goes on."),
    ] = Path("results/sweep"),
    points: Annotated[int, typer.Option(min=2, help="Points along each axis.")] = 14,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per point, from random starts.")] = 8,
    seed: options.Seed = 0,
    jobs: options.Jobs = -1,
    ray: options.Ray = None,
    json: options.Json = None,
) -> None:
    """Draw phase diagrams: digits at the deadline over two parameters, as measured and as predicted.

    gain-step is over κ and the step Θ, noise-horizon over noise and s_end, dwell-gain over dwell time and c. Every
    point is a batch of episodes of the static law in the environment; docs/theory.md explains the lines.
    """
    workers = Workers(jobs, ray)
    chosen = diagram or list(SWEEPS)
    check_writable(json, *(out / f"{name}.png" for name in chosen))
    diagrams = []
    for name in chosen:
        with progress(name) as advance:
            diagrams.append(
                run_sweep(
                    name, points=points, episodes=episodes, seed=seed, folder=out, workers=workers, progress=advance
                )
            )
    for each in diagrams:
        report.save_diagram(each, out / f"{each.name}.png")
    write_json(json, f"[{', '.join(each.to_json() for each in diagrams)}]")
    for each in diagrams:
        difference = f"measured and predicted digits differ by at most {each.difference:.1g}"
        say(f"{each.name}: {difference}; {out / each.name}.png")
    if json is not None:
        say(f"Numbers written to {json}")
