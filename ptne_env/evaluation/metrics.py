"""Metrics, which are functions of the series that a rollout records.

A metric is declared once, with its meaning, unit and direction. Tables, CSV files, pages, ``ptne list`` and docs
read :data:`METRICS`. :func:`register` adds a metric.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from ptne_env.evaluation.rollout import Rollout, regret_instants
from ptne_env.evaluation.statistics import STATISTICS
from ptne_env.perception.policy import describe
from ptne_env.shared.arrays import FloatArray, ordered_sum
from ptne_env.world import distances

MOST_DIGITS = 12.0
"""The digits of a distance at the floor; no more are counted."""

Block: TypeAlias = Literal["How close", "At what cost"]
"""The table in which a metric stands."""


def number(value: float | None) -> str:
    """Format a number with three significant digits; a dash stands for none."""
    if value is None:
        return "–"
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    if value == 0:
        return "0"
    if 1e-2 <= abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".")
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}"


@dataclass(frozen=True)
class Metric:
    """A number per episode, or a statistic of such numbers.

    Attributes:
        name: the key in records, CSV and JSON files.
        heading: the heading of a column.
        meaning: the meaning, in a sentence or phrase.
        direction: ``"higher"`` or ``"lower"``, whichever is better; ``None`` where neither is.
        block: the table in which it stands.
        value: the function from a rollout to numbers, shape (B,), NaN in an episode without a value; ``None`` where
            the metric follows from another one.
        unit: the unit; empty for a pure number.
        source: the metric whose episodes it summarises; the metric itself if left out.
        statistic: the name of the statistic over episodes, one of :data:`~ptne_env.evaluation.statistics.STATISTICS`.
        is_timing: whether it is a measured time, which another run does not repeat; such metrics are kept apart.

    Raises:
        ValueError: for another direction, block or statistic, or a value that cannot be called.
    """

    name: str
    heading: str
    meaning: str
    direction: Literal["higher", "lower"] | None = None
    block: Block = "How close"
    value: Callable[[Rollout], FloatArray] | None = None
    unit: str = ""
    source: str = ""
    statistic: str = "mean"
    is_timing: bool = False

    def __post_init__(self) -> None:
        allowed = {"direction": ("higher", "lower", None), "block": get_args(Block), "statistic": STATISTICS}
        for name, choices in allowed.items():
            if (value := getattr(self, name)) not in choices:
                expected = " or ".join(map(repr, choices))
                raise ValueError(f"the {name} of metric {self.name!r} is {expected}, got {value!r}")
        if not (self.value is None or callable(self.value)):
            raise ValueError(f"the value of metric {self.name!r} is a function of a Rollout, got {self.value!r}")
        object.__setattr__(self, "source", self.source or self.name)

    @property
    def label(self) -> str:
        """The heading with the unit, such as ``"settling time [s]"``."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading

    @property
    def is_own(self) -> bool:
        """Whether the user registered it."""
        return self.value is not None and not self.value.__module__.startswith("ptne_env.")


METRICS: dict[str, Metric] = {}
"""All metrics by name, in the order of tables."""


def register(metric: Metric) -> Metric:
    """Add a metric to :data:`METRICS`; workers get it too.

    Raises:
        TypeError: for anything but a metric.
        ValueError: when the name is taken, or the metric follows from nothing.
    """
    if not isinstance(metric, Metric):
        raise TypeError(f"register takes Metric(name, heading, meaning, direction, value=function), got {metric!r}")
    if metric.name in METRICS:
        raise ValueError(f"there is a metric {metric.name!r} already: choose another name")
    if metric.value is None and metric.source not in METRICS:
        raise ValueError(f"metric {metric.name!r} needs a value, a function of a Rollout, or the source of one")
    METRICS[metric.name] = metric
    return metric


def measure(rollout: Rollout) -> dict[str, FloatArray]:
    """Compute every metric of a rollout, by name: one value per episode, shape (B,).

    Raises:
        ValueError: when the function of a metric raises or returns something else; the message names the metric.
    """
    values, shape = {}, rollout.diverged.shape
    for name, metric in METRICS.items():
        if metric.value is None:
            continue
        try:
            values[name] = np.asarray(metric.value(rollout), dtype=np.float64)
        except (Exception, SystemExit) as error:
            raise ValueError(f"metric {name!r} raised {describe(error)}") from error
        if values[name].shape != shape:
            raise ValueError(
                f"metric {name!r} must return one number per episode, shape {shape}, got shape {values[name].shape}"
            )
    return values


def settling_time(rollout: Rollout) -> FloatArray:
    """Return the instant from which on strategies stay within the paper's 0.5 %; NaN where they end outside."""
    times, outside = rollout.world.clock.t, rollout["strategy_distance"] > distances.SUCCESS_DISTANCE
    last_outside = np.where(outside.any(axis=0), len(times) - 1 - outside[::-1].argmax(axis=0), -1)
    settled = last_outside < len(times) - 1
    return np.where(settled, times[np.minimum(last_outside + 1, len(times) - 1)], np.nan)


