"""Cost of a job of a suite, speed of several workers, and overhead of Ray; see docs/scaling.md.

Run ``python -m benchmarks.cluster`` with the extra ``[ray]`` on an idle machine.
"""

from __future__ import annotations

import pickle
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import cloudpickle
import joblib
import numpy as np
import ray
import typer
from ray.cluster_utils import Cluster
from ray.util.joblib import register_ray

from ptne_env.evaluation import POLICIES, Workers, get_suite
from ptne_env.evaluation.jobs import Job, run_job
from ptne_env.evaluation.store import Store

SUITE = "ptne-v1"
LAWS = ("static", "adaptive", "grounded", "corollary-one", "fixed-gain")


def task(track: str, law: str, seed: int = 0) -> tuple[Job, str | None]:
    """A job of the suite with as many episodes as the suite has, and its key: the arguments of ``run_job``."""
    suite = get_suite(SUITE)
    job = Job(suite.track(track), POLICIES[law], 0, suite.episode_set(track, seed=seed))
    return job, job.key


def timed(work: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> tuple[float, Any]:
    """Seconds by the clock, and the result."""
    began = clock()
    result = work()
    return clock() - began, result


@contextmanager
def nodes(count: int) -> Iterator[Workers]:
    """A Ray cluster of nodes with one core each, on this machine, with started workers."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    for _ in range(count - 1):
        cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    workers = Workers(-1, ray=cluster.address)
    try:
        list(workers.run(run_job, [task("nominal", "static")] * 4))
        yield workers
    finally:
        ray.shutdown()
        cluster.shutdown()


def costs(tracks: tuple[str, ...]) -> None:
    """Seconds of one core to run and to store a job of each track, and the transferred bytes."""
    typer.echo(f"{'track':24}{'seconds':>9}{'bytes out':>11}{'bytes back':>12}{'ms to keep':>12}")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for track in tracks:
            job, key = task(track, "static")
            seconds, result = timed(partial(run_job, job, key), time.process_time)
            keep, _ = timed(partial(Store(Path(folder)).save, job, result), time.process_time)
            rows.append((seconds, len(cloudpickle.dumps((run_job, job, key))), len(pickle.dumps(result)), keep))
            typer.echo(f"{track:24}{seconds:9.2f}{rows[-1][1]:11,}{rows[-1][2]:12,}{1e3 * keep:12.1f}")
    seconds, out, back, keep = np.mean(rows, axis=0)
    typer.echo(f"{'mean':24}{seconds:9.2f}{out:11,.0f}{back:12,.0f}{1e3 * keep:12.1f}\n")


def sharing(turns: int) -> None:
    """Seconds of the same jobs on one and on two workers."""
    tasks = [task("nominal", law, seed) for seed in range(3) for law in LAWS]
    list(Workers(2).run(run_job, tasks[:4]))  # starts the processes before the clock runs
    typer.echo(f"{len(tasks)} jobs of the track nominal, median of {turns} turns")
    medians = {}

    def measure(name: str, workers: Workers) -> None:
        medians[name] = float(np.median([timed(lambda: list(workers.run(run_job, tasks)))[0] for _ in range(turns)]))
        speed = medians["1 process"] / medians[name]
        typer.echo(f"  {name:14}{medians[name]:7.1f} s, {speed:.2f} times as fast as one process")

    measure("1 process", Workers(1))
    measure("2 processes", Workers(2))
    for count in (1, 2):
        with nodes(count) as workers:
            measure(f"{count} Ray node{'s' * (count > 1)}", workers)


def _sleep(seconds: float) -> None:
    time.sleep(seconds)


def overheads() -> None:
    """Empty tasks per second on two nodes, and unequal tasks through our backend and through Ray's own."""
    unequal = [(4.0,)] + 20 * [(0.2,)]
    register_ray()
    with nodes(2) as workers:
        seconds, _ = timed(lambda: list(workers.run(_sleep, 1000 * [(0.0,)])))
        typer.echo(f"\n{1000 / seconds:.0f} empty tasks per second on two nodes")
        seconds, _ = timed(lambda: list(workers.run(_sleep, unequal)))
        typer.echo(f"one task of 4 s and twenty of 0.2 s, at best 4 s: {seconds:.1f} s")
        calls = [joblib.delayed(_sleep)(*arguments) for arguments in unequal]
        with joblib.parallel_config(backend="ray", n_jobs=2):
            joblib.Parallel()(calls[1:5])
            seconds, _ = timed(lambda: joblib.Parallel()(calls))
        typer.echo(f"the same through Ray's own backend for joblib, including the start of its pool: {seconds:.1f} s")


def main(
    *,
    turns: Annotated[int, typer.Option(min=1, help="Turns of every set of workers.")] = 3,
    track: Annotated[list[str] | None, typer.Option(help="Tracks whose cost is measured; all by default.")] = None,
) -> None:
    """Print costs, speeds and overheads."""
    costs(tuple(track or (one.name for one in get_suite(SUITE).tracks)))
    sharing(turns)
    overheads()


if __name__ == "__main__":
    typer.run(main)
