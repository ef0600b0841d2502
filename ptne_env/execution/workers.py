"""Workers, which run many tasks at once: on the cores of this machine through joblib, or on a Ray cluster."""

from __future__ import annotations

import os
import signal
import socket
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.resource_tracker import ensure_running
from pickle import PicklingError
from typing import Any, TypeVar

from ptne_env.shared.arrays import require_count

Result = TypeVar("Result")

RETRIES = 3
"""Number of times that Ray runs a task again whose worker or machine died."""


@dataclass(frozen=True)
class Workers:
    """Processes that run tasks; the results do not depend on their number or place.

    Processes on this machine end with this process, even if it is killed, and leave Ctrl-C to it. All compute with
    64-bit numbers of JAX where this process does.

    Attributes:
        jobs: the number of tasks at a time; −1 for one per core. A cluster runs one per core of its own.
        ray: the address of a Ray cluster: ``"auto"`` (the one of this machine or of ``RAY_ADDRESS``), ``"local"`` (a
            new one on this machine) or one such as ``"10.0.0.1:6379"``; ``None`` for processes on this machine.

    Raises:
        ValueError: when the number of jobs is 0 or below −1.
    """

    jobs: int = 1
    ray: str | None = None

    def __post_init__(self) -> None:
        if require_count("jobs", self.jobs, -1) == 0:
            raise ValueError("0 jobs would do nothing; ask for at least one, or for -1, one per core")

    def run(self, function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Result]]:
        """Call ``function(*task)`` for every task, and yield its index and its result when it is finished.

        The function and its arguments are pickled and may run on another machine, so the caller writes the results.

        Raises:
            ValueError: when a task cannot be pickled.
            ImportError: when joblib or ray is missing and needed.
            ConnectionError: when there is no cluster at the address.
            ChildProcessError: when a worker died, on a cluster more often than Ray repeats its task.
            Exception: any error of a task.
        """
        if self.ray is not None:
            yield from _on_cluster(self.ray, function, tasks)
        elif self.jobs == 1:
            for index, task in enumerate(tasks):
                yield index, function(*task)
        else:
            yield from _on_processes(self.jobs, function, tasks)


def _on_processes(
    jobs: int, function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[int, Result]]:
    try:
        from joblib import Parallel, delayed
    except ImportError as error:
        raise ImportError('several jobs need joblib: pip install "ptne-env[bench]"') from error
    run = Parallel(
        jobs,
        return_as="generator_unordered",
        batch_size=1,
        backend="loky",
        initializer=_begin,
        initargs=(os.getpid(), _settings_of_jax()),  # other ones start other processes
        max_nbytes=None,  # joblib makes no folders for large arrays then, which stay behind when processes are killed
        temp_folder=tempfile.gettempdir(),
    )
    calls = (delayed(_call_with_index)(index, function, task) for index, task in enumerate(tasks))
    try:
        with ExitStack() as stack:
            with _delay_ctrl_c():
                results = run(calls)
                stack.callback(_end, results)  # also when Ctrl-C comes at the end of this block
            for result in results:  # noqa: UP028 - yield from would close them before _end does
                yield result
    except BrokenProcessPool as error:
        raise ChildProcessError(
            "a worker process died, often for lack of memory (fewer jobs need less); stored results are kept"
        ) from error
    except PicklingError as error:
        *_, reason = str(error.__cause__ or error).strip(' \n"').splitlines()
        raise ValueError(
            f"a class or function of this program or notebook cannot be sent to other processes ({reason}): define "
            "it in a module, or run one job at a time"
        ) from error


def _settings_of_jax() -> dict[str, str]:
    """Return the environment variable that makes another process compute with JAX's numbers of this one."""
    jax = sys.modules.get("jax")
    return {} if jax is None else {"JAX_ENABLE_X64": str(jax.config.jax_enable_x64)}


def _begin(parent: int, variables: dict[str, str]) -> None:
    """Prepare this new process: it ends soon after its parent, given by id, is gone, and leaves Ctrl-C to it.

    A parent that is killed cannot end its processes itself. On Windows the parent's id does not change, so this process
    stays.
    """
    os.environ.update(variables)
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _end(results: Generator[Any, None, None]) -> None:
    """End unfinished tasks after an error, after Ctrl-C, or when the caller wants no more results."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # joblib counts the results that are lost
        results.close()


def _call_with_index(index: int, function: Callable[..., Result], task: tuple[Any, ...]) -> tuple[int, Result]:
    return index, function(*task)


@contextmanager
def _delay_ctrl_c() -> Iterator[None]:
    """Delay Ctrl-C to the end of the block; processes that start in the block never see it, even while they import."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    ensure_running()  # it unblocks Ctrl-C when joblib starts it, in Python 3.11
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_cluster(
    address: str, function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[int, Result]]:
    """Run each task as a task of Ray on one core; Ray runs those of a dead machine again elsewhere."""
    try:
        import ray
        from ray import exceptions
    except ImportError as error:
        raise ImportError('a Ray cluster needs an extra: pip install "ptne-env[ray]"') from error
    if not ray.is_initialized():
        _require_answer(address)
        ray.init(address=address, log_to_driver=False, logging_level="error")
    environment = {"runtime_env": {"env_vars": variables}} if (variables := _settings_of_jax()) else {}
    remote = ray.remote(num_cpus=1, max_retries=RETRIES, **environment)(_call_with_index)
    running = [remote.remote(index, function, task) for index, task in enumerate(tasks)]
    try:
        while running:
            (done,), running = ray.wait(running, num_returns=1)
            yield ray.get(done)
    except exceptions.RayTaskError as error:
        raise error.cause from error
    except exceptions.RayError as error:
        raise ChildProcessError(f"a task was lost {1 + RETRIES} times, with its worker or machine: {error}") from error
    finally:
        for task in running:
            ray.cancel(task)


def _require_answer(address: str) -> None:
    """Raise an error at once if nothing listens at the address, where Ray would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except OSError as error:
        raise ConnectionError(f"no Ray cluster answers at {address}: {error}") from error
