"""What is measured of a rollout, one number per episode."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.experiments.rollout import Rollout

FINE_DISTANCE = 1e-6
"""A run has settled finely within this relative distance."""

METRICS: Mapping[str, str] = {
    "digits": "−log10 of the estimate distance at the deadline, at most 12",
    "strategy_distance": "‖x − x*‖/‖x*‖ at the deadline (the paper's plots)",
    "estimate_distance": "‖𝐱 − 1⊗x*‖/(√N ‖x*‖) at the deadline (what the theorems claim)",
    "consensus_error": "‖𝐱 − 1⊗x̄‖/(√N ‖x*‖) at the deadline",
    "settling_time": "first instant after which the strategy distance stays within 0.5 %, in seconds",
    "settled_share": "share of episodes that settled by the end",
    "settling_time_1e_6": "first instant after which the strategy distance stays within 1e-6, in seconds",
    "settled_share_1e_6": "share of episodes that settled to 1e-6 by the end",
    "digits_after_hold": "−log10 of the estimate distance after the hold phase, at most 12",
    "digits_gained": "mean over players of the summed digits reward, to the end of the episode",
    "input_energy": "Σ Δt ‖u‖² to the deadline",
    "velocity_energy": "Σ Θ² ‖u‖²/Δt to the deadline",
    "peak_input": "largest |u| to the deadline",
    "peak_velocity": "largest Θ|u|/Δt to the deadline, per second",
    "saturated_share": "share of input components at the input limit",
    "diverged_share": "share of episodes that left the range",
    "microseconds_per_decision": "microseconds of the policy per player and step, all episodes in one batch",
}
"""Every metric's name and meaning, in the order of tables."""

COMPARATIVE_METRICS: Mapping[str, str] = {
    "worst_decile_digits": "mean digits of the worst tenth of the episodes",
    "digits_over_paper_laws": "digits beyond the best of the paper's laws, paired by episode",
    "probability_of_beating_paper_laws": "share of episodes with more digits than that law; a tie counts half",
    "digits_over_all_laws": "digits beyond the best of all laws, paired by episode",
    "probability_of_beating_all_laws": "share of episodes with more digits than that law; a tie counts half",
}
"""What is recorded besides :data:`METRICS`: the worst decile of everybody, the rest of learned policies only."""

SUITE_METRICS: Mapping[str, str] = {
    **METRICS,
    "regret": "Nikaido–Isoda regret Σ_i [J_i(x) − min over y of J_i(y, x_{-i})] at the deadline",
    "log_error_area": "mean of log10 of the estimate distance over [0, T]",
    "messages": "estimates sent over live links until the deadline",
    "bits": "in these messages",
}
"""What suites measure of every episode."""


def measure_for_suite(rollout: Rollout) -> dict[str, FloatArray]:
    """:data:`SUITE_METRICS` of every episode, each of shape (B,); NaN where there is none."""
    return {
        **measure(rollout),
        "regret": rollout.regret,
        "log_error_area": rollout.log_error_area,
        "messages": rollout.messages,
        "bits": rollout.bits,
    }


def measure(rollout: Rollout) -> dict[str, FloatArray]:
    """Every metric of every episode, each of shape (B,); NaN where there is none (a run that never settled)."""
    deadline, batch = rollout.deadline_step, rollout.diverged.shape
    has_hold = len(rollout.times) > deadline + 1
    settling = settling_time(rollout.times, rollout.strategy_distance)
    fine = settling_time(rollout.times, rollout.strategy_distance, FINE_DISTANCE)
    return {
        "digits": distances.digits(rollout.estimate_distance[deadline]),
        "strategy_distance": rollout.strategy_distance[deadline],
        "estimate_distance": rollout.estimate_distance[deadline],
        "consensus_error": rollout.consensus_error,
        "settling_time": settling,
        "settled_share": np.isfinite(settling).astype(np.float64),
        "settling_time_1e_6": fine,
        "settled_share_1e_6": np.isfinite(fine).astype(np.float64),
        "digits_after_hold": distances.digits(rollout.estimate_distance[-1]) if has_hold else np.full(batch, np.nan),
        "digits_gained": rollout.digits_gained,
        "input_energy": rollout.input_energy,
        "velocity_energy": rollout.velocity_energy,
        "peak_input": rollout.peak_input,
        "peak_velocity": rollout.peak_velocity,
        "saturated_share": rollout.saturated_share,
        "diverged_share": rollout.diverged.astype(np.float64),
        "microseconds_per_decision": np.full(batch, 1e6 * rollout.seconds_per_decision),
    }


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
