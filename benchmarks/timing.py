"""Fair timing: contenders take turns, and every figure is a median over the turns with its range."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

import numpy as np


@dataclass(frozen=True)
class Plan:
    """Duration of a measurement.

    Attributes:
        repeats: turns of every contender.
        seconds: duration of a turn.
        quick: whether the run only checks that everything works; such a run has smaller batches.
    """

    repeats: int = 5
    seconds: float = 1.0
    quick: bool = False


QUICK = Plan(repeats=2, seconds=0.02, quick=True)
"""The plan of ``--quick``: its figures mean little."""


@dataclass(frozen=True)
class Spread:
    """A median and its range over the repeats."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """The median, the smallest and the largest of ``values``."""
        return cls(float(np.median(values)), float(min(values)), float(max(values)))

    def to_dict(self) -> dict[str, float]:
        """As a JSON object."""
        return asdict(self)


@dataclass(frozen=True)
class Contender:
    """A function that can be called without end, and its name in tables.

    Attributes:
        name: in tables.
        agent_steps: agents that one call of ``step`` moves.
        step: moves all agents once, and resets finished episodes.
        prepare: called before each turn.
    """

    name: str
    agent_steps: int
    step: Callable[[], object]
    prepare: Callable[[], object] = lambda: None


def _turn(contender: Contender, seconds: float) -> float:
    """Agent-steps per second over about ``seconds``, after a short warm-up."""
    contender.prepare()
    began = perf_counter()
    calls = 0
    while perf_counter() - began < seconds / 10 or calls < 2:
        contender.step()
        calls += 1
    calls = max(1, round(calls * seconds / (perf_counter() - began)))
    began = perf_counter()
    for _ in range(calls):
        contender.step()
    return calls * contender.agent_steps / (perf_counter() - began)


def interleave(contenders: Sequence[Contender], plan: Plan) -> dict[str, list[float]]:
    """Agent-steps per second of every contender, one number per repeat; within a repeat they take turns.

    A busy period of the machine slows all contenders, so ratios within a repeat stay fair.
    """
    rates: dict[str, list[float]] = {contender.name: [] for contender in contenders}
    for _ in range(plan.repeats):
        for contender in contenders:
            rates[contender.name].append(_turn(contender, plan.seconds))
    return rates


def ratio(rates: Mapping[str, Sequence[float]], ours: str, peer: str) -> Spread:
    """Speed of ``ours`` as a multiple of the speed of ``peer``, repeat by repeat."""
    return Spread.of([mine / theirs for mine, theirs in zip(rates[ours], rates[peer], strict=True)])


def seconds_per_call(call: Callable[[], object], plan: Plan, slices: int = 20) -> float:
    """Median wall time of one call over many short slices, for parts too short to take turns."""
    began = perf_counter()
    calls = 0
    while perf_counter() - began < plan.seconds / 20 or calls < 2:
        call()
        calls += 1
    per_slice = max(1, round(calls / 2))
    times = []
    for _ in range(slices if not plan.quick else 2):
        began = perf_counter()
        for _ in range(per_slice):
            call()
        times.append((perf_counter() - began) / per_slice)
    return float(np.median(times))