def _at_deadline(rollout: Rollout, series: str) -> FloatArray:
    return rollout[series][rollout.world.clock.steps]


def _digits_after_hold(rollout: Rollout) -> FloatArray:
    if not rollout.world.clock.hold_steps:
        return np.full(rollout.diverged.shape, np.nan)
    return distances.digits(rollout["estimate_distance"][-1])


def _digits_on_the_way(rollout: Rollout) -> FloatArray:
    steps = distances.digits(rollout["estimate_distance"][1 : rollout.world.clock.steps + 1])
    return ordered_sum(steps) / len(steps)


def _mean_regret(rollout: Rollout) -> FloatArray:
    """Return (1/T)∫ regret dt over the regret of the start, by the trapezoid rule; NaN where that regret is 0."""
    times, regrets = rollout.world.clock.t[regret_instants(rollout.world)], rollout["regret"]
    mean = ordered_sum(np.diff(times)[:, None] * (regrets[1:] + regrets[:-1]) / 2) / times[-1]
    return np.divide(mean, regrets[0], out=np.full_like(mean, np.nan), where=regrets[0] > 0)


# fmt: off
for _metric in (
    Metric("digits", "digits", "−log10 of the estimate distance at the deadline, at most 12", "higher",
           value=lambda rollout: distances.digits(_at_deadline(rollout, "estimate_distance"))),
    Metric("digits_on_the_way", "digits on the way", "mean of the digits after every step to the deadline", "higher",
           value=_digits_on_the_way),
    Metric("digits_cvar", "worst tenth", "mean digits of the worst tenth of the episodes (conditional value at risk)",
           "higher", source="digits", statistic="cvar"),
    Metric("strategy_distance", "strategy distance", "‖x − x*‖/‖x*‖ at the deadline (the paper's plots)", "lower",
           value=lambda rollout: _at_deadline(rollout, "strategy_distance")),
    Metric("estimate_distance", "estimate distance",
           "‖𝐱 − 1⊗x*‖/(√N ‖x*‖) at the deadline (as in the theorems)", "lower",
           value=lambda rollout: _at_deadline(rollout, "estimate_distance")),
    Metric("regret", "regret",
           "median Nikaido–Isoda regret Σ_i [J_i(x) − min over y of J_i(y, x_{-i})] at the deadline", "lower",
           value=lambda rollout: rollout["regret"][-1], statistic="median"),
    Metric("mean_regret", "mean regret",
           "median over episodes of the mean over time of the regret to the deadline; 1 is that of the start", "lower",
           value=_mean_regret, statistic="median"),
    Metric("settling_time", "settling time",
           "first instant after which the strategy distance stays within 0.5 %, in seconds", "lower", unit="s",
           value=settling_time),
    Metric("settled_share", "settled share", "share of episodes that settled by the end", "higher",
           value=lambda rollout: np.isfinite(settling_time(rollout)).astype(np.float64)),
    Metric("digits_after_hold", "digits after hold", "−log10 of the estimate distance after the hold phase, at most 12",
           "higher", value=_digits_after_hold),
    Metric("digits_gained", "digits gained",
           "mean over players of the summed digits reward, to the end of the episode", "higher",
           value=lambda rollout: rollout["mean_digits"][-1] - rollout["mean_digits"][0]),
    Metric("input_energy", "input energy", "Σ Δt ‖u‖² to the deadline", "lower", "At what cost",
           lambda rollout: ordered_sum(rollout["input_energy"])),
    Metric("peak_input", "peak |u|", "largest |u| to the deadline", "lower", "At what cost",
           lambda rollout: rollout["peak_input"].max(axis=0)),
    Metric("saturated_share", "saturated share", "share of input components at the input limit", "lower",
           "At what cost",
           lambda rollout: ordered_sum(rollout["saturated"]) / np.maximum(ordered_sum(rollout["components"]), 1)),
    Metric("diverged_share", "diverged share", "share of episodes that left the range", "lower", "At what cost",
           lambda rollout: rollout.diverged.astype(np.float64)),
    Metric("microseconds_per_decision", "µs per decision",
           "microseconds of the policy per player and step, all episodes in one batch", "lower", "At what cost",
           lambda rollout: np.full(rollout.diverged.shape, 1e6 * rollout.seconds_per_decision), is_timing=True),
):
    register(_metric)

OPTIONAL = {metric.name: metric for metric in (
    Metric("messages", "messages", "messages to the deadline, one per link, direction and step", "lower",
           "At what cost", lambda rollout: ordered_sum(rollout["messages"])),
    Metric("new_messages", "new messages", "messages that the same link did not carry in the step before", "lower",
           "At what cost", lambda rollout: ordered_sum(rollout["new_messages"])),
)}
"""Metrics that are measured where :func:`register` adds them, and so change no published result."""
# fmt: on
