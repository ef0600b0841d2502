"""Metrics: each declared once, with its name, meaning, unit, direction, format, and how it follows from a rollout.

Tables, CSV files, pages, ``ptne list`` and docs read :data:`METRICS`. :func:`register` adds a metric.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Literal, TypeAlias

import numpy as np

from ptne_env.evaluation.rollout import Rollout
from ptne_env.shared.arrays import FloatArray, ordered_sum
from ptne_env.world import distances

FINE_DISTANCE = 1e-6
"""The relative distance of fine settling."""

NUMBER_BITS = 32
"""Bits of a number in a message: estimates are sent as float32."""

CVAR_SHARE = 0.1
"""The share of the worst episodes over which the conditional value at risk (CVaR) is the mean."""

Statistic: TypeAlias = Literal["mean", "cvar"]
"""Over episodes: the mean, or the mean of the worst tenth."""

Block: TypeAlias = Literal["How close", "At what cost"]
"""The tables in which metrics stand."""


def number(value: float | None) -> str:
    """A number with three significant digits, or a dash where there is none."""
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


def share(value: float | None) -> str:
    """A score or a probability, whose zero is a matter of rounding, with three decimals; a dash where there is none."""
    return "–" if value is None else f"{value + 0.0:.3f}".replace("-0.000", "0.000")


@dataclass(frozen=True)
class Metric:
    """A number per episode, or a statistic of such numbers.

    Attributes:
        name: key of records, CSV and JSON files.
        heading: of a column.
        meaning: in one sentence or phrase.
        direction: of better values; ``None`` where neither is better.
        block: the table in which it stands.
        value: of a rollout, shape (B,), NaN in an episode without a value; ``None`` where it follows from others.
        unit: empty for a pure number.
        source: the metric whose episodes it summarises; its own where left out.
        statistic: over episodes: the mean, or the mean of the worst tenth ("cvar").
        format: makes the text of a value, a dash where there is none.
        is_timing: whether it is a measured time, which another run does not repeat; such metrics are kept apart.
    """

    name: str
    heading: str
    meaning: str
    direction: Literal["higher", "lower"] | None = None
    block: Block = "How close"
    value: Callable[[Rollout], FloatArray] | None = None
    unit: str = ""
    source: str = ""
    statistic: Statistic = "mean"
    format: Callable[[float | None], str] = number
    is_timing: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", self.source or self.name)

    @property
    def label(self) -> str:
        """The heading with the unit, such as ``"settling time [s]"``."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading


METRICS: dict[str, Metric] = {}
"""All metrics by name, in the order of tables."""


def register(metric: Metric) -> Metric:
    """Add a metric to :data:`METRICS`; workers get it too.

    Raises:
        ValueError: when the name is taken.
    """
    if metric.name in METRICS:
        raise ValueError(f"there is a metric {metric.name!r} already: choose another name")
    METRICS[metric.name] = metric
    return metric


def own_metrics() -> tuple[Metric, ...]:
    """The registered metrics that follow from a rollout and are defined outside this module, for :func:`adopt`."""
    measured = (metric for metric in METRICS.values() if metric.value is not None)
    return tuple(metric for metric in measured if metric.value.__module__ != __name__)


def adopt(metrics: Iterable[Metric]) -> None:
    """Register the metrics of another process, by importing the modules that define them where they can be imported."""
    for metric in metrics:
        if metric.value is not None and metric.value.__module__ != "__main__":
            import_module(metric.value.__module__)
        METRICS.setdefault(metric.name, metric)


def measure(rollout: Rollout) -> dict[str, FloatArray]:
    """Every metric that follows from a rollout, by name, one value per episode: shape (B,)."""
    return {metric.name: metric.value(rollout) for metric in METRICS.values() if metric.value is not None}


def settling_time(
    times: FloatArray, strategy_distance: FloatArray, threshold: float = distances.SUCCESS_DISTANCE
) -> FloatArray:
    """First instant after which the distance stays within ``threshold`` to the end.

    Args:
        times: of the instants, shape (instants,).
        strategy_distance: shape (instants, B).
        threshold: relative distance.

    Returns:
        Seconds, shape (B,); NaN for an episode that ends outside.
    """
    outside = strategy_distance > threshold
    last_outside = np.where(outside.any(axis=0), len(times) - 1 - outside[::-1].argmax(axis=0), -1)
    settled = last_outside < len(times) - 1
    return np.where(settled, times[np.minimum(last_outside + 1, len(times) - 1)], np.nan)


def _settling(rollout: Rollout, threshold: float) -> FloatArray:
    return settling_time(rollout.world.clock.t, rollout["strategy_distance"], threshold)


def _settled(rollout: Rollout, threshold: float) -> FloatArray:
    return np.isfinite(_settling(rollout, threshold)).astype(np.float64)


def _at_deadline(rollout: Rollout, series: str) -> FloatArray:
    return rollout[series][rollout.world.clock.steps]


def _digits_after_hold(rollout: Rollout) -> FloatArray:
    if not rollout.world.clock.hold_steps:
        return np.full(rollout.diverged.shape, np.nan)
    return distances.digits(rollout["estimate_distance"][-1])


def _log_error_area(rollout: Rollout) -> FloatArray:
    clock = rollout.world.clock
    to_deadline = slice(clock.steps + 1)
    log_errors = -distances.digits(rollout["estimate_distance"][to_deadline])
    return _area(clock.t[to_deadline], log_errors) / clock.deadline


