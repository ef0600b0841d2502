"""Measure the best known digits of every track of a suite, and whether it can still tell good policies from better.

Run it with ``python baselines/best_known.py``. It plays all laws and the shipped learned policies on the suite with two
seeds, and prints the table of tracks, the numbers that the suite stores when it is frozen, the agreement of the two
rankings, and the time. Jobs that are stored already are not run again.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from common import Jobs, Ray, board_of, table

from ptne_env.evaluation import Results, Workers, run_suite
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.policy_specs import suite_policies
from ptne_env.evaluation.saturation import agreement, closed_tracks


def saturation_table(results: Results) -> list[str]:
    """A row per track: zero input, the three best honest entries, the best coded one, the ceiling and the room."""
    board = board_of(results)
    rows = []
    for scale in board.scales:
        means = {
            name: float(values[results.suite.track(track).metric].mean())
            for (track, name), values in results.samples.items()
            if track == scale.track
        }
        best = [
            sorted((name for name in means if results.policies[name].division == division), key=lambda n: -means[n])
            for division in ("honest", "coded")
        ]
        shown = [
            f"{number(means[name])} {name}" for names, most in zip(best, (3, 1), strict=True) for name in names[:most]
        ]
        rows.append([scale.track, number(scale.zero), *shown, number(scale.highest), number(scale.room)])
    headings = ["track", "zero input", "best honest", "second", "third", "best coded", "ceiling", "room"]
    return table(headings, rows, texts=("track", "best honest", "second", "third", "best coded"))


def main(
    suite: str = "ptne-v2",
    seeds: Annotated[int, typer.Option(help="Seeds 0, 1, … of the episode sets.")] = 2,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("results") / "best-known",
    episodes: Annotated[int | None, typer.Option(help="Per track; the suite's own number if left out.")] = None,
    jobs: Jobs = 2,
    ray: Ray = None,
) -> None:
    """Run and print."""
    start = time.monotonic()
    boards, tables = [], []
    for seed in range(seeds):
        results = run_suite(
            suite, suite_policies(), episodes=episodes, seed=seed, folder=out, workers=Workers(jobs, ray)
        )
        boards.append(board_of(results))
        tables.append(saturation_table(results))
    typer.echo("\n".join(tables[0]))
    typer.echo("\n_BEST_KNOWN = {")
    for scale in boards[0].scales:
        typer.echo(f'    "{scale.track}": {scale.best_digits:.2f},  # {scale.best}')
    typer.echo("}\n")
    for track, reason in closed_tracks(boards[0].scales).items():
        typer.echo(f"Track {track} is closed: {reason}.")
    for board in boards[1:]:
        typer.echo(f"Kendall's τ between the rankings of seed 0 and of another: {agreement(boards[0], board):.3f}")
    typer.echo(f"{time.monotonic() - start:.0f} s with {jobs} workers, stored jobs included.")


if __name__ == "__main__":
    typer.run(main)
