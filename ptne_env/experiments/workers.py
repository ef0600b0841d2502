"""Many tasks at once: on the cores of this machine, or on the machines of a Ray cluster, through joblib."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, TypeVar

Result = TypeVar("Result")

BACKENDS = ("processes", "ray")

_LOST = "a worker process died, which is often for lack of memory (fewer jobs need less); what is finished is kept"


@dataclass(frozen=True)
class Workers:
    """Where tasks run. Their results do not depend on it.

    Attributes:
        jobs: tasks at a time; −1 for one per core, of this machine or of the cluster.
        backend: ``"processes"`` of this machine, or ``"ray"``, a cluster.
        address: of the cluster, such as ``"auto"`` or ``"10.0.0.1:6379"``; the environment variable ``RAY_ADDRESS`` if
            left out, or else a cluster of this machine alone.

    Raises:
        ValueError: for an unknown backend, no jobs, or an address without a cluster.
    """

    jobs: int = 1
    backend: str = "processes"
    address: str | None = None

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ValueError(f"unknown backend {self.backend!r}; choose from {', '.join(BACKENDS)}")
        if self.jobs == 0:
            raise ValueError("0 jobs would do nothing; ask for at least one, or for -1, one per core")
        if self.address is not None and self.backend != "ray":
            raise ValueError(f"the address {self.address!r} is of a Ray cluster: choose the backend 'ray' too")

    def run(self, function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
        """Call ``function(*task)`` for every task, and give (index of the task, result) as they are finished.

        The function and its arguments are pickled, and it runs on another machine if there are several: what is to be
        kept is its result, which the caller writes.

        Raises:
            ImportError: when joblib or ray is missing and needed.
            ConnectionError: when there is no cluster at the address.
            ChildProcessError: when a worker died, on a cluster more often than Ray repeats its task. What a task raises
                is raised here.
        """
        if self.backend == "processes" and self.jobs == 1:
            for index, task in enumerate(tasks):
                yield index, function(*task)
            return
        try:
            from joblib import Parallel, delayed
        except ImportError as error:
            raise ImportError('several jobs need joblib: pip install "ptne-env[bench]"') from error
        options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1}
        if self.backend == "ray":
            from ptne_env.experiments.cluster import RayTasks

            options |= {"backend": RayTasks(self.address), "pre_dispatch": "n_jobs"}
        calls = (delayed(_numbered)(index, function, task) for index, task in enumerate(tasks))
        try:
            yield from Parallel(self.jobs, **options)(calls)
        except BrokenProcessPool as error:
            raise ChildProcessError(_LOST) from error

    def gather(
        self,
        function: Callable[..., Result],
        tasks: Sequence[tuple[Any, ...]],
        finished: Callable[[int, Result], None] | None = None,
    ) -> list[Result]:
        """The results of :meth:`run` in the order of the tasks; ``finished(index, result)`` is called on the way."""
        found: dict[int, Result] = {}
        for index, result in self.run(function, tasks):
            found[index] = result
            if finished is not None:
                finished(index, result)
        return [found[index] for index in range(len(tasks))]


def _numbered(index: int, function: Callable[..., Result], task: tuple[Any, ...]) -> tuple[int, Result]:
    return index, function(*task)
