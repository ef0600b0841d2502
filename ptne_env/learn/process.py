"""Building a policy: in this process, or in a process of its own."""

from __future__ import annotations

import json
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from math import prod
from time import monotonic
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ptne_env.learn import probe
from ptne_env.learn.archive import load_archive
from ptne_env.learn.learned import LearnedPolicy
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError, decision, describe, printable
from ptne_env.shared.arrays import BoolArray
from ptne_env.shared.parts import LOADER, FactorySpec
from ptne_env.shared.processes import end_with_parent

PolicySource: TypeAlias = FactorySpec | Policy | Callable[[ObservationLayout], Policy]
"""A factory spec or a callable that builds the policy from a layout, or the policy itself."""

PATIENCE = 300.0
"""Seconds that a process may take to start, and to read observations and answer them, from first to last byte."""

# The paths are those of this process, so that nothing is imported from the current folder before other folders.
_MAIN = (
    "import sys; sys.path[:] = sys.argv[3:]; from ptne_env.learn.process import serve; serve(*map(int, sys.argv[1:3]))"
)
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_OTHER_FORM = "its process answered in another form"
_LENGTH = struct.Struct("!Q")
_LONGEST_ANSWER = 1 << 16
_DTYPES = ("float32", "float64")


def build(source: PolicySource, layout: ObservationLayout) -> Policy:
    """Build a policy in this process.

    Args:
        source: of the policy.
        layout: of its observations.

    Raises:
        LayoutError: when it was made for another layout.
        PolicyError: when building it raises anything else, or the result has no ``predict``.
    """
    built: Any = source
    try:
        if isinstance(source, FactorySpec):
            built = source.build(layout=layout)
        elif isinstance(source, type) or not hasattr(source, "predict"):
            built = source(layout)
        if isinstance(built, LearnedPolicy):
            built.require(layout)
    except (LayoutError, MemoryError):
        raise
    except Exception as error:
        called = "; it is called with the layout" * isinstance(error, TypeError)
        raise PolicyError(f"it cannot be built: {describe(error)}{called}") from error
    expected = getattr(getattr(built, "observation_space", None), "shape", None)  # of a Stable-Baselines3 model
    if expected not in (None, (layout.size,)):
        raise LayoutError(
            f"it was trained on observations of shape {expected}, and this track with the interface "
            f"{layout.interface.kind!r} has {(layout.size,)}; if it was trained with another interface, give that one: "
            "PolicySpec(name, model, ptne_env.Interface('scaled'))"
        )
    if not hasattr(built, "predict"):
        raise PolicyError(f"it is a {type(built).__name__} without predict(observation, state, ...)")
    policy: Policy = built
    return policy


def declared_interface(source: FactorySpec) -> Interface:
    """The attribute ``interface`` of a foreign target, or of the policy in a file; ``physical`` where there is none.

    Raises:
        PolicyError: when the target cannot be imported, or its interface is none of this library.
    """
    process = _Process(source, None)
    try:
        return Interface(**process.answer()["interface"])
    except (KeyError, TypeError, ValueError) as error:
        raise PolicyError(_OTHER_FORM) from error
    finally:
        process.close()


@contextmanager
def separate(source: FactorySpec, layout: ObservationLayout) -> Iterator[Policy]:
    """A policy that decides in a process of its own, which ends with the context.

    The process receives observations and sends actions. So the policy cannot reach the world, and its process
    executes no code here: the answers are read as numbers. The memory of the policy stays in its process. Output of the
    policy is not shown. The process of an ``.onnx`` file cannot open files, and its memory is limited
    (:data:`ptne_env.learn.probe.MEMORY`).

    Raises:
        LayoutError: when the policy was made for another layout.
        PolicyError: when it cannot be built, and from ``predict`` when it raises, ends its process, answers in another
            form, or takes longer than :data:`PATIENCE`.
    """
    process = _Process(source, layout)
    try:
        process.answer()
        yield process
    finally:
        process.close()


