"""How sure? Means with percentile bootstrap intervals over episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ptne_env.arrays import FloatArray

CONFIDENCE = 0.95
RESAMPLES = 2000
_BATCH = 100
"""Resamples held in memory at a time."""


@dataclass(frozen=True)
class Summary:
    """A mean with the ends of its 95 % interval; all ``None`` when no episode has a value."""

    mean: float | None
    low: float | None
    high: float | None


def summarise(samples: FloatArray, *, seed: int = 0) -> list[Summary]:
    """Summaries of several metrics over the same episodes.

    The interval is the percentile bootstrap of the mean over the episodes that have a value (``scipy.stats.bootstrap``,
    vectorised over metrics). A constant sample has low = high = mean.

    Args:
        samples: shape (metrics, episodes); NaN where an episode has no value.
        seed: of the resampling.
    """
    complete = np.isfinite(samples).all(axis=1)
    varying = complete & (np.ptp(samples, axis=1) > 0)
    intervals = dict(zip(np.flatnonzero(varying).tolist(), _bootstrap(samples[varying], seed), strict=True))
    summaries = []
    for index, row in enumerate(samples):
        if index in intervals:
            summaries.append(intervals[index])
            continue
        values = row[np.isfinite(row)]
        if values.size == 0:
            summaries.append(Summary(None, None, None))
        elif np.ptp(values) == 0:
            summaries.append(Summary(*[float(values[0])] * 3))
        else:
            summaries.extend(_bootstrap(values[None], seed))
    return summaries


def worst_decile(samples: FloatArray, *, seed: int = 0) -> Summary:
    """The mean of the worst tenth of the episodes (at least one), with its interval; low values are bad.

    Args:
        samples: one finite value per episode, shape (episodes,).
        seed: of the resampling.
    """
    if np.ptp(samples) == 0:
        return Summary(*[float(samples[0])] * 3)
    return _bootstrap(samples[None], seed, _mean_of_worst_tenth)[0]


def _mean_of_worst_tenth(samples: FloatArray, axis: int) -> FloatArray:
    count = max(1, samples.shape[axis] // 10)
    lowest = np.partition(samples, count - 1, axis=axis)
    return np.take(lowest, np.arange(count), axis=axis).mean(axis=axis)


def _bootstrap(samples: FloatArray, seed: int, statistic: Callable[..., FloatArray] = np.mean) -> list[Summary]:
    if not samples.size:
        return []
    interval = stats.bootstrap(
        (samples,),
        statistic,
        axis=1,
        vectorized=True,
        n_resamples=RESAMPLES,
        batch=_BATCH,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    means = statistic(samples, axis=1)
    return [Summary(*map(float, row)) for row in zip(means, interval.low, interval.high, strict=True)]
