"""Play all policies on catalogue, suite and random worlds, and write every published table.

``python -m baselines.publish`` plays them on the catalogue, on ptne-v1, and on the random worlds of two seeds: those of
seed 1 were seen while laws were designed, those of seed 2 were not.

It writes ``results.csv`` beside this file, and from it every table of README, docs and baselines that stands between
``<!-- table NAME -->`` and ``<!-- end -->``. Finished jobs are kept in the folder ``--out`` and not run again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from baselines.published import ALL, RESULTS, ROOT, WORLDS, Row, documents, fill_tables, read
from ptne_env import CATALOGUE, evaluate
from ptne_env.evaluation import COMPARED, ENTERED, POLICIES, Results
from ptne_env.execution import Runner, Workers
from ptne_env.shared.files import write_atomically
from ptne_env.suites import leaderboard, run_suite

METRICS = (
    "digits", "digits_on_the_way", "digits_cvar", "mean_regret", "settling_time", "settled_share", "diverged_share",
)  # fmt: skip
"""The metrics in the file."""

INTERVAL = ("mean", "low", "high")


def rows_of(results: Results) -> Iterable[Row]:
    """The rows of ``results.csv``: the metrics above, and scores and ranks of a suite."""
    for record in results.records:
        if record["metric"] in METRICS and record["mean"] is not None:
            interval = {key: "" if record[key] is None else f"{record[key]:.7g}" for key in INTERVAL}
            yield {"suite": results.name, **{key: str(value) for key, value in record.items()}, **interval}
    for row in leaderboard(results) or ():
        common = {"suite": results.name, "track": ALL, "policy": row.policy}
        means = {"score": row.score, "digits_on_the_way": row.on_the_way, "digits_cvar": row.worst_tenth}
        for metric, summary in means.items():
            interval = {key: getattr(summary, key) for key in INTERVAL}
            yield {
                **common,
                "metric": metric,
                **{key: f"{end:.7g}" for key, end in interval.items() if end is not None},
            }
        if row.mean_rank is not None:
            yield {**common, "metric": "rank", "mean": f"{row.mean_rank:.7g}"}


def run(out: Path, episodes: int | None, workers: Workers) -> None:
    """Run everything that is not stored, and write ``results.csv``."""

    def show(job: str, done: int, total: int) -> None:
        print(f"{done / total:7.1%}  {job}", flush=True)

    runner = Runner(out, workers, show)
    compared = evaluate(COMPARED, CATALOGUE, episodes=episodes or 100, run=runner)
    entered = [POLICIES[name] for name in ENTERED]
    suite = run_suite("ptne-v1", entered, episodes=episodes, run=runner)
    worlds = [run_suite(world, entered, episodes=episodes, run=runner) for world in WORLDS.values()]
    rows = [row for results in (compared, suite, *worlds) for row in rows_of(results)]
    columns = ["suite", "track", "policy", "metric", *INTERVAL, "episodes"]
    lines = [columns, *([row.get(key, "") for key in columns] for row in rows)]
    write_atomically(RESULTS, "".join(f"{','.join(line)}\n" for line in lines))
    write_atomically(out / "results.json", suite.to_json())


def main() -> None:
    """Run, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "published")
    parser.add_argument("--episodes", type=int, help="the suite's own number, and 100 of a scenario, if left out")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--tables", action="store_true", help="write the tables of results.csv alone")
    arguments = parser.parse_args()
    if not arguments.tables:
        run(arguments.out, arguments.episodes, Workers(arguments.jobs))
    numbers = read()
    for document in documents():
        write_atomically(document, fill_tables(document.read_text(encoding="utf-8"), numbers))


if __name__ == "__main__":
    main()
