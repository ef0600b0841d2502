"""Policies whose answers are wrong, or that harm their process: run them in a process of their own."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
from forgeries import sealed

from cheats.base import Cheat
from ptne_env.perception.observation import LayoutError

ESCAPES = "\x1b[2J\x1b]0;owned\x07\x1b[31mfalse\x1b[0m\r\n"
"""Clears a terminal, names its window and writes in red."""


class Hostile(Cheat):
    """Plays ``grounded``, and :meth:`harm` after some calls.

    Args:
        layout: of the environment.
        call: index of the call that harms.
    """

    def __init__(self, layout, call=2):
        super().__init__(layout)
        self.call, self.calls = call, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        """The harm, or honest actions where there is none."""
        self.calls += 1
        actions, state = super().predict(observation, state, episode_start, deterministic)
        return (self.harm(actions), state) if self.calls > self.call else (actions, state)

    def goals(self, seen, memory, episode_start):
        """No goals and no memory."""
        return np.full_like(seen.own_estimate, np.nan), None

    def harm(self, actions):
        """The answer in place of honest actions."""
        raise NotImplementedError


def answering(name, answer):
    """The class of policies that answer ``answer(actions)``."""
    return type(name, (Hostile,), {"harm": lambda self, actions: answer(actions), "__module__": __name__})


def raising(name, make):
    """The class of policies that raise the exception ``make()``."""

    def answer(actions):
        raise make()

    return answering(name, answer)


class Unpicklable:
    """An object that cannot leave its process, and whose text cannot be had."""

    def __reduce__(self):
        """Refused."""
        raise TypeError("cannot pickle")

    def __repr__(self):
        """Refused."""
        raise TypeError("no text")


class Bomb:
    """An object that ends the process that unpickles it."""

    def __reduce__(self):
        """The call that a reader of the pickle would make."""
        return os._exit, (77,)


# Wrong answers.
NotFinite = answering("NotFinite", lambda actions: np.full_like(actions, np.nan))
Infinite = answering("Infinite", lambda actions: np.full_like(actions, np.inf))
OneNaN = answering(
    "OneNaN", lambda actions: np.where(np.arange(actions.size).reshape(actions.shape) == 3, np.nan, actions)
)
FewRows = answering("FewRows", lambda actions: actions[:1])
ManyRows = answering("ManyRows", lambda actions: np.repeat(actions, 2, axis=0))
Transposed = answering("Transposed", lambda actions: actions.T)
Empty = answering("Empty", lambda actions: actions[:0])
Nothing = answering("Nothing", lambda actions: None)
Text = answering("Text", lambda actions: np.full(actions.shape, ESCAPES))
Objects = answering("Objects", lambda actions: np.full(actions.shape, Unpicklable(), dtype=object))
Bombs = answering("Bombs", lambda actions: np.full(actions.shape, Bomb(), dtype=object))
Complex = answering("Complex", lambda actions: actions + 1j)
Booleans = answering("Booleans", lambda actions: actions > 0)
Bytes = answering("Bytes", lambda actions: actions.tobytes())
Masked = answering("Masked", lambda actions: np.ma.masked_array(actions, mask=True))
Broadcast = answering("Broadcast", lambda actions: np.broadcast_to(np.float32(0), (2**40, *actions.shape)))
Memory = answering("Memory", lambda actions: np.ones((2**36, 8)))

# Exceptions, some of which no "except Exception" catches.
Raises = raising("Raises", lambda: ValueError("oops"))
RaisesEscapes = raising("RaisesEscapes", lambda: ValueError(ESCAPES))
RaisesLong = raising("RaisesLong", lambda: ValueError("x" * 10**8))
RaisesLayoutError = raising("RaisesLayoutError", lambda: LayoutError("late"))
Exits = raising("Exits", lambda: SystemExit(0))
Interrupts = raising("Interrupts", KeyboardInterrupt)
Stops = raising("Stops", StopIteration)
UnpicklableError = raising("UnpicklableError", lambda: ValueError(Unpicklable()))


class EndsProcess(Hostile):
    """Ends the process without a word, with an exit code of success."""

    def harm(self, actions):
        """Nothing comes back."""
        os._exit(0)


class Crashes(Hostile):
    """Ends the process as a fault of native code does."""

    def harm(self, actions):
        """Nothing comes back."""
        os.kill(os.getpid(), signal.SIGSEGV)


class EndsParent(Hostile):
    """Asks the parent process to end. Nothing short of another user account prevents it."""

    def harm(self, actions):
        """Honest actions."""
        os.kill(os.getppid(), signal.SIGTERM)
        return actions


class NeverReturns(Hostile):
    """Sleeps, and ignores requests to end."""

    def harm(self, actions):
        """Nothing comes back."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        while True:
            time.sleep(3600)


class Prints(Hostile):
    """Writes escape sequences to both streams, and to the descriptors behind them."""

    def harm(self, actions):
        """Honest actions."""
        for stream in (sys.stdout, sys.stderr):
            print(ESCAPES, file=stream, flush=True)
            os.write(stream.fileno(), ESCAPES.encode())
        return actions


class Forges(Hostile):
    """Writes bytes to every open descriptor, to answer in place of the code that serves it."""

    def harm(self, actions):
        """Honest actions."""
        for descriptor in range(1, 64):
            with contextlib.suppress(OSError):
                os.write(descriptor, np.ones(1000, dtype=np.float32).tobytes())
        return actions


class Closes(Hostile):
    """Closes every open descriptor."""

    def harm(self, actions):
        """Honest actions."""
        os.closerange(0, 64)
        return actions


class LeavesThread(Hostile):
    """Starts a thread that keeps its process alive."""

    def harm(self, actions):
        """Honest actions."""
        threading.Thread(target=time.sleep, args=(3600,)).start()
        return actions


class LeavesProcess(Hostile):
    """Starts a process that outlives it, in a session of its own and with open pipes. It ends after a minute."""

    def harm(self, actions):
        """Honest actions."""
        self.calls = -(10**9)  # once
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True, close_fds=False)
        return actions


class ChangesResults(Hostile):
    """Writes twelve digits into every stored job of a folder.

    Args:
        layout: of the environment.
        folder: of results.
    """

    def __init__(self, layout, folder="."):
        super().__init__(layout)
        self.folder = Path(folder)

    def harm(self, actions):
        """Honest actions."""
        for path in self.folder.glob("jobs/*.json"):
            job = json.loads(path.read_text(encoding="utf-8"))
            if "digits" in job["samples"]:
                job["samples"]["digits"] = [12.0] * len(job["samples"]["digits"])
                path.write_text(json.dumps(sealed(job)), encoding="utf-8")
        return actions
