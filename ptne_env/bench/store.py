"""The store: a folder with one file per finished job, so that an interrupted run goes on where it was."""

from __future__ import annotations

import json
from pathlib import Path
from uuid import uuid4

from ptne_env.evaluation.jobs import Job, JobResult
from ptne_env.evaluation.provenance import content_hash
from ptne_env.shared.files import DamagedFileError, read_json, write_atomically


class Store:
    """Results of jobs, one file each, named by the key of the job.

    Several runs may share a folder: files are written atomically, and two runs that compute the same job write the same
    numbers. A checksum covers the whole file. Jobs without a key, and failed ones, are not stored.

    Args:
        folder: of the results, made when the first one is stored.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, key: str) -> Path:
        """The file of the job with this key."""
        return self.folder / "jobs" / f"{key}.json"

    def find(self, job: Job) -> JobResult | None:
        """The stored result; ``None`` where there is none, or a damaged file, so that the job has to be run.

        Raises:
            OSError: when there is a file that cannot be read.
        """
        if job.key is None:
            return None
        try:
            content = read_json(self.path(job.key), "the result of a job")
            if content.pop("checksum", None) != content_hash(content) or content["key"] != job.key:
                return None
            return JobResult.from_dict(content["result"], job)
        except (FileNotFoundError, DamagedFileError, KeyError, ValueError):
            return None

    def save(self, job: Job, result: JobResult) -> None:
        """Write the file of a job.

        Raises:
            OSError: when it cannot be written.
        """
        if job.key is None or result.failure is not None:
            return
        path = self.path(job.key)
        if path.exists() and not path.is_file():  # such as a folder, which no file can replace
            path.rename(path.with_name(f"{path.name}.damaged-{uuid4().hex}"))
        content = {"key": job.key, "job": job.to_dict(), "result": result.to_dict()}
        text = json.dumps(content | {"checksum": content_hash(content)}, allow_nan=False, ensure_ascii=False)
        write_atomically(path, text)
