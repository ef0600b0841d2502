"""Private means of messages that never come to rest: each player relays raw copies, and averages in its own memory.

Averages that are stated would be averaged again by their receivers, and arrive late and correlated. So the estimates
carry raw copies, and the mean is stated in the last step alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import UNLIMITED, largest
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, fold, row_maxima

START = 20
"""Steps after which noise and rounding are judged; before, estimates still move by more."""

_NOISY = 3e-6
"""A smallest change of messages above this share of the largest own estimate may be noise."""

_CALM = 10.0
"""It is noise where it has not halved for this many steps."""

_STILL_NOISY = 0.1
"""Noise stays noise down to this multiple of the smallest level: the smallest of many changes keeps falling."""

_MOVED = 1e-5
"""A change of a message below this share of the largest own estimate is no step of rounding."""

_COARSE = 1e-4
"""A step of rounding below this share of the largest own estimate does not matter."""

_ON_GRID = 1e-2
"""Largest distance of a rounded message from a multiple of the step, in steps."""

_FORGETTING = (2.0, 3.0, 2.0)
"""p of the weights p/(p + k) of the k-th sample: of the mean of noisy and of rounded messages, and of its mean."""

_RECONNECTED = 6.0
"""Samples that the mean counts for at most when a link comes up again."""

_RECENT = (0.03, 0.1, 1.5)
"""Weights of the present change in the variance of messages, and in the present variance, of which a multiple limits it
where the mean is judged: while estimates move, their moves count as variance."""

_QUICK = 1 / 12
"""Weight of the present message in the quick mean, by which a mean that lags is noticed."""

_LAG = 4.0
"""Standard deviations of the quick mean by which it may leave the mean."""

_SMALLEST_VARIANCE = 1e-14

_OLD = 40.0
"""Samples after which a mean is old."""

_LYING = (20.0, 8.0, 10.0, 30.0)
"""Samples of statements about the own strategy before they are judged, the standard deviations by which they are off,
the number of such steps that makes a liar, and the largest number that counts."""

_GOLDEN_RATIO = (5**0.5 - 1) / 2


def average_parts(layout: ObservationLayout) -> dict[str, tuple[int, ...]]:
    """Shapes of the parts of the memory of this module; at the start ``width`` and ``level`` are 1e6, others 0."""
    parts = dict.fromkeys(
        ("mean", "smooth", "quick", "samples", "variance", "present"), (layout.slots, layout.dimension)
    )
    return {**dict.fromkeys(("width", "level", "since", "noisy"), (1,)), "lies": (layout.slots,), **parts}


class Unrest(NamedTuple):
    """Why messages do not come to rest, shapes (R, 1).

    Attributes:
        width: the smallest change of a message, the step of rounding where messages are rounded; natural units.
        level: σ_i when it last halved; natural units.
        since: steps since then.
        is_noisy: whether messages carry noise.
        is_rounded: whether all messages of this step are multiples of ``width``.
    """

    width: FloatArray
    level: FloatArray
    since: FloatArray
    is_noisy: BoolArray
    is_rounded: BoolArray


def unrest(observation: Observation, memory: Mapping[str, FloatArray], noise: FloatArray) -> Unrest:
    """Whether messages carry noise, or are rounded.

    Args:
        observation: of R players.
        memory: ``width``, ``level``, ``since``, ``noisy``, the number of ``steps``, shapes (R, 1); of the step before
            whether links were ``live``, shape (R, D), and the ``messages``, shape (R, D, n).
        noise: σ_i of :func:`~ptne_env.field.laws.contacts.noise_level`, shape (R, 1).
    """
    live = observation.weights > 0
    scale = largest(observation.own_estimate)
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    change = np.abs(messages - memory["messages"])
    moved = (live & (memory["live"] > 0))[:, :, None] & (change > _MOVED * scale[:, :, None])
    smallest = np.where(moved, change, UNLIMITED).min(axis=(1, 2))[:, None]
    width = np.minimum(memory["width"], smallest)
    steps = messages / width[:, :, None]
    off = row_maxima(np.where(live[:, :, None], np.abs(steps - np.round(steps)), 0.0)).max(axis=1, keepdims=True)

    is_late, halved = memory["steps"] >= START, (noise < memory["level"] / 2) | (memory["steps"] < 2)
    level, since = np.where(halved, noise, memory["level"]), np.where(halved, 0.0, memory["since"] + 1)
    is_noisy = is_late & (noise > _NOISY * scale) & (since >= _CALM)
    is_noisy |= (memory["noisy"] > 0) & (noise > _STILL_NOISY * _NOISY * scale)
    is_seen = (width > _COARSE * scale) & (width < UNLIMITED / 10) & live.any(axis=1, keepdims=True)
    return Unrest(width, level, since, is_noisy, is_late & ~is_noisy & is_seen & (off < _ON_GRID))


class Averages(NamedTuple):
    """Private means of the messages of each neighbour, in natural units, shapes (R, D, n).

    Attributes:
        mean: of the messages about c.
        samples: the number that it counts for.
        variance: of the messages.
    """

    mean: FloatArray
    samples: FloatArray
    variance: FloatArray

    def belief(self, weights: FloatArray, otherwise: FloatArray) -> FloatArray:
        """Σ_j w_j m_j / Σ_j w_j with w_j = weights × samples/variance, and ``otherwise`` (R, n) where that is 0/0.

        Args:
            weights: ≥ 0, shape (R, D, n).
            otherwise: values without a mean.
        """
        weights = weights * self.samples / np.maximum(self.variance, _SMALLEST_VARIANCE)
        total = fold(np.add, weights, axis=1)
        mean = fold(np.add, weights * self.mean, axis=1) / np.where(total > 0, total, 1.0)
        return np.where(total > 0, mean, otherwise)


def averages(
    observation: Observation, memory: Mapping[str, FloatArray], is_rounded: BoolArray
) -> tuple[Averages, dict[str, FloatArray]]:
    """The means with the present messages, and the changed parts of the memory.

    The weight of the k-th sample is p/(p + k), so that early samples, which were taken while estimates still moved,
    fade. Where a quick mean over 12 messages leaves the mean, the mean lags and becomes the quick mean. Rounded
    messages of a dithered strategy are averaged twice, so that the weights vanish at both ends: the dither is no
    noise, and its mean over a smooth window is closer to 0.

    Args:
        observation: of R players.
        memory: the parts of :func:`average_parts`; of the step before whether links were ``live``, shape (R, D), and
            the ``messages``, shape (R, D, n).
        is_rounded: whether messages are rounded, shape (R, 1).
    """
    live, lasted = (observation.weights > 0)[:, :, None], (memory["live"] > 0)[:, :, None]
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    old = np.where(lasted, memory["samples"], np.minimum(memory["samples"], _RECONNECTED))
    noisy, rounded, smooth = _FORGETTING
    forgetting = np.where(is_rounded, rounded, noisy)[:, :, None]
    mean = np.where(
        live, memory["mean"] + forgetting / (forgetting + old) * (messages - memory["mean"]), memory["mean"]
    )
    samples = np.where(live, old + 1, old)

    change = (messages - memory["messages"]) ** 2 / 2
    weight, heard = 1 / (1 + old), live & lasted
    variance = memory["variance"] + np.where(heard, np.maximum(_RECENT[0], weight), 0.0) * (change - memory["variance"])
    present = memory["present"] + np.where(heard, np.maximum(_RECENT[1], weight), 0.0) * (change - memory["present"])
    quick = memory["quick"] + _QUICK * (messages - memory["quick"])
    quick = np.where(live, np.where(old < 1 / _QUICK, mean, quick), memory["quick"])
    lag = (quick - mean) ** 2 > _LAG**2 * _QUICK / (2 - _QUICK) * np.minimum(variance, _RECENT[2] * present)
    lag &= live & (samples > 2 / _QUICK) & ~is_rounded[:, :, None]
    mean, samples = np.where(lag, quick, mean), np.where(lag, 1 / _QUICK, samples)
    smoother = memory["smooth"] + smooth / (smooth + old) * (mean - memory["smooth"])
    smoother = np.where(live, np.where((old == 0) | lag, mean, smoother), memory["smooth"])
    shown = np.where(is_rounded[:, :, None], smoother, mean)
    return Averages(shown, samples, variance), {
        "mean": mean,
        "smooth": smoother,
        "quick": quick,
        "samples": samples,
        "variance": variance,
        "present": present,
    }


def lies(means: Averages, memory: Mapping[str, FloatArray], estimate: FloatArray, is_own: BoolArray) -> FloatArray:
    """Steps in which a neighbour's mean statement about the own strategy was far off, less steps in which it was not.

    Args:
        means: of the messages.
        memory: this number as ``lies``, shape (R, D).
        estimate: own estimates, shape (R, n).
        is_own: own components, shape (R, n).
    """
    samples, deviations, _, largest_number = _LYING
    is_judged = is_own[:, None] & (means.samples > samples)
    gap = np.where(is_judged, np.abs(means.mean - estimate[:, None]), 0.0)
    is_off = (gap > deviations * np.sqrt(means.variance + _SMALLEST_VARIANCE)).any(axis=2)
    return np.where(is_off, np.minimum(memory["lies"] + 1, largest_number), np.maximum(memory["lies"] - 1, 0.0))


def without_liars(sources: BoolArray, others: BoolArray, owners: BoolArray, lied: FloatArray) -> BoolArray:
    """Sources of which none lies, as far as there are any; else live neighbours that do not lie; else all sources.

    Args:
        sources: live neighbours with fresher copies, shape (R, D, n).
        others: live neighbours, without own components, shape (R, D, n).
        owners: whether j owns c: owners do not lie about themselves, shape (R, D, n).
        lied: the number of :func:`lies`, shape (R, D).
    """
    suspect = (lied >= _LYING[2])[:, :, None] & ~owners
    if not suspect.any():
        return sources
    clean, other = sources & ~suspect, others & ~suspect
    has_source, has_clean, has_other = (fold(np.logical_or, part, axis=1)[:, None] for part in (sources, clean, other))
    return np.where(has_clean, clean, np.where(has_source & has_other, other, sources))


def mature(means: Averages, sources: BoolArray, is_own: BoolArray, lied: FloatArray) -> BoolArray:
    """Whether a mean of a neighbour that is no source counts: it is old, and so are all sources' means, (R, D, n).

    Args:
        means: of the messages.
        sources: live neighbours with fresher copies, shape (R, D, n).
        is_own: own components, shape (R, n).
        lied: the number of :func:`lies`, shape (R, D): no neighbour counts that seems to lie.
    """
    is_old = means.samples > _OLD
    has_young = fold(np.logical_or, sources & ~is_old, axis=1)[:, None]
    return np.asarray(is_old & ~has_young & ~is_own[:, None] & (lied == 0)[:, :, None])


def dither(step: FloatArray) -> FloatArray:
    """Evenly spread numbers in [−½, ½), shape (R, 1): the fractional part of step × golden ratio, minus ½.

    A strategy that moves by ``dither`` × the step of rounding is rounded up in the share of steps by which it lies
    above the multiple below, so the mean of its rounded messages is the strategy.

    Args:
        step: number of the step, shape (R, 1).
    """
    return (step * _GOLDEN_RATIO) % 1.0 - 0.5
