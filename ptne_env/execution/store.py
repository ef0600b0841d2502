"""The store of finished jobs, one file each, from which an interrupted run goes on."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.comparison import Job, JobResult
from ptne_env.evaluation.metrics import METRICS
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.results import to_json_list
from ptne_env.shared.files import DamagedFileError, read_json, write_atomically
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


class Store:
    """A folder of results of jobs, one file each, named by the key of the job.

    Several runs may share a folder, because files are written atomically and two runs of the same job write the same
    numbers. A checksum covers the whole file. Jobs without a key and failed jobs are not stored.

    Args:
        folder: the folder, which is made when the first result is stored.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, key: str) -> Path:
        """Return the file of the job with this key."""
        return self.folder / "jobs" / f"{key}.json"

    def find(self, job: Job) -> JobResult | None:
        """Return the stored result of a job, or ``None`` where there is none or its file is damaged.

        Raises:
            OSError: when the file cannot be read.
        """
        key = key_of(job)
        if key is None:
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

    def save(self, job: Job, result: JobResult) -> None:
        """Store the result of a job.

        Raises:
            OSError: when the file cannot be written.
        """
        key = key_of(job)
        if key is None or result.failure is not None:
            return
        samples = {name: to_json_list(values) for name, values in result.samples.items()}
        content = {"key": key, "job": content_of(job), "samples": samples, "not_applicable": result.not_applicable}
        text = json.dumps(content | {"checksum": content_hash(content)}, allow_nan=False, ensure_ascii=False)
        path = self.path(key)
        if path.exists() and not path.is_file():  # a pipe, which is no file of a job, and may never be read
            path.unlink()
        write_atomically(path, text)
