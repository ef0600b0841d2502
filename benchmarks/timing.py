"""Fair timing: contenders take turns, and every figure is a median over the turns with its range."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter


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


def interleave(contenders: Sequence[Contender], turns: int, seconds: float) -> dict[str, list[float]]:
    """Agent-steps per second of every contender, by name, one number per turn; they take turns of some ``seconds``.

    A busy period of the machine slows all contenders, so ratios within a turn stay fair.
    """
    rates: dict[str, list[float]] = {contender.name: [] for contender in contenders}
    for _ in range(turns):
        for contender in contenders:
            rates[contender.name].append(_rate(contender, seconds))
    return rates


def _rate(contender: Contender, seconds: float) -> float:
    """Agent-steps per second over about ``seconds``, after a short warm-up."""
    contender.prepare()
    contender.step()
    began, calls = perf_counter(), 0
    while perf_counter() - began < seconds / 10 or calls < 2:
        contender.step()
        calls += 1
    calls = max(1, round(calls * seconds / (perf_counter() - began)))
    began = perf_counter()
    for _ in range(calls):
        contender.step()
    return calls * contender.agent_steps / (perf_counter() - began)
