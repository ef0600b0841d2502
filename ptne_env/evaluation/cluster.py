"""joblib on a Ray cluster: every task of joblib's is a task of Ray's.

Ray's own backend for joblib (``ray.util.joblib``) keeps a pool of actors. They get tasks in turn, also when they are
busy; results come when all tasks are done; and the run ends when the machine of an actor dies. With this backend each
task goes to a free core, and Ray runs the tasks of a dead machine again elsewhere. docs/scaling.md measures both.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from joblib.parallel import ParallelBackendBase

try:
    import ray
    from ray import exceptions
except ImportError as error:
    raise ImportError('a Ray cluster needs an extra: pip install "ptne-env[ray]"') from error

RETRIES = 3
"""How often Ray runs a task again whose worker or machine died."""


class RayTasks(ParallelBackendBase):
    """A backend for ``joblib.Parallel``.

    Args:
        address: as ``ray.init`` takes it. A connection that is there already is used.
    """

    supports_retrieve_callback = True

    def __init__(self, address: str | None = None) -> None:
        super().__init__()
        self.address = address
        self.submitted: dict[Future[Any], Any] = {}

    def configure(self, n_jobs: int = 1, parallel: Any = None, **_: Any) -> int:
        """Connect, and return the number of tasks that may be submitted at a time."""
        self.parallel = parallel
        if not ray.is_initialized():
            _require_answer(self.address)
            ray.init(address=self.address, log_to_driver=False, logging_level="error")
        return self.effective_n_jobs(n_jobs)

    def effective_n_jobs(self, n_jobs: int) -> int:
        """``n_jobs``; for −1 two per core of the cluster, so that a free core has its next task."""
        return n_jobs if n_jobs > 0 else max(2, 2 * int(ray.cluster_resources().get("CPU", 1)))

    def submit(self, func: Callable[[], Any], callback: Callable[[Future[Any]], None]) -> Future[Any]:
        """Start a task on one core."""
        reference = _task.remote(func)
        future: Future[Any] = reference.future()
        self.submitted[future] = reference
        future.add_done_callback(self.submitted.pop)
        future.add_done_callback(callback)
        return future

    def retrieve_result_callback(self, out: Future[Any]) -> Any:
        """The result of a task; its error is raised."""
        try:
            return out.result()
        except exceptions.RayTaskError as error:
            raise error.cause from error
        except exceptions.RayError as error:
            raise ChildProcessError(
                f"a task was lost {1 + RETRIES} times, with its worker or machine: {error}"
            ) from error

    def abort_everything(self, ensure_ready: bool = True) -> None:  # noqa: ARG002, FBT001, FBT002 - joblib's signature
        """Cancel the unfinished tasks."""
        for reference in tuple(self.submitted.values()):
            ray.cancel(reference)


def _require_answer(address: str | None) -> None:
    """Fail at once where nothing listens, where Ray itself would try for minutes."""
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except OSError as error:
        raise ConnectionError(f"no Ray cluster answers at {address}: {error}") from error


def _call(func: Callable[[], Any]) -> Any:
    return func()


_task = ray.remote(num_cpus=1, max_retries=RETRIES)(_call)
