"""The runner, which runs jobs on workers and stores their results in a folder."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ptne_env.evaluation.comparison import Job, JobResult, run_serially
from ptne_env.evaluation.metrics import METRICS, Metric
from ptne_env.execution.store import Store, key_of
from ptne_env.execution.workers import Workers
from ptne_env.shared.files import require_writable

_STEP_COST = 5_000
"""Number of estimates whose update takes about as long as the rest of a step."""


@dataclass
class Runner:
    """A runner of jobs, such as ``evaluate(..., run=Runner(folder, Workers(4)))``.

    Workers return results, and only this process writes. So they may be machines that share no folder with it, but they
    need the same library and the same files of policies and parts.

    Attributes:
        folder: the folder that stores the results of finished jobs, so that they are not run again; nothing is stored
            if ``None``.
        workers: the workers that run the jobs. Only the measured times of policies depend on them.
        progress: called when a job is done, with ``"track: policy"``, the work that is done and the work of all jobs,
            both in units of :func:`cost_of`.
        rerun: whether stored jobs are run again.
    """

    folder: str | Path | None = None
    workers: Workers = Workers()  # noqa: RUF009 - immutable
    progress: Callable[[str, int, int], None] | None = None
    rerun: bool = False

    def __call__(self, jobs: Sequence[Job]) -> list[JobResult]:
        """Return the results of jobs, in their order.

        Raises:
            OSError: before any job is run, when the folder cannot be written.
            ValueError, ImportError, ConnectionError, ChildProcessError: as
                :meth:`~ptne_env.execution.workers.Workers.run`.
        """
        store = None if self.folder is None else Store(Path(self.folder))
        results: dict[int, JobResult] = {}
        total, done = sum(map(cost_of, jobs)), 0

        def finish(index: int, result: JobResult) -> None:
            nonlocal done
            results[index] = result
            done += cost_of(jobs[index])
            if self.progress is not None:
                self.progress(f"{jobs[index].track.name}: {jobs[index].policy.name}", done, total)

        missing = []
        for index, job in enumerate(jobs):
            stored = None if store is None or self.rerun else store.find(job)
            if stored is None:
                missing.append(index)
            else:
                finish(index, stored)
        if store is not None and missing:
            require_writable(store.path("0"))
        missing.sort(key=lambda index: cost_of(jobs[index]))  # quick jobs first, so that progress shows at once
        own = {name: metric for name, metric in METRICS.items() if metric.is_own}
        for place, result in self.workers.run(_run_job, [(jobs[index], key_of(jobs[index]), own) for index in missing]):
            if store is not None:
                store.save(jobs[missing[place]], result)
            finish(missing[place], result)
        return [results[index] for index in range(len(jobs))]


def cost_of(job: Job) -> int:
    """Return a rough measure of the work of a job: the estimates in all steps and episodes, and more per step."""
    game, clock = job.track.world.game, job.track.world.clock
    return clock.total_steps * (game.dimension * game.num_players * job.episodes.count + _STEP_COST)


def _run_job(job: Job, key: str | None, metrics: dict[str, Metric]) -> JobResult:
    """Run a job on a worker, with the metrics that the user registered.

    Raises:
        ValueError: when the job has another key on the worker, because libraries or files differ there.
    """
    METRICS.update(metrics)
    if key is not None and key_of(job) != key:
        raise ValueError(
            f"a worker on {platform.node()} has another version of the library, its dependencies or the files of "
            f"policy {job.policy.name!r} than the machine that asks: install the same on both"
        )
    try:
        (result,) = run_serially([job])
    except Exception as error:
        error.add_note(f"in track {job.track.name!r}, policy {job.policy.name!r}")
        raise
    return result
