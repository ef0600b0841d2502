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
    """A mean with the ends of its 95 % interval.

    All are ``None`` where no episode has a value, and the ends where nothing tells how much the mean varies.
    """

    mean: float | None
    low: float | None
    high: float | None

    @property
    def is_above_zero(self) -> bool:
        """Whether the whole interval is above 0, which of a difference says that one policy leads the other."""
        return self.low is not None and self.low > 0


def estimate(scores: Scores, minus: Scores | None = None) -> Summary:
    """Return the mean over tracks of the means of a policy, with its two-level interval.

    Training seeds are drawn once for all tracks, because the quality of a network affects all of them; the episodes of
    a track are drawn once for all training seeds, because all play the same ones. The interval is
    mean ± √(t² V_s + t² max(V_e − V_c, 0)) with the variances and quantiles of docs/protocol.md (Howe 1974).

    Args:
        scores: per track, with the same training seeds in all tracks; NaN where an episode has no value. V_s is that of
            the training seeds that have values on all tracks.
        minus: the scores of another policy in the same episodes: the estimate is then of the mean of the differences,
            in which each policy has its V_s and V_c.

    Returns:
        The mean and its interval. A constant has low = high = mean; one episode has no interval, nor have training
        seeds of which none has values on all tracks; all are ``None`` where no episode has a value.
    """
    policies = [scores] if minus is None else [scores, minus]
    of_seeds: list[list[FloatArray]] = [[] for _ in policies]
    of_episodes: list[FloatArray] = []
    middle = interaction = 0.0
    for arrays in zip(*policies, strict=True):
        valued = np.logical_and.reduce([np.isfinite(array).any(axis=0) for array in arrays])
        if not valued.any():
            return Summary(None, None, None)
        contrast = np.zeros(np.count_nonzero(valued))
        for sign, array, means in zip((1, -1), arrays, of_seeds, strict=False):
            values = np.where(np.isfinite(array), array, np.nan)[:, valued]
            has_values = np.isfinite(values).any(axis=1)
            values = values[has_values]
            shift = float(np.nanmin(values))  # so that a constant keeps its last bit
            values = values - shift
            mean = float(np.nanmean(values))
            by_seed, by_episode = (np.nanmean(values, axis=axis) for axis in (1, 0))
            means.append(np.full(len(array), np.nan))
            means[-1][has_values] = by_seed
            contrast += sign * by_episode
            middle += sign * (shift + mean)
            if min(values.shape) > 1:
                squares = (values - by_seed[:, None] - by_episode + mean) ** 2
                interaction += float(np.nanmean(squares)) / np.prod(np.subtract(values.shape, 1)) / len(scores) ** 2
        of_episodes.append(contrast / len(scores))
    if not of_episodes:
        return Summary(None, None, None)
    middle /= len(scores)
    seed_means = [np.mean(means, axis=0) for means in of_seeds]
    seed_means = [means[np.isfinite(means)] for means in seed_means]
    if min(map(len, of_episodes)) == 1 or not all(map(len, seed_means)):
        return Summary(middle, None, None)
    episode_parts = [_variance_of_mean(contrast) for contrast in of_episodes]
    seed_parts = [_variance_of_mean(means) for means in seed_means]
    by_episodes = max(sum(part for part, _ in episode_parts) - interaction, 0.0)
    by_seeds = sum(part for part, _ in seed_parts)
    half = (_squared_quantile(seed_parts) * by_seeds + _squared_quantile(episode_parts) * by_episodes) ** 0.5
    return Summary(middle, middle - half, middle + half)


def _variance_of_mean(values: FloatArray) -> tuple[float, int]:
    """Return the variance of the mean of independent values, and its degrees of freedom; 0 for one value."""
    count = len(values)
    return (float(values.var(ddof=1)) / count, count - 1) if count > 1 else (0.0, 0)


def _squared_quantile(parts: Sequence[tuple[float, int]]) -> float:
    """Return the square of Student's quantile for a sum of variances with these degrees of freedom; 0 if it is 0.

    The degrees of freedom of the sum are those of Satterthwaite.
    """
    variance = sum(part for part, _ in parts)
    if not variance:
        return 0.0
    freedom = 1 / sum((part / variance) ** 2 / count for part, count in parts if count)  # squares may underflow
    return float(special.stdtrit(freedom, (1 + CONFIDENCE) / 2) ** 2)


def tail_values(samples: FloatArray) -> FloatArray:
    """Return values whose mean is the conditional value at risk, the mean of the worst tenth of the episodes.

    Samples and values are as for :func:`median_values`; low samples are bad.

    The worst tenth has k ≥ 1 of the E episodes. With q the worst of the others, x becomes q + min(x − q, 0) E/k
    (Rockafellar and Uryasev 2000). The interval of the mean is that of the CVaR, because q moves it in second order
    only. As it rests on k episodes, deviations from the mean are stretched by the ratio of Student's quantiles at k and
    E − 1 degrees of freedom.
    """
    episodes = samples.shape[-1]
    if episodes == 1:
        return samples
    if not np.isfinite(samples).all():
        return np.full_like(samples, np.nan)
    count = max(1, episodes // 10)
    quantile = np.partition(samples, count, axis=-1)[..., count : count + 1]
    excess = np.minimum(samples - quantile, 0) * (episodes / count)
    mean = excess.mean(axis=-1, keepdims=True)
    at_tail, at_all = special.stdtrit([count, episodes - 1], (1 + CONFIDENCE) / 2)
    return np.asarray(quantile + mean + (excess - mean) * (at_tail / at_all))


def median_values(samples: FloatArray) -> FloatArray:
    """Return values whose mean is the median over episodes, and whose variance is that of the median.

    The samples, (training seeds, episodes), and the values have the same shape; all values are NaN if a sample is.
    They are the median ± d √E/z, upper for the episodes above it, where z = 1.96 and 2 d is the length of the interval
    of order statistics at the ranks E/2 ± z √E/2 (Woodruff 1952).
    """
    if not np.isfinite(samples).all():
        return np.full_like(samples, np.nan)
    episodes, z = samples.shape[-1], special.ndtri((1 + CONFIDENCE) / 2)
    reach = min(0.5, z / 2 / episodes**0.5)
    low, median, high = np.quantile(samples, [0.5 - reach, 0.5, 0.5 + reach], axis=-1, keepdims=True)
    sides = np.sign(samples - median)
    centred: FloatArray = sides - sides.mean(axis=-1, keepdims=True)
    return median + (high - low) / 2 * episodes**0.5 / z * centred


STATISTICS: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "mean": lambda samples: samples,
    "cvar": tail_values,
    "median": median_values,
}
"""Statistics over episodes by name: functions from samples to values of the same shape whose mean is the statistic."""
