"""The store: a folder with one file per finished job, so that an interrupted run goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from ptne_env.experiments.jobs import Job, JobResult, run_job
from ptne_env.experiments.metrics import own_metrics
from ptne_env.experiments.provenance import content_hash, is_hash_of
from ptne_env.experiments.workers import Workers
from ptne_env.files import read_json, write_atomically

_CHECKED = ("samples", "not_applicable")
"""The parts of a result that the checksum covers: all but the timings."""


class Store:
    """Job results, one file each, named by the key of the job.

    Several runs may share a folder: files are written atomically, and two runs that compute the same job write the
    same result. Nothing is stored of a job without a key.

    Args:
        folder: of the results, made when the first one is stored.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, key: str) -> Path:
        """The file of the job with this key."""
        return self.folder / "jobs" / f"{key}.json"

    def load(self, key: str) -> JobResult:
        """A stored result.

        Raises:
            FileNotFoundError: when there is none.
            ValueError: when the file is damaged, or of another job.
        """
        path = self.path(key)
        data = read_json(path, "the result of a job")
        checked = {name: data.get(name) for name in _CHECKED}
        is_whole = is_hash_of(data.get("checksum"), checked) and is_hash_of(key, data.get("job"))
        if not (is_whole and isinstance(data.get("timings"), dict)):
            raise ValueError(f"the result {path} is damaged, or of another job: remove it and run the suite again")
        return JobResult.from_dict(data)

    def save(self, job: Job, result: JobResult) -> None:
        """Write the job's file; nothing for a job without a key."""
        if job.key is None:
            return
        body = result.to_dict()
        checksum = content_hash({name: body[name] for name in _CHECKED})
        names = {"policy": job.policy.name, "training_seed": job.training_seed}
        data = {"job": job.to_dict(), **names, **body, "checksum": checksum}
        write_atomically(self.path(job.key), json.dumps(data, allow_nan=False, ensure_ascii=False))

    def find(self, job: Job) -> JobResult | None:
        """The stored result; ``None`` where there is none, or a damaged file, so that the job has to be run."""
        if job.key is None:
            return None
        try:
            return self.load(job.key)
        except (FileNotFoundError, ValueError):
            return None


def run_jobs(
    jobs: Sequence[Job], store: Store | None, workers: Workers, *, rerun: bool = False
) -> Iterator[tuple[int, JobResult]]:
    """The index and the result of each job: stored ones first, then those of workers, which are stored.

    Args:
        jobs: to be run.
        store: of results; ``None`` stores nothing.
        workers: run the jobs.
        rerun: whether stored jobs are run again.
    """
    missing = []
    for index, job in enumerate(jobs):
        result = None if store is None or rerun else store.find(job)
        if result is None:
            missing.append(index)
        else:
            yield index, result
    metrics = own_metrics()
    for place, result in workers.run(run_job, [(jobs[index], jobs[index].key, metrics) for index in missing]):
        if store is not None and result.failure is None:
            store.save(jobs[missing[place]], result)
        yield missing[place], result
