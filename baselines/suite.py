"""Run every law and every learned policy on the suite ``ptne-v1`` and write its leaderboard.

Run it with ``python baselines/suite.py`` after ``python baselines/run.py``, which trains the policies, five seeds of
each. Cells that are there already are not run again. ``ptne-v1.md`` beside this file is its output. The folder
``results/ptne-v1`` holds every number of every episode, and ``ptne compare --check results/ptne-v1`` runs some of them
again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from run import ONE_SEED

from ptne_env.experiments import ENTRIES
from ptne_env.experiments.benchmark import run_suite
from ptne_env.experiments.leaderboard import Leaderboard, leaderboard
from ptne_env.experiments.statistics import Summary
from ptne_env.experiments.workers import Workers
from ptne_env.files import write_atomically
from ptne_env.report.tables import number

HERE = Path(__file__).parent
SUITE = "ptne-v1"

_INTRODUCTION = (
    "Written by `python baselines/suite.py`; do not edit. Suite `{suite}` (content hash `{hash}`), {episodes} test "
    "episodes per track from seed {seed}, learned policies with every training seed; intervals of 95 % as "
    "`docs/protocol.md` says. Learned policies are `ppo-<configuration>`, configurations in "
    "`ptne_env/training/configurations`."
)


def configurations(runs: Path) -> dict[str, str]:
    """What names the training seeds of every configuration, by name of the policy."""
    from ptne_env.training import ppo

    return {
        f"ppo-{name}": str(runs / name / "seed-*" / "policy.onnx")
        for name in ppo.configurations()
        if name not in ONE_SEED
    }


def overview(board: Leaderboard, learned: set[str]) -> list[str]:
    """A row per track: the best law, the best learned policy, the paper's law and the oracle."""
    lines = [
        "| track | the paper's law | best law | best learned policy | learned over best law | oracle |",
        "| --- | ---: | --- | --- | ---: | ---: |",
    ]
    oracles = {name for name, participant in board.run.participants.items() if participant.is_oracle}
    for track in board.run.tracks:
        means = {
            row.policy: row.metrics[track.metric].mean
            for row in board.rows
            if row.track == track.name and row.metrics is not None
        }
        law = max(means.keys() - learned - oracles, key=lambda name: means[name])
        policy = max(means.keys() & learned, key=lambda name: means[name], default=None)
        trained = ["n/a", ""]
        if policy is not None:
            trained = [f"{number(means[policy])} {policy}", number(means[policy] - means[law])]
        cells = [track.name, number(means["static"]), f"{number(means[law])} {law}", *trained, number(means["oracle"])]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def track_table(board: Leaderboard, name: str) -> list[str]:
    """Everybody on one track, the best first."""
    track = board.run.suite.track(name)
    metric = track.metric.replace("_", " ")
    by = "time to 1e-6" if name in board.saturated else metric
    lines = [
        f"## {name}",
        "",
        f"{track.change} Ranked by {by}.",
        "",
        f"| rank | policy | {metric} | score | P(better than static) | to 1e-6 [s] | diverged |",
        "| ---: | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    rows = [row for row in board.rows if row.track == name]
    for row in sorted(rows, key=lambda row: (row.metrics is None, row.rank or 0)):
        if row.metrics is None:
            lines.append(f"| | {row.policy} | n/a | | | | |")
            continue
        cells = ["" if row.rank is None else str(row.rank), row.policy, _cell(row.metrics[track.metric])]
        cells += [_cell(row.score), _cell(row.improvement), number(row.fine_time)]
        lines.append(f"| {' | '.join([*cells, number(row.metrics['diverged_share'].mean)])} |")
    return [*lines, ""]


def overall_table(board: Leaderboard) -> list[str]:
    """Scores over the common tracks."""
    lines = [
        "| policy | score, interquartile mean | P(better than static) | mean rank |",
        "| --- | ---: | ---: | ---: |",
    ]
    for row in board.overall:
        rank = "" if row.mean_rank is None else number(row.mean_rank)
        lines.append(f"| {row.policy} | {_cell(row.score)} | {_cell(row.improvement)} | {rank} |")
    return [*lines, "", f"Over {len(board.common)} tracks: {', '.join(board.common)}.", ""]


def _cell(summary: Summary | None) -> str:
    if summary is None or summary.mean is None:
        return ""
    if summary.low == summary.high:
        return number(summary.mean)
    return f"{number(summary.mean)} [{number(summary.low)}, {number(summary.high)}]"


def main(
    runs: Annotated[Path, typer.Option(help="Folder of the training runs.")] = Path("runs"),
    out: Annotated[Path, typer.Option(help="Folder for the cells.")] = Path("results") / SUITE,
    jobs: Annotated[int, typer.Option(help="Cells at a time.")] = 2,
    backend: Annotated[
        str, typer.Option(help="Where: 'processes' of this machine, or 'ray', a cluster.")
    ] = "processes",
    address: Annotated[str | None, typer.Option(help="Of the cluster, such as auto or HOST:6379.")] = None,
) -> None:
    """Run, rank and write."""
    learned = configurations(runs)
    names = [*ENTRIES, *(f"{name}={pattern}" for name, pattern in learned.items())]
    done: list[str] = []

    def advance(cell: str, total: int) -> None:
        done.append(cell)
        if len(done) % 100 == 0 or len(done) == total:
            typer.echo(f"{len(done)} of {total} cells")

    run = run_suite(SUITE, names, out, workers=Workers(jobs, backend, address), progress=advance)
    board = leaderboard(run)
    write_atomically(out / "results.json", board.to_json() + "\n")
    introduction = _INTRODUCTION.format(
        suite=run.suite.name, hash=run.suite.content_hash[:12], episodes=run.episodes, seed=run.seed
    )
    lines = ["# Leaderboard of ptne-v1", "", introduction, "", *overview(board, set(learned)), ""]
    lines += ["## Overall", "", *overall_table(board)]
    for track in run.tracks:
        lines += track_table(board, track.name)
    write_atomically(HERE / f"{SUITE}.md", "\n".join(lines))


if __name__ == "__main__":
    typer.run(main)
