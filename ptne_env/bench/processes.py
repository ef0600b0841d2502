"""Processes that end with the process that started them."""

from __future__ import annotations

import os
import signal
import threading
import time

_PERIOD = 0.5
"""Seconds between two looks at the parent."""


def end_with_parent(parent: int | None = None) -> None:
    """End this process soon after its parent is gone, and leave Ctrl-C to the parent. Call it first in a new process.

    A parent that is killed cannot end its processes itself. On Windows the id of the parent stays, and so does this
    process.

    Args:
        parent: process id of the process that started this one; if left out, a parent that is gone already is not
            noticed.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(parent or os.getppid(),), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_PERIOD)
    os._exit(1)
