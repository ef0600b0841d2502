"""The store: a folder with one file per finished task, so that an interrupted run goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar
from uuid import uuid4

from ptne_env.evaluation.jobs import Job, JobResult, run_job
from ptne_env.evaluation.metrics import own_metrics
from ptne_env.evaluation.provenance import content_hash, is_hash_of
from ptne_env.evaluation.workers import Workers
from ptne_env.shared.files import DamagedFileError, read_json, require_writable, write_atomically


class Task(Protocol):
    """A task whose result can be stored."""

    @property
    def key(self) -> str | None:
        """The hash of :meth:`to_dict`, by which the result is stored; ``None`` where it cannot be stored."""

    def to_dict(self) -> dict[str, Any]:
        """Everything that the result depends on, as a JSON object."""


class TaskResult(Protocol):
    """A result that can be stored."""

    def to_dict(self) -> dict[str, Any]:
        """The result as a JSON object that keeps every bit."""

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], task: Any, /) -> Self:
        """The inverse of :meth:`to_dict`.

        Args:
            data: the JSON object.
            task: :meth:`Task.to_dict` of its task.

        Raises:
            ValueError: when no run of the task gives ``data``: on other keys, names, types or numbers of values.
        """


AnyTask = TypeVar("AnyTask", bound=Task)
Result = TypeVar("Result", bound=TaskResult)


class TaskStore(Generic[Result]):
    """Results of tasks, one file each, named by the key of the task.

    Several runs may share a folder: files are written atomically, and two runs that compute the same task write the
    same result. A checksum covers the whole file.

    Args:
        folder: of the results, made when the first one is stored.

    Attributes:
        kind: of tasks, for names and messages.
        result: the type of their results.
    """

    kind: ClassVar[str]
    result: ClassVar[type[TaskResult]]

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, key: str) -> Path:
        """The file of the task with this key."""
        return self.folder / f"{self.kind}s" / f"{key}.json"

    def load(self, key: str) -> Result:
        """A stored result.

        Raises:
            FileNotFoundError: when there is none.
            OSError: when the file cannot be read.
            DamagedFileError: when the file is damaged, or of another task.
        """
        path = self.path(key)
        content = read_json(path, f"the result of a {self.kind}")
        checksum = content.pop("checksum", None)
        is_whole = is_hash_of(checksum, content)
        task = content.pop(self.kind, None)
        reason = "its checksum is another one"
        if is_whole and is_hash_of(key, task):
            try:
                return self.read(content, task)
            except ValueError as error:
                reason = str(error)
        raise DamagedFileError(
            f"the result {path} is damaged, or of another {self.kind} ({reason}): run the suite again, which "
            "replaces it"
        )

    def read(self, content: Mapping[str, Any], task: Any) -> Result:
        """The result in the content of a file; see :meth:`TaskResult.from_dict`."""
        return self.result.from_dict(content, task)  # type: ignore[return-value]

    def save(self, task: Task, result: Result) -> None:
        """Write the file of a task; nothing for a task without a key.

        Raises:
            OSError: when it cannot be written.
        """
        if task.key is None:
            return
        path = self.path(task.key)
        if path.exists() and not path.is_file():  # such as a folder, which no file can replace
            path.rename(path.with_name(f"{path.name}.damaged-{uuid4().hex}"))
        write_atomically(path, self.text(task, result))

    def text(self, task: Task, result: Result) -> str:
        """The content of the file of a task."""
        content = {self.kind: task.to_dict(), **result.to_dict()}
        return json.dumps({**content, "checksum": content_hash(content)}, allow_nan=False, ensure_ascii=False)

    def find(self, task: Task) -> Result | None:
        """The stored result; ``None`` where there is none, or a damaged file, so that the task has to be run.

        Raises:
            OSError: when there is a file that cannot be read.
        """
        if task.key is None:
            return None
        try:
            return self.load(task.key)
        except (FileNotFoundError, DamagedFileError):
            return None


class Store(TaskStore[JobResult]):
    """Results of jobs; nothing is stored of a failed job."""

    kind = "job"
    result = JobResult

    def save(self, task: Task, result: JobResult) -> None:  # noqa: D102 - inherited
        if result.failure is None:
            super().save(task, result)


class PublishedStore(Store):
    """Published results of jobs, which may be of some metrics alone.

    Args:
        folder: of the results.
        metrics: that were published.
    """

    def __init__(self, folder: Path, metrics: Collection[str]) -> None:
        super().__init__(folder)
        self._metrics = metrics

    def read(self, content: Mapping[str, Any], task: Any) -> JobResult:  # noqa: D102 - inherited
        return JobResult.from_dict(content, task, self._metrics)


def run_missing(
    tasks: Sequence[AnyTask],
    store: TaskStore[Result] | None,
    run: Callable[[list[AnyTask]], Iterator[tuple[int, Result]]],
    *,
    rerun: bool = False,
) -> Iterator[tuple[int, Result]]:
    """The index and the result of each task: stored ones first, then those that are run, which are stored.

    Args:
        tasks: whose results are wanted.
        store: of results; ``None`` stores nothing.
        run: yields the index and the result of each of the given tasks.
        rerun: whether tasks with a stored result are run again.

    Raises:
        OSError: before a task is run, when its result could not be stored.
    """
    missing = []
    for index, task in enumerate(tasks):
        found = None if store is None or rerun else store.find(task)
        if found is None:
            missing.append(index)
        else:
            yield index, found
    if store is not None and missing:
        require_writable(store.path("0"))
    for place, result in run([tasks[index] for index in missing]):
        if store is not None:
            store.save(tasks[missing[place]], result)
        yield missing[place], result


def run_jobs(
    jobs: Sequence[Job], store: Store | None, workers: Workers, *, rerun: bool = False
) -> Iterator[tuple[int, JobResult]]:
    """:func:`run_missing` of jobs on workers, which get the metrics of this process."""
    metrics = own_metrics()
    return run_missing(
        jobs,
        store,
        lambda missing: workers.run(run_job, [(job, job.key, metrics) for job in missing]),
        rerun=rerun,
    )