def _area(times: FloatArray, values: FloatArray) -> FloatArray:
    """The integral of ``values`` (I, B) over ``times`` (I,) by the trapezoidal rule, shape (B,)."""
    return ordered_sum(np.diff(times)[:, None] * (values[1:] + values[:-1]) / 2)


def _saturated_share(rollout: Rollout) -> FloatArray:
    return ordered_sum(rollout["saturated"]) / np.maximum(ordered_sum(rollout["components"]), 1)


def _bits(rollout: Rollout) -> FloatArray:
    return ordered_sum(rollout["messages"]) * rollout.world.game.dimension * NUMBER_BITS


def _microseconds(rollout: Rollout) -> FloatArray:
    return np.full(rollout.diverged.shape, 1e6 * rollout.seconds_per_decision)


# fmt: off
for _metric in (
    Metric("digits", "digits", "−log10 of the estimate distance at the deadline, at most 12", "higher",
           value=lambda rollout: distances.digits(_at_deadline(rollout, "estimate_distance"))),
    Metric("digits_cvar", "CVaR (10 %)", "mean digits of the worst tenth of the episodes (conditional value at risk)",
           "higher", source="digits", statistic="cvar"),
    Metric("strategy_distance", "strategy distance", "‖x − x*‖/‖x*‖ at the deadline (the paper's plots)", "lower",
           value=lambda rollout: _at_deadline(rollout, "strategy_distance")),
    Metric("estimate_distance", "estimate distance",
           "‖𝐱 − 1⊗x*‖/(√N ‖x*‖) at the deadline (as in the theorems)", "lower",
           value=lambda rollout: _at_deadline(rollout, "estimate_distance")),
    Metric("consensus_error", "consensus error", "‖𝐱 − 1⊗x̄‖/(√N ‖x*‖) at the deadline", "lower",
           value=lambda rollout: rollout["consensus_error"][0]),
    Metric("regret", "regret",
           "Nikaido–Isoda regret Σ_i [J_i(x) − min over y of J_i(y, x_{-i})] at the deadline", "lower",
           value=lambda rollout: rollout["regret"][0]),
    Metric("settling_time", "settling time",
           "first instant after which the strategy distance stays within 0.5 %, in seconds", "lower", unit="s",
           value=lambda rollout: _settling(rollout, distances.SUCCESS_DISTANCE)),
    Metric("settled_share", "settled share", "share of episodes that settled by the end", "higher",
           value=lambda rollout: _settled(rollout, distances.SUCCESS_DISTANCE)),
    Metric("settling_time_1e_6", "settling to 1e-6",
           "first instant after which the strategy distance stays within 1e-6, in seconds", "lower", unit="s",
           value=lambda rollout: _settling(rollout, FINE_DISTANCE)),
    Metric("settled_share_1e_6", "settled to 1e-6", "share of episodes that settled to 1e-6 by the end", "higher",
           value=lambda rollout: _settled(rollout, FINE_DISTANCE)),
    Metric("digits_after_hold", "digits after hold", "−log10 of the estimate distance after the hold phase, at most 12",
           "higher", value=_digits_after_hold),
    Metric("digits_gained", "digits gained",
           "mean over players of the summed digits reward, to the end of the episode", "higher",
           value=lambda rollout: rollout["mean_digits"][1] - rollout["mean_digits"][0]),
    Metric("log_error_area", "mean log10 error", "mean of log10 of the estimate distance over [0, T]", "lower",
           value=_log_error_area),
    Metric("input_energy", "input energy", "Σ Δt ‖u‖² to the deadline", "lower", "At what cost",
           lambda rollout: ordered_sum(rollout["input_energy"])),
    Metric("velocity_energy", "velocity energy", "Σ Θ² ‖u‖²/Δt to the deadline", "lower", "At what cost",
           lambda rollout: ordered_sum(rollout["velocity_energy"])),
    Metric("peak_input", "peak |u|", "largest |u| to the deadline", "lower", "At what cost",
           lambda rollout: rollout["peak_input"].max(axis=0)),
    Metric("peak_velocity", "peak velocity", "largest Θ|u|/Δt to the deadline, per second", "lower", "At what cost",
           lambda rollout: rollout["peak_velocity"].max(axis=0), unit="1/s"),
    Metric("saturated_share", "saturated share", "share of input components at the input limit", "lower",
           "At what cost", _saturated_share),
    Metric("diverged_share", "diverged share", "share of episodes that left the range", "lower", "At what cost",
           lambda rollout: rollout.diverged.astype(np.float64)),
    Metric("messages", "messages", "estimates sent over live links until the deadline", "lower", "At what cost",
           lambda rollout: ordered_sum(rollout["messages"])),
    Metric("bits", "bits", f"bits in these messages, {NUMBER_BITS} per number", "lower", "At what cost", _bits),
    Metric("microseconds_per_decision", "µs per decision",
           "microseconds of the policy per player and step, all episodes in one batch", "lower", "At what cost",
           _microseconds, is_timing=True),
):
    register(_metric)
# fmt: on


def measured() -> frozenset[str]:
    """The names of the metrics that have a value per episode of their own: no timings, summaries and comparisons."""
    return frozenset(name for name, metric in METRICS.items() if metric.value is not None and not metric.is_timing)
