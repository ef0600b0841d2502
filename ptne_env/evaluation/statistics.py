"""Statistics over training seeds, episodes and tracks, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy import special

from ptne_env.shared.arrays import FloatArray

CONFIDENCE = 0.95
"""Probability with which an interval is meant to cover the mean."""

Scores: TypeAlias = Sequence[FloatArray]
"""Numbers of one policy, an array of shape (training seeds, episodes) per track."""


@dataclass(frozen=True)
class Summary:
    """A mean with the ends of its 95 % interval; all ``None`` when no episode has a value."""

    mean: float | None
    low: float | None
    high: float | None


def estimate(scores: Scores) -> Summary:
    """Return the mean over tracks of the means of a policy, with its two-level interval.

    Training seeds are drawn once for all tracks, because the quality of a network affects all of them; the episodes of
    a track are drawn once for all training seeds, because all play the same ones. The variance of the mean is therefore
    the sum of two parts: V_s = var(means of the S training seeds)/S, and V_e = Σ var(means of the E episodes)/E over
    tracks, over the square of their number. The interval is mean ± t_ν √(V_s + V_e) with the degrees of freedom of
    Welch and Satterthwaite, ν = V²/Σ V_p²/ν_p. One training seed has no V_s, and one episode no V_e.

    Args:
        scores: per track, with the same training seeds in all tracks; NaN where an episode of the only track has no
            value.

    Returns:
        The mean and its interval. A constant has low = high = mean; all are ``None`` where no episode has a value.
    """
    finite = [np.where(np.isfinite(track), track, np.nan)[np.isfinite(track).any(axis=1)] for track in scores]
    if not finite or not all(track.size for track in finite):
        return Summary(None, None, None)
    lowest, highest = (float(pick([pick(track) for track in finite])) for pick in (np.nanmin, np.nanmax))
    if lowest == highest:
        return Summary(lowest, lowest, lowest)
    by_seed = np.mean([np.nanmean(track, axis=1) for track in finite], axis=0)
    by_episode = [np.nanmean(track[:, np.isfinite(track).any(axis=0)], axis=0) for track in finite]
    middle = float(np.mean([np.nanmean(track) for track in finite]))
    parts = [_variance_of_mean(by_seed), *(_variance_of_mean(values / len(finite)) for values in by_episode)]
    variance = sum(part for part, _ in parts)
    if variance == 0:
        return Summary(middle, middle, middle)
    freedom = 1 / sum((part / variance) ** 2 / count for part, count in parts if count)  # squares may underflow
    half = float(special.stdtrit(freedom, (1 + CONFIDENCE) / 2) * np.sqrt(variance))
    return Summary(middle, middle - half, middle + half)


def _variance_of_mean(values: FloatArray) -> tuple[float, int]:
    """Return the variance of the mean of independent values, and its degrees of freedom; 0 for one value."""
    count = len(values)
    return (float(values.var(ddof=1)) / count, count - 1) if count > 1 else (0.0, 0)


def tail_values(samples: FloatArray) -> FloatArray:
    """Return values whose mean is the conditional value at risk, the mean of the worst tenth of the episodes.

    The worst tenth has k ≥ 1 of the E episodes. With q the best of these, x becomes q + min(x − q, 0) E/k (Rockafellar
    and Uryasev 2000). The interval of the mean is that of the CVaR, because q moves it in second order only.

    Args:
        samples: shape (training seeds, episodes); low values are bad.

    Returns:
        The same shape; NaN everywhere if a sample is NaN.
    """
    episodes = samples.shape[-1]
    count = max(1, episodes // 10)
    quantile = np.partition(samples, count - 1, axis=-1)[..., count - 1 : count]
    if not np.isfinite(samples).all():
        return np.full_like(samples, np.nan)
    return quantile + np.minimum(samples - quantile, 0) * (episodes / count)


STATISTICS: Mapping[str, Callable[[FloatArray], FloatArray]] = {"mean": lambda samples: samples, "cvar": tail_values}
"""Statistics over episodes by name: functions from samples to values of the same shape whose mean is the statistic."""
