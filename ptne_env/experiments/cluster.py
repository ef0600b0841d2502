"""joblib on a Ray cluster: every task of joblib's is a task of Ray's.

Ray has a backend for joblib itself (``ray.util.joblib``). It keeps a pool of actors, which get tasks in turn and not
when they are free; it hands over results when all are there; and an actor whose machine dies takes the run with it.
Tasks go where a core is free, one by one, and Ray runs those of a dead machine again elsewhere. docs/scaling.md
measures both.
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
    raise ImportError('the backend "ray" needs an extra: pip install "ptne-env[ray]"') from error

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
        """Connect, and say how many tasks may be submitted at a time."""
        self.parallel = parallel
        if not ray.is_initialized():
            _require_answer(self.address)
            ray.init(address=self.address, log_to_driver=False, logging_level="error")
        return self.effective_n_jobs(n_jobs)

    def effective_n_jobs(self, n_jobs: int) -> int:
        """The number itself; of -1 two per core of the cluster, so that a core that is free finds its next task."""
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
        """What a task returned; what it raised is raised."""
        try:
            return out.result()
        except exceptions.RayTaskError as error:
            raise error.cause from error
        except exceptions.RayError as error:
            raise ChildProcessError(
                f"a task was lost {1 + RETRIES} times, with its worker or machine: {error}"
            ) from error

    def abort_everything(self, ensure_ready: bool = True) -> None:  # noqa: ARG002, FBT001, FBT002 - joblib's signature
        """Give up what has not been returned."""
        for reference in tuple(self.submitted.values()):
            ray.cancel(reference)


def _require_answer(address: str | None) -> None:
    """Fail at once where nothing listens: Ray itself goes on trying for minutes."""
    host, _, encoder = (address or "").removeprefix("ray://").rpartition(":")
    if not (host and encoder.isdigit()):
        return
    try:
        socket.create_connection((host, int(encoder)), timeout=10).close()
    except OSError as error:
        raise ConnectionError(f"no Ray cluster answers at {address}: {error}") from error


def _call(func: Callable[[], Any]) -> Any:
    return func()


_task = ray.remote(num_cpus=1, max_retries=RETRIES)(_call)
