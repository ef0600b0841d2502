"""Workers: many tasks at once on the cores of this machine, or on a Ray cluster, through joblib."""

from __future__ import annotations

import os
import signal
import tempfile
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from multiprocessing.resource_tracker import ensure_running
from pickle import PicklingError
from typing import Any, TypeVar

from ptne_env.shared.processes import end_with_parent

Result = TypeVar("Result")

_LOST = "a worker process died, often for lack of memory (fewer jobs need less); stored results are kept"


@dataclass(frozen=True)
class Workers:
    """Processes that run tasks. The results do not depend on their number or place.

    Processes of this machine end with this process, even if it is killed, and leave Ctrl-C to it.

    Attributes:
        jobs: tasks at a time; −1 for one per core, of this machine or of the cluster.
        ray: address of a Ray cluster: ``"auto"`` (the one that this machine or ``RAY_ADDRESS`` belongs to),
            ``"local"`` (a new one on this machine) or such as ``"10.0.0.1:6379"``; processes of this machine if
            ``None``.

    Raises:
        ValueError: for no jobs.
    """

    jobs: int = 1
    ray: str | None = None

    def __post_init__(self) -> None:
        if self.jobs == 0:
            raise ValueError("0 jobs would do nothing; ask for at least one, or for -1, one per core")

    def run(self, function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
        """Call ``function(*task)`` for every task, and yield (index of the task, result) as they are finished.

        The function and its arguments are pickled, and may run on another machine: the caller writes the results.

        Raises:
            ValueError: when a task cannot be pickled.
            ImportError: when joblib or ray is missing and needed.
            ConnectionError: when there is no cluster at the address.
            ChildProcessError: when a worker died, on a cluster more often than Ray repeats its task. An error
                of a task is raised here.
        """
        if self.ray is None and self.jobs == 1:
            for index, task in enumerate(tasks):
                yield index, function(*task)
            return
        try:
            from joblib import Parallel, delayed
        except ImportError as error:
            raise ImportError('several jobs need joblib: pip install "ptne-env[bench]"') from error
        options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1}
        start: AbstractContextManager[None] = nullcontext()
        if self.ray is None:
            start = _ctrl_c_waits()
            options |= {"backend": "loky", "initializer": end_with_parent, "initargs": (os.getpid(),)}
            # joblib makes no folders for large arrays then, which would stay behind when all processes are killed.
            options |= {"max_nbytes": None, "temp_folder": tempfile.gettempdir()}
        else:
            from ptne_env.evaluation.cluster import RayTasks

            options |= {"backend": RayTasks(self.ray), "pre_dispatch": "n_jobs"}
        calls = (delayed(_numbered)(index, function, task) for index, task in enumerate(tasks))
        try:
            with ExitStack() as stack:
                with start:
                    results = Parallel(self.jobs, **options)(calls)
                    stack.callback(_end, results)
                for result in results:  # noqa: UP028 - yield from would close them before _end does
                    yield result
        except BrokenProcessPool as error:
            raise ChildProcessError(_LOST) from error
        except PicklingError as error:
            *_, reason = str(error.__cause__ or error).strip(' \n"').splitlines()
            raise ValueError(
                f"a class or function of this program or notebook cannot be sent to other processes ({reason}): define "
                "it in a module, or run one job at a time"
            ) from error

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


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block; processes that start in it never see it, not even while they import."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    ensure_running()  # it unblocks Ctrl-C when joblib starts it, in Python 3.11
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end(results: Generator[Any, None, None]) -> None:
    """End the tasks that are unfinished after an error, Ctrl-C, or a caller that wants no more results."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # joblib counts the results that are lost
        results.close()


def _numbered(index: int, function: Callable[..., Result], task: tuple[Any, ...]) -> tuple[int, Result]:
    return index, function(*task)
