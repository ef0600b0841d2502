"""Metrics: each declared once, with its name, meaning, unit, direction, and how it follows from a rollout.

Tables, CSV files, pages, ``ptne list`` and docs read :data:`METRICS`. :func:`register` adds a metric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ptne_env import distances
from ptne_env.arrays import FloatArray, ordered_sum
from ptne_env.experiments.rollout import Rollout

FINE_DISTANCE = 1e-6
"""The relative distance of fine settling."""

NUMBER_BITS = 32
"""Bits of a number in a message: estimates are sent as float32."""

CVAR_SHARE = 0.1
"""The share of the worst episodes over which the conditional value at risk (CVaR) is the mean."""

Block: TypeAlias = Literal["How close", "At what cost", "Against tuned laws"]
"""The tables in which metrics stand."""


@dataclass(frozen=True)
class Metric:
    """A number per episode, or a statistic of such numbers.

    Attributes:
        name: key of records, CSV and JSON files.
        heading: of a column.
        meaning: in one sentence or phrase.
        value: of a rollout, shape (B,), NaN in an episode without a value; ``None`` where it follows from others.
        unit: empty for a pure number.
        direction: which values are better; ``None`` where neither is.
        block: the table in which it stands.
        source: the metric whose episodes it summarises; its own where left out.
        statistic: over episodes: the mean, or the mean of the worst tenth ("cvar").
        is_timing: whether it is a measured time, which another run does not repeat; such metrics are kept apart.
    """

    name: str
    heading: str
    meaning: str
    value: Callable[[Rollout], FloatArray] | None = None
    unit: str = ""
    direction: Literal["higher", "lower"] | None = None
    block: Block = "How close"
    source: str = ""
    statistic: Literal["mean", "cvar"] = "mean"
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
    """Add a metric to :data:`METRICS`; with several processes, in a module that the workers import too.

    Raises:
        ValueError: when the name is taken.
    """
    if metric.name in METRICS:
        raise ValueError(f"there is a metric {metric.name!r} already: choose another name")
    METRICS[metric.name] = metric
    return metric


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


def _settling(threshold: float) -> Callable[[Rollout], FloatArray]:
    return lambda rollout: settling_time(rollout.world.clock.t, rollout["strategy_distance"], threshold)


def _settled(threshold: float) -> Callable[[Rollout], FloatArray]:
    return lambda rollout: np.isfinite(_settling(threshold)(rollout)).astype(np.float64)


def _at_deadline(series: str) -> Callable[[Rollout], FloatArray]:
    return lambda rollout: rollout[series][rollout.world.clock.steps]


def _total(series: str) -> Callable[[Rollout], FloatArray]:
    return lambda rollout: ordered_sum(rollout[series])


def _largest(series: str) -> Callable[[Rollout], FloatArray]:
    return lambda rollout: rollout[series].max(axis=0)


def _digits_after_hold(rollout: Rollout) -> FloatArray:
    if not rollout.world.clock.hold_steps:
        return np.full(rollout.diverged.shape, np.nan)
    return distances.digits(rollout["estimate_distance"][-1])


def _log_error_area(rollout: Rollout) -> FloatArray:
    clock = rollout.world.clock
    to_deadline = slice(clock.steps + 1)
    log_errors = -distances.digits(rollout["estimate_distance"][to_deadline])
    widths = np.diff(clock.t[to_deadline])[:, None]
    area = ordered_sum(widths * (log_errors[1:] + log_errors[:-1]) / 2)  # the trapezoidal rule
    return area / clock.deadline


for _metric in [
    Metric(
        "digits",
        "digits",
        "−log10 of the estimate distance at the deadline, at most 12",
        lambda rollout: distances.digits(_at_deadline("estimate_distance")(rollout)),
        direction="higher",
    ),
    Metric(
        "digits_cvar",
        "CVaR (10 %)",
        "mean digits of the worst tenth of the episodes (conditional value at risk)",
        direction="higher",
        source="digits",
        statistic="cvar",
    ),
    Metric(
        "strategy_distance",
        "strategy distance",
        "‖x − x*‖/‖x*‖ at the deadline (the paper's plots)",
        _at_deadline("strategy_distance"),
        direction="lower",
    ),
    Metric(
        "estimate_distance",
        "estimate distance",
        "‖𝐱 − 1⊗x*‖/(√N ‖x*‖) at the deadline (what the theorems claim)",
        _at_deadline("estimate_distance"),
        direction="lower",
    ),
    Metric(
        "consensus_error",
        "consensus error",
        "‖𝐱 − 1⊗x̄‖/(√N ‖x*‖) at the deadline",
        lambda rollout: rollout["consensus_error"][0],
        direction="lower",
    ),
    Metric(
        "regret",
        "regret",
        "Nikaido–Isoda regret Σ_i [J_i(x) − min over y of J_i(y, x_{-i})] at the deadline",
        lambda rollout: rollout["regret"][0],
        direction="lower",
    ),
    Metric(
        "settling_time",
        "settling time",
        "first instant after which the strategy distance stays within 0.5 %, in seconds",
        _settling(distances.SUCCESS_DISTANCE),
        unit="s",
        direction="lower",
    ),
    Metric(
        "settled_share",
        "settled share",
        "share of episodes that settled by the end",
        _settled(distances.SUCCESS_DISTANCE),
        direction="higher",
    ),
    Metric(
        "settling_time_1e_6",
        "settling to 1e-6",
        "first instant after which the strategy distance stays within 1e-6, in seconds",
        _settling(FINE_DISTANCE),
        unit="s",
        direction="lower",
    ),
    Metric(
        "settled_share_1e_6",
        "settled to 1e-6",
        "share of episodes that settled to 1e-6 by the end",
        _settled(FINE_DISTANCE),
        direction="higher",
    ),
    Metric(
        "digits_after_hold",
        "digits after hold",
        "−log10 of the estimate distance after the hold phase, at most 12",
        _digits_after_hold,
        direction="higher",
    ),
    Metric(
        "digits_gained",
        "digits gained",
        "mean over players of the summed digits reward, to the end of the episode",
        lambda rollout: rollout["mean_digits"][1] - rollout["mean_digits"][0],
        direction="higher",
    ),
    Metric(
        "log_error_area",
        "mean log10 error",
        "mean of log10 of the estimate distance over [0, T]",
        _log_error_area,
        direction="lower",
    ),
    Metric(
        "input_energy",
        "input energy",
        "Σ Δt ‖u‖² to the deadline",
        _total("input_energy"),
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "velocity_energy",
        "velocity energy",
        "Σ Θ² ‖u‖²/Δt to the deadline",
        _total("velocity_energy"),
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "peak_input",
        "peak |u|",
        "largest |u| to the deadline",
        _largest("peak_input"),
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "peak_velocity",
        "peak velocity",
        "largest Θ|u|/Δt to the deadline, per second",
        _largest("peak_velocity"),
        unit="1/s",
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "saturated_share",
        "saturated share",
        "share of input components at the input limit",
        lambda rollout: _total("saturated")(rollout) / np.maximum(_total("components")(rollout), 1),
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "diverged_share",
        "diverged share",
        "share of episodes that left the range",
        lambda rollout: rollout.diverged.astype(np.float64),
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "messages",
        "messages",
        "estimates sent over live links until the deadline",
        _total("messages"),
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "bits",
        "bits",
        f"bits in these messages, {NUMBER_BITS} per number",
        lambda rollout: _total("messages")(rollout) * rollout.world.game.dimension * NUMBER_BITS,
        direction="lower",
        block="At what cost",
    ),
    Metric(
        "microseconds_per_decision",
        "µs per decision",
        "microseconds of the policy per player and step, all episodes in one batch",
        lambda rollout: np.full(rollout.diverged.shape, 1e6 * rollout.seconds_per_decision),
        direction="lower",
        block="At what cost",
        is_timing=True,
    ),
    *(
        metric
        for group, laws in {"paper": "the paper's laws", "all": "all laws"}.items()
        for metric in (
            Metric(
                f"digits_over_{group}_laws",
                f"digits over the best of {laws}",
                f"digits beyond the best of {laws}, tuned, paired by episode",
                direction="higher",
                block="Against tuned laws",
            ),
            Metric(
                f"probability_of_beating_{group}_laws",
                f"P(beats the best of {laws})",
                f"share of episodes with more digits than the best of {laws}; a tie counts half",
                direction="higher",
                block="Against tuned laws",
            ),
        )
    ),
]:
    register(_metric)


def against_law(group: str, digits: FloatArray, law: FloatArray) -> dict[str, FloatArray]:
    """The metrics of a learned policy against the tuned law of a group, paired by episode.

    Args:
        group: ``"paper"`` or ``"all"``.
        digits: of the policy, shape (training seeds, episodes).
        law: digits of the law, shape (1, episodes).
    """
    difference = digits - law
    return {
        f"digits_over_{group}_laws": difference,
        f"probability_of_beating_{group}_laws": (np.sign(difference) + 1) / 2,
    }
