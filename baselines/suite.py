"""Run all laws, and every training seed of the learned policies, on a suite; write its leaderboard and raw results.

Run it with ``python baselines/suite.py SUITE`` after ``baselines/run.py``, which trains. Jobs that are stored already
are not run again. ``SUITE.md`` and ``SUITE.tar.xz`` beside this file are its output. The archive holds the numbers of
every episode behind the tables, and the files of all learned policies: ``ptne check baselines/SUITE.tar.xz`` computes
every table again, and runs some of the jobs again. The folder ``results/SUITE`` holds all metrics.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from common import Jobs, Ray, board_of, interval, table
from run import ONE_SEED, policy_name

from ptne_env.bench.report.tables import MARK_NOTES, MARKS
from ptne_env.evaluation import METRICS, POLICIES, Results, Workers, run_suite
from ptne_env.evaluation.leaderboard import Leaderboard
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.policy_specs import DIVISIONS, KNOWLEDGE, PolicySpec
from ptne_env.evaluation.suite import LAW, ORACLE
from ptne_env.learn import training
from ptne_env.shared.files import write_atomically

HERE = Path(__file__).parent

PUBLISHED = (
    "digits",
    "estimate_distance",
    "settling_time",
    "settled_share",
    "settling_time_1e_6",
    "settled_share_1e_6",
    "digits_after_hold",
    "tracking_digits",
    "saturated_share",
    "diverged_share",
    "messages",
    "bits",
)
"""The metrics in the archive: those of the leaderboard, and those that take little space.

Both suites take at most 20 MB in the repository. A job takes 4 kB with these metrics and 19 kB with all of them,
because a number that differs from episode to episode takes eight bytes.
"""

_INTRODUCTION = (
    "Written by `python baselines/suite.py {suite}`; do not edit. Suite `{suite}` (content hash `{hash}`), {episodes} "
    "test episodes per track from seed {seed}, learned policies with every training seed; intervals of 95 % as "
    "`docs/protocol.md` explains. `ptne check baselines/{archive}` computes every number again. Learned policies are "
    "`ppo-<configuration>`, configurations in `ptne_env/learn/training/configurations`, and `size-free`, the shipped seed "
    "alone ([size-free.md](size-free.md) has all its seeds). Below the honest entries stand coded ones and oracles. "
    + ". ".join(MARK_NOTES.values())
    + "."
)


def configurations(runs: Path) -> dict[str, str]:
    """The pattern of the training seeds of every configuration, by name of the policy."""
    return {
        policy_name(name): str(runs / name / "seed-*" / "policy.onnx")
        for name in training.configurations()
        if name not in ONE_SEED
    }


def overview(results: Results, learned: set[str]) -> list[str]:
    """A row per track: the paper's law, the best honest laws by knowledge, the best learned policy and the oracle."""
    headings = ["track", "the paper's law", "best law of own links", "best law", "best learned policy"]
    headings += ["learned − law of own links", "oracle"]
    laws = [name for name, policy in results.policies.items() if policy.division == "honest" and name not in learned]
    local = [name for name in laws if results.policies[name].interface.graph_knowledge == "links"]
    rows = []
    for track in results.tracks:
        means = {
            name: float(results.record(track.name, name, track.metric)["mean"])
            for name in results.policies_on(track.name)
        }
        places = [
            max((name for name in group if name in means), key=means.__getitem__, default="")
            for group in (local, laws, sorted(learned))
        ]
        cells = [f"{number(means[name])} {name}" if name else "n/a" for name in places]
        gained = number(means[places[2]] - means[places[0]]) if places[2] else ""
        rows.append([track.name, number(means[LAW]), *cells, gained, number(means[ORACLE])])
    return table(headings, rows, texts=("track", *headings[2:5]))


def track_table(results: Results, board: Leaderboard, name: str) -> list[str]:
    """All policies on one track, the best first."""
    track = results.suite.track(name)
    heading = METRICS[track.metric].heading
    ranked_by = "time to 1e-6" if name in board.saturated else heading
    found = sorted(
        (row for row in board.rows if row.track == name),
        key=lambda row: (DIVISIONS.index(results.policies[row.policy].division), row.rank or 0),
    )
    rows = [
        [
            "" if row.rank is None else str(row.rank),
            f"{row.policy} {MARKS[results.policies[row.policy].division]}".rstrip(),
            interval(results.summary(name, row.policy, track.metric)),
            interval(row.score),
            interval(row.improvement),
            number(row.fine_time),
            number(results.record(name, row.policy, "diverged_share")["mean"]),
        ]
        for row in found
    ]
    rows += [["", policy, "n/a", "", "", "", ""] for on, policy in results.not_applicable if on == name]
    headings = ["rank", "policy", heading, "score", f"P(better than {LAW})", "to 1e-6 [s]", "diverged"]
    return [f"## {name}", "", f"{track.change} Ranked by {ranked_by}.", "", *table(headings, rows), ""]


def overall_table(board: Leaderboard, policies: Mapping[str, PolicySpec]) -> list[str]:
    """Scores, and the knowledge of every policy."""
    rows = [
        [
            f"{row.policy} {MARKS[policies[row.policy].division]}".rstrip(),
            *policies[row.policy].knowledge.values(),
            interval(row.score),
            interval(row.improvement),
            "" if row.mean_rank is None else number(row.mean_rank),
        ]
        for row in board.overall
    ]
    headings = ["policy", *KNOWLEDGE, "score", f"P(better than {LAW})", "mean rank"]
    return [*table(headings, rows, texts=("policy", *KNOWLEDGE)), ""]


def main(
    suite: Annotated[str, typer.Argument(help="Name of the suite.")] = "ptne-v1",
    runs: Annotated[Path, typer.Option(help="Folder of the training runs.")] = Path("runs"),
    out: Annotated[Path, typer.Option(help="Folder of the results of each suite.")] = Path("results"),
    to: Annotated[Path, typer.Option(help="Folder of the page and the archive.")] = HERE,
    track: Annotated[list[str] | None, typer.Option(help="May be repeated; all tracks if left out.")] = None,
    jobs: Jobs = 2,
    ray: Ray = None,
) -> None:
    """Run, rank and write."""
    folder, archive = out / suite, to / f"{suite}{SUFFIX}"
    learned = configurations(runs)
    alone = training.SHIPPED
    names = [*POLICIES, *(f"{name}={pattern}" for name, pattern in learned.items()), alone]
    done: list[str] = []

    def advance(job: str, work: int, total: int) -> None:
        done.append(job)
        if len(done) % 100 == 0 or work == total:
            typer.echo(f"{len(done)} jobs, {work / total:.0%} of the work")

    results = run_suite(suite, names, tracks=track, folder=folder, workers=Workers(jobs, ray), progress=advance)
    board = board_of(results)
    write_atomically(folder / "results.json", results.to_json() + "\n")
    pack(results, folder, archive, metrics=PUBLISHED)
    introduction = _INTRODUCTION.format(
        suite=suite,
        archive=archive.name,
        hash=results.suite.content_hash[:12],
        episodes=results.suite.episodes,
        seed=results.seed,
    )
    lines = [f"# Leaderboard of {suite}", "", introduction, "", *overview(results, {*learned, alone}), ""]
    lines += ["## Overall", "", *overall_table(board, results.policies)]
    for played in results.tracks:
        lines += track_table(results, board, played.name)
    write_atomically(to / f"{suite}.md", "\n".join(lines))
    typer.echo(f"{archive} takes {archive.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    typer.run(main)
