"""Programs in fresh interpreters, and kills of programs with all their processes."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import IO

PATIENCE = 30.0
"""Seconds after a kill within which every process of a program has to end."""

KILLS = [(number, of_group) for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT) for of_group in (False, True)]
"""Signals, each for the first process alone and for its process group."""

_MARK = "PTNE_TEST_MARK"


def run_python(*arguments, folder=None, modules=()):
    """The finished process of ``python ARGUMENTS`` in ``folder``; the exit code must be 0.

    Further folders with modules come first in ``PYTHONPATH``.
    """
    done = subprocess.run(  # noqa: S603 - our own programs
        [sys.executable, "-X", "utf8", *map(str, arguments)],
        cwd=folder,
        env=_environment(modules),
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done


@dataclass
class Program:
    """A running program in a session of its own.

    Attributes:
        process: the first process.
        mark: in the environment of all its processes.
        output: file of stdout and stderr.
        printed: text of that file, once the program has ended.
    """

    process: subprocess.Popen
    mark: str
    output: IO
    printed: str = ""

    def alive(self):
        """Command lines of all processes of this program, by process id; zombies have ended."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if f"{_MARK}={self.mark}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:  # it has just ended, or is of another user
                continue
        return found

    def kill(self, number, *, of_group):
        """Send a signal, and assert that no process is left after :data:`PATIENCE`.

        A program that treats Ctrl-C, and ends with exit code 130, must print no traceback.
        """
        (os.killpg if of_group else os.kill)(self.process.pid, number)
        deadline = time.monotonic() + PATIENCE
        while (self.process.poll() is None or self.alive()) and time.monotonic() < deadline:
            time.sleep(0.02)
        left = self.alive()
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        self.process.wait(timeout=PATIENCE)
        self._read()
        assert not left, f"left {PATIENCE:g} s after {number!r} {of_group=}: {left}"
        assert self.process.returncode != 130 or "Traceback" not in self.printed, self.printed

    def finish(self):
        """Wait for the end; the exit code must be 0."""
        self.process.wait(timeout=300)
        self._read()
        assert self.process.returncode == 0, self.printed

    def _read(self):
        with self.output as file:
            file.seek(0)
            self.printed = file.read().decode(errors="replace")


def start_python(*arguments, folder=None, modules=()):
    """Start ``python ARGUMENTS`` in ``folder`` as a :class:`Program`; the arguments are those of :func:`run_python`."""
    mark = uuid.uuid4().hex
    output = tempfile.TemporaryFile()  # noqa: SIM115 - a pipe would be full, and closed only by the last process
    # Programs that run in the background ignore SIGINT, and so would their subprocesses.
    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(  # noqa: S603 - our own programs
            [sys.executable, "-X", "utf8", *map(str, arguments)],
            cwd=folder,
            env=_environment(modules) | {_MARK: mark},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
    finally:
        signal.signal(signal.SIGINT, ignored)
    return Program(process, mark, output)


def kill_at_random_moments(start, kills, longest, seed):
    """Start a program again and again, and kill each at a random moment; return the number of programs killed.

    A program that ends before its moment has to end with exit code 0, and is not counted.

    Args:
        start: starts the program, and returns a :class:`Program`.
        kills: pairs of a signal and whether it is for the whole process group, such as :data:`KILLS`.
        longest: seconds until the last moment.
        seed: of the moments.
    """
    randomness, killed = random.Random(seed), 0  # noqa: S311 - moments to kill at
    for number, of_group in kills:
        program = start()
        moment = time.monotonic() + randomness.uniform(0, longest)
        while time.monotonic() < moment and program.process.poll() is None:
            time.sleep(0.005)
        if program.process.poll() is None:
            program.kill(number, of_group=of_group)
            killed += 1
        else:
            program.finish()
    return killed


def _environment(modules):
    paths = os.pathsep.join(filter(None, [*map(str, modules), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": paths}