class _Process:
    """The side of the caller; a :class:`~ptne_env.perception.policy.Policy`."""

    def __init__(self, source: FactorySpec, layout: ObservationLayout | None) -> None:
        mine, theirs = socket.socketpair()
        self._connection, self._deadline = mine, 0.0
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - our own command
                [sys.executable, "-P", "-c", _MAIN, str(theirs.fileno()), str(os.getpid()), *sys.path],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # its output may hold escape sequences
                stderr=subprocess.DEVNULL,
                env=os.environ | _ONE_THREAD,
                process_group=0,  # Ctrl-C does not reach it, and processes that it starts end with it
            )
        self._ask(pickle.dumps((source, layout)))

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[npt.NDArray[Any], Any]:
        rows = np.ascontiguousarray(observation, dtype=np.float32)
        starts = np.zeros(len(rows), dtype=np.bool_) if episode_start is None else episode_start
        head = bytes([state is None, deterministic])
        self._ask(head + starts.tobytes() + rows.tobytes())
        answer = self.answer()
        dtype, shape = answer.get("dtype"), answer.get("shape")
        if dtype not in _DTYPES or not isinstance(shape, list) or not all(isinstance(n, int) and n >= 0 for n in shape):
            raise PolicyError(_OTHER_FORM)
        size = prod(shape) * np.dtype(dtype).itemsize
        if size > 64 * (rows.nbytes + 1):
            raise PolicyError(f"it answered with actions of shape {tuple(shape)}")
        with self._errors():
            actions = _read(self._connection, size, self._deadline)
        return np.frombuffer(actions, dtype=dtype).reshape(shape), True

    def answer(self) -> dict[str, Any]:
        """The next answer, which is an object of numbers and texts."""
        with self._errors():
            answer = json.loads(_receive(self._connection, _LONGEST_ANSWER, self._deadline))
        if not isinstance(answer, dict):
            raise PolicyError(_OTHER_FORM)
        if "layout_error" in answer:
            raise LayoutError(printable(str(answer["layout_error"])))
        if "error" in answer:
            raise PolicyError(printable(str(answer["error"])))
        return answer

    def close(self) -> None:
        """End the process, and those that it started in its group."""
        self._connection.close()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _ended(self) -> PolicyError:
        try:
            status = self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            return PolicyError("its process ended the connection")
        how = f"with signal {-status}" if status < 0 else f"with exit status {status}"
        return PolicyError(f"its process ended {how}")

    def _ask(self, content: bytes) -> None:
        """Send a message, whose answer is due within :data:`PATIENCE` from now."""
        self._deadline = monotonic() + PATIENCE
        self._connection.settimeout(PATIENCE)  # of all bytes together
        with self._errors():
            _send(self._connection, content)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except TimeoutError as error:
            raise PolicyError(f"it took longer than {PATIENCE:g} s") from error
        except (OSError, EOFError) as error:
            raise self._ended() from error
        except (ValueError, RecursionError) as error:
            raise PolicyError(_OTHER_FORM) from error


def _send(connection: socket.socket, content: bytes) -> None:
    connection.sendall(_LENGTH.pack(len(content)) + content)


def _receive(connection: socket.socket, longest: int, deadline: float | None = None) -> bytes:
    """The next message, of at most ``longest`` bytes; see :func:`_read`."""
    (size,) = _LENGTH.unpack(_read(connection, _LENGTH.size, deadline))
    if size > longest:
        raise ValueError(f"a message of {size} bytes, expected at most {longest}")
    return _read(connection, size, deadline)


def _read(connection: socket.socket, size: int, deadline: float | None) -> bytes:
    """The next ``size`` bytes; ``TimeoutError`` when the last one is not there at the deadline."""
    content = bytearray(size)
    missing = memoryview(content)
    while missing:
        if deadline is not None:  # a limit for each call would start again with every byte
            connection.settimeout(max(deadline - monotonic(), 1e-6))
        count = connection.recv_into(missing)
        if not count:
            raise EOFError
        missing = missing[count:]
    return bytes(content)


def serve(descriptor: int, caller: int) -> None:
    """The side of the policy: build it, and answer observations with actions until the caller is gone.

    Args:
        descriptor: of the connection to the caller, whose first message is the source and the layout; without a
            layout the answer is the interface of the policy.
        caller: number of its process.
    """
    end_with_parent(caller)
    connection = socket.socket(fileno=descriptor)
    source, layout = pickle.loads(_receive(connection, sys.maxsize))  # noqa: S301 - of the caller, which trusts itself
    try:
        if layout is None:
            _answer(connection, interface=asdict(_interface(source)))
            return
        if source.target == LOADER:
            probe.stay()
        policy, memory = build(source, layout), None
        _answer(connection)
        while True:
            message = _receive(connection, sys.maxsize)
            rows = (len(message) - 2) // (1 + 4 * layout.size)
            starts = np.frombuffer(message, np.bool_, rows, offset=2).copy()
            observations = np.frombuffer(message, np.float32, offset=2 + rows).reshape(rows, layout.size).copy()
            is_first, deterministic = message[:2]
            memory = None if is_first else memory
            actions, memory = decision(policy, observations, memory, starts, deterministic=bool(deterministic))
            array = np.asarray(actions)
            array = array if array.dtype.name in _DTYPES else array.astype(np.float64)
            _answer(connection, dtype=array.dtype.name, shape=array.shape)
            connection.sendall(array.tobytes())
    except EOFError:  # the caller is done
        return
    except LayoutError as error:
        _answer(connection, layout_error=str(error))
    except PolicyError as error:
        _answer(connection, error=str(error))
    except BaseException as error:  # noqa: BLE001 - foreign code may raise anything, SystemExit too
        _answer(connection, error=describe(error))


def _answer(connection: socket.socket, **answer: Any) -> None:
    _send(connection, json.dumps(answer).encode())


def _interface(source: FactorySpec) -> Interface:
    target = source.resolve()
    described = source.build() if target is load_archive else target
    interface = getattr(described, "interface", Interface())
    if not isinstance(interface, Interface):
        raise PolicyError(f"the interface of {source.target} is an Interface of ptne_env, got {interface!r}")
    return interface
