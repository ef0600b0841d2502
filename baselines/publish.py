"""Play all policies on catalogue, suite and random worlds, and write every published table.

``python -m baselines.publish`` plays them on the catalogue, on ptne-v1, and on the random worlds of four seeds: laws
may be tuned on those of seed 1 alone.

It writes ``results.csv`` beside this file, and from it every table of README, docs and baselines that stands between
``<!-- table NAME -->`` and ``<!-- end -->``. Finished jobs are kept in the folder ``--out`` and not run again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean

from baselines import edge_cases, pages
from baselines.published import (
    ALL,
    LEAD,
    MINUS_PAPER,
    PPO,
    RESULTS,
    ROOT,
    TRAINED,
    WORLDS,
    Row,
    documents,
    fill_tables,
    interval_of,
    read,
    write_rows,
)
from ptne_env import CATALOGUE, evaluate
from ptne_env.evaluation import CODED, COMPARED, ENTERED, POLICIES, Results
from ptne_env.evaluation.comparison import LAW
from ptne_env.evaluation.results import SHOWN
from ptne_env.execution import Runner, Workers
from ptne_env.shared.files import write_atomically
from ptne_env.suites import leaderboard, run_suite
from ptne_env.suites.robustness import robustness

METRICS = (*SHOWN, "settling_time", "settled_share", "diverged_share")
"""The metrics in the file."""


def differences_of(results: Results, label: str, tracks: Sequence[str]) -> Iterable[Row]:
    """The rows of paired differences between policies that play these tracks.

    They are those of each from the paper's law, and that of the best of three from the second.

    Args:
        results: the results.
        label: the name of the track, or :data:`ALL`.
        tracks: the tracks over which the differences are taken.
    """
    digits = {
        name: fmean(results.samples[track, name]["digits"].mean() for track in tracks)
        for name in results.policies
        if all((track, name) in results.samples for track in tracks)
    }
    best_first = sorted(digits, key=lambda name: -digits[name])
    laws = [name for name in best_first if results.policies[name].is_law]
    three = [name for name in best_first if name in (*laws[:1], PPO, TRAINED)]
    pairs = [(LEAD, *three[:2])] * (len(three) > 1) + [(MINUS_PAPER, policy, LAW) for policy in digits]
    for metric, policy, other in pairs:
        if other != policy and other in digits:
            row = {"suite": results.name, "track": label, "policy": policy, "metric": metric}
            yield row | interval_of(results.difference(policy, other, tracks))


def rows_of(results: Results) -> Iterable[Row]:
    """The rows of ``results.csv``: the metrics above, paired differences, and the leaderboard of a suite.

    Raises:
        RuntimeError: when an entry raised an error, or answered in another form: that is a fault of ours.
    """
    for (track, policy), reason in results.failures.items():
        raise RuntimeError(f"{policy} fails on {track} of {results.name}, so nothing is published: {reason}")
    for record in results.records:
        if record["metric"] in METRICS and record["mean"] is not None:
            texts = {key: str(value) for key, value in record.items()}
            yield {"suite": results.name, **texts, **interval_of(record)}
    for track in results.tracks:
        yield from differences_of(results, track.name, [track.name])
    board = leaderboard(results)
    for row in board or ():
        common = {"suite": results.name, "track": ALL, "policy": row.policy}
        for metric, statistic in zip(SHOWN, (row.score, row.on_the_way, row.worst_tenth), strict=True):
            yield {**common, "metric": metric, **interval_of(statistic)}
        if row.mean_rank is not None:
            yield {**common, "metric": "rank", "mean": f"{row.mean_rank:.7g}"}
    if board is not None:
        yield from differences_of(results, ALL, results.counted_tracks)


def rows_of_worlds(results: Results) -> Iterable[Row]:
    """Those of :func:`rows_of` that tables of random worlds show, without shares that are 0."""
    shown = ("digits", MINUS_PAPER, "diverged_share")
    rows = [row for row in rows_of(results) if row["metric"] in shown and row["track"] != ALL]
    return [row for row in rows if (row["metric"], row["mean"]) != ("diverged_share", "0")]


def run(out: Path, episodes: int | None, workers: Workers) -> Path:
    """Run everything that is not stored, and write ``results.csv``, with another number of episodes into ``out``."""

    def show(job: str, done: int, total: int) -> None:
        print(f"{done / total:7.1%}  {job}", flush=True)

    runner = Runner(out, workers, show)
    compared = evaluate(COMPARED, CATALOGUE, episodes=episodes or 100, run=runner)
    entered = [POLICIES[name] for name in (*ENTERED, *CODED)]
    suite = run_suite("ptne-v1", entered, episodes=episodes, run=runner)
    worlds = [run_suite(robustness(seed), entered, episodes=episodes, run=runner) for seed in WORLDS.values()]
    rows = [row for results in (compared, suite) for row in rows_of(results)]
    worlds += [run_suite(suite, entered, episodes=episodes, run=runner) for suite in edge_cases.SUITES]
    rows += [row for results in worlds for row in rows_of_worlds(results)]
    path = RESULTS if episodes is None else out / RESULTS.name
    write_rows(path, rows)
    write_atomically(out / "results.json", suite.to_json())
    return path


def main() -> None:
    """Run, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "published")
    parser.add_argument("--episodes", type=int, help="a trial, which writes no document")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--tables", action="store_true", help="write the tables of results.csv alone")
    arguments = parser.parse_args()
    path = RESULTS if arguments.tables else run(arguments.out, arguments.episodes, Workers(arguments.jobs))
    numbers = read(path)
    for document in documents():
        text = fill_tables(document.read_text(encoding="utf-8"), numbers)
        if path == RESULTS:
            write_atomically(document, text)
    if path == RESULTS:
        pages.write(numbers)


if __name__ == "__main__":
    main()
