"""The runner, which runs jobs on workers, and stores finished jobs, from which an interrupted run goes on."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.comparison import Job, JobResult
from ptne_env.evaluation.metrics import METRICS, Metric
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.results import to_json_list
from ptne_env.execution.workers import Workers
from ptne_env.shared.files import DamagedFileError, read_json, require_writable, write_atomically
from ptne_env.shared.parts import foreign_targets
from ptne_env.world.dynamics import PHYSICS


def content_of(job: Job) -> dict[str, Any]:
    """Return all that the numbers of a job depend on, as a JSON object. The names of policies are not part of it."""
    policy, track = job.policy.to_dict(), job.track.to_dict()
    return {
        "physics": PHYSICS,
        "versions": versions(job.policy.libraries),
        "track": {key: track[key] for key in ("scenario", "teammates")},
        "policy": {"interface": policy["interface"], **policy["training_seeds"][job.training_seed]},
        "episodes": asdict(job.episodes),
        "metrics": sorted(name for name, metric in METRICS.items() if metric.value is not None),
    }


def key_of(job: Job) -> str | None:
    """Return the hash of :func:`content_of`, by which the result of a job is stored.

    It is ``None`` where code of the user takes part (an object, a ``"module:object"`` or a metric), because no key
    shows that such code has changed. These jobs run every time.
    """
    content = content_of(job)
    own_metric = any(metric.is_own for metric in METRICS.values())
    is_own = not job.policy.is_repeatable or foreign_targets(content) or own_metric
    return None if is_own else content_hash(content)


@dataclass
class Runner:
    """A runner of jobs, such as ``evaluate(..., run=Runner(folder, Workers(4)))``.

    Workers return results, and only this process writes. So they may be machines that share no folder with it, but they
    need the same library and the same files of policies and parts.

    Attributes:
        folder: the folder that stores the results of finished jobs, so that they are not run again: one file each,
            named by the job's key. Several runs may share it, because files are written atomically and two runs of the
            same job write the same numbers. Nothing is stored if ``None``.
        workers: the workers that run the jobs. Only the measured times of policies depend on them.
        progress: called when a job is done, with ``"track: policy"``, the work that is done and the work of all jobs,
            both in units of :func:`cost_of`.
    """

    folder: str | Path | None = None
    workers: Workers = Workers()  # noqa: RUF009 - immutable
    progress: Callable[[str, int, int], None] | None = None

    def __post_init__(self) -> None:
        workers: Any = self.workers
        if not hasattr(workers, "run"):
            raise TypeError(f"the workers of a runner are Workers(4), for example; got {workers!r}")

    def __call__(self, jobs: Sequence[Job]) -> list[JobResult]:
        """Return the results of jobs, in their order.

        Raises:
            OSError: before any job is run, when the folder cannot be written.
            ValueError, ImportError, ConnectionError, ChildProcessError: as
                :meth:`~ptne_env.execution.workers.Workers.run`.
        """
        results: dict[int, JobResult] = {}
        total, done = sum(map(cost_of, jobs)), 0

        def finish(index: int, result: JobResult) -> None:
            nonlocal done
            results[index] = result
            done += cost_of(jobs[index])
            if self.progress is not None:
                self.progress(f"{jobs[index].track.name}: {jobs[index].policy.name}", done, total)

        missing, keys = [], [key_of(job) for job in jobs]
        for index, key in enumerate(keys):
            if (stored := self.find(key)) is None:
                missing.append(index)
            else:
                finish(index, stored)
        if self.folder is not None and missing:
            require_writable(self.path("0"))
        missing.sort(key=lambda index: -cost_of(jobs[index]))  # long jobs first, so that no core waits for the last one
        tasks = [(jobs[index], keys[index], METRICS) for index in missing]
        for place, result in self.workers.run(_run_job, tasks):
            self.save(keys[missing[place]], jobs[missing[place]], result)
            finish(missing[place], result)
        return [results[index] for index in range(len(jobs))]

    def path(self, key: str) -> Path:
        """Return the file of the job with this key."""
        return Path(self.folder or "") / "jobs" / f"{key}.json"

    def find(self, key: str | None) -> JobResult | None:
        """Return the stored result of the job with a key, or ``None`` where there is none or its file is damaged."""
        if self.folder is None or key is None:
            return None
        try:
            content = read_json(self.path(key), "the result of a job")
            if content.pop("checksum", None) != content_hash(content) or content["key"] != key:
                return None
            reason, lists = content["not_applicable"], content["samples"]
            samples = {name: np.array(lists[name], dtype=np.float64) for name in METRICS if name in lists}
        except (FileNotFoundError, DamagedFileError, KeyError, TypeError, ValueError):
            return None
        return JobResult(samples, reason)

    def save(self, key: str | None, job: Job, result: JobResult) -> None:
        """Store the result of a job with a key, unless it failed."""
        if self.folder is None or key is None or result.failure is not None:
            return
        samples = {name: to_json_list(values) for name, values in result.samples.items()}
        content = {"key": key, "job": content_of(job), "samples": samples, "not_applicable": result.not_applicable}
        text = json.dumps(content | {"checksum": content_hash(content)}, allow_nan=False, ensure_ascii=False)
        path = self.path(key)
        if path.exists() and not path.is_file():  # a pipe, which is no file of a job, and may never be read
            path.unlink()
        write_atomically(path, text)


def cost_of(job: Job) -> int:
    """Return a rough measure of the work of a job: the estimates in all steps and episodes.

    The rest of a step takes about as long as 5000 of them.
    """
    game, clock = job.track.world.game, job.track.world.clock
    return clock.total_steps * (game.dimension * game.num_players * job.episodes.count + 5_000)


def _run_job(job: Job, key: str | None, metrics: dict[str, Metric]) -> JobResult:
    """Run a job on a worker, with the metrics of the process that asks."""
    METRICS.update(metrics)
    if key is not None and key_of(job) != key:  # libraries or files differ there
        raise ValueError(
            f"a worker on {platform.node()} has another version of the library, its dependencies or the files of "
            f"policy {job.policy.name!r} than the machine that asks: install the same on both"
        )
    try:
        return job.compute()
    except Exception as error:
        error.add_note(f"in track {job.track.name!r}, policy {job.policy.name!r}")
        raise
