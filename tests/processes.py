"""Programs in fresh interpreters."""

import os
import subprocess
import sys


def run_python(*arguments, folder=None, modules=()):
    """The finished process of ``python ARGUMENTS`` in ``folder``; the exit code must be 0.

    Further folders with modules come first in ``PYTHONPATH``.
    """
    paths = os.pathsep.join(filter(None, [*map(str, modules), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(  # noqa: S603 - our own programs
        [sys.executable, "-X", "utf8", *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done
