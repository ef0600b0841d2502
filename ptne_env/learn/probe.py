"""A trial of an ONNX file in a process of its own, with limited time, memory and files.

Folding the constants of a file and running it take the time and memory that the file asks for, before its content can
be seen. :func:`refusal` lets another process find out. That process runs this file as a script, so it imports
onnxruntime and numpy alone. A process that is made for one file alone limits itself: :func:`stay`.
"""

from __future__ import annotations

import contextlib
import hashlib
import subprocess
import sys
from typing import Any

MEMORY = 2 << 30
"""Address space of the process, in bytes; onnxruntime itself takes less than a tenth of it."""

SECONDS = 5
"""Processor time of the process; loading a shipped policy takes 0.2 s."""

WAIT = 30.0
"""Seconds until the process is ended from outside; more than :data:`SECONDS`, since others may use the processor."""

_passed: set[bytes] = set()
"""Hashes of the contents that this process has tried with success."""

_stays = False
"""Whether this process limits itself."""


def stay() -> None:
    """Let :func:`refusal` limit this process for the rest of its time, instead of a trial in another process.

    Its processor time is not limited: the process that made it sees to that.
    """
    global _stays  # noqa: PLW0603 - limits are of a process
    _stays = True


def refusal(content: bytes, rows: int) -> str | None:
    """Load the content of an ONNX file and run it on ``rows`` rows of zeros, in a process of its own.

    Other sizes that the file leaves open are 1.

    That process ends with this one. It cannot open files, so a file that keeps weights in another file fails. Where the
    system has no limits for a process (Windows), only the time until :data:`WAIT` is limited.

    Returns:
        ``None`` when the file works, and at once for content that worked before; else the reason.
    """
    if _stays:
        import onnxruntime  # noqa: F401 - before files are out of reach

        _limit(MEMORY)
        return None
    digest = hashlib.sha256(content).digest()
    if digest in _passed:
        return None
    # The paths are those of this process, so that the same packages are imported, and none from the current folder.
    command = [sys.executable, "-I", "-S", __file__, *map(str, (MEMORY, SECONDS, rows)), *sys.path]
    try:
        done = subprocess.run(command, input=content, capture_output=True, timeout=WAIT, check=False)  # noqa: S603 - our own script
    except subprocess.TimeoutExpired:
        return f"it needs more than {WAIT:g} s to load"
    if done.returncode == 0:
        _passed.add(digest)
        return None
    if done.returncode == 1:  # onnxruntime's own words
        return " ".join(done.stdout.decode(errors="replace").split())
    return f"it needs more than {SECONDS} s of processor time or {MEMORY >> 20} MiB of memory to load, or crashes"


def open_session(content: bytes) -> Any:
    """The ``onnxruntime.InferenceSession`` of a file's content, on one thread.

    Raises:
        Exception: of onnxruntime, for a damaged file.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # the networks are small, and one thread gives the same bits everywhere
    options.log_severity_level = 4
    # Weights in other files are looked for below a file, so none is found; old versions ignore this.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", __file__)
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)


def _limit(memory: int, seconds: int | None = None) -> None:
    """Limit this process as far as the system can."""
    with contextlib.suppress(ImportError):
        import resource

        if seconds is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def _end_with_parent() -> None:
    if sys.platform == "linux":
        import ctypes
        import signal

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG; a thread could not run while a file is loaded


def _main(memory: str, seconds: str, rows: str, *paths: str) -> None:
    _end_with_parent()
    sys.path[:] = paths
    import numpy as np
    import onnxruntime  # noqa: F401 - before files are out of reach

    content = sys.stdin.buffer.read()
    _limit(int(memory), int(seconds))
    try:
        session = open_session(content)
        given = {
            each.name: (int(rows), *(size if isinstance(size, int) else 1 for size in each.shape[1:]))
            for each in session.get_inputs()
        }
        session.run(None, {name: np.zeros(shape, dtype=np.float32) for name, shape in given.items()})
    except Exception as error:  # noqa: BLE001 - onnxruntime's classes are not public
        sys.stdout.write(str(error))
        sys.exit(1)


if __name__ == "__main__":
    _main(*sys.argv[1:])
