"""Filters of messages: how noisy they are, whether they are rounded, and what they state beneath the noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.field.laws.contacts import Messages
from ptne_env.field.laws.identification import RESOLUTION
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, row_maxima

LEAP = 8.0
MEDIAN = True
CAP = 1 / 6

RATES = (1 / 4, 1 / 16, 1 / 64, 1 / 256)
"""Smallest weights of the present message in the means: from quick ones to slow ones."""

_FALLS, _RISES = 1 / 8, 1 / 32
"""Weights of the present step in the noise: moves of the start are forgotten sooner than noise is believed."""

_DEVIATIONS = 3.0
"""Half-width of the interval around each mean, in standard deviations: means agree where all intervals meet."""

_NORMAL_MEDIAN = 0.3186
"""Median of |ξ| for ξ ~ N(0, 1)."""

_FINE = 16 * RESOLUTION
"""Noise and steps of rounding below this share of the largest estimate are those of float32."""

_ON_GRID = 1e-2
"""Largest distance of a rounded message from a multiple of the step, in steps."""

_GOLDEN_RATIO = (5**0.5 - 1) / 2


class Filters(NamedTuple):
    """What R players remember of their neighbours' messages."""

    age: FloatArray  # steps in which the link has been live without a break, shape (R, D)
    last: FloatArray  # messages of the last step, shape (R, D, n)
    before: FloatArray  # messages of the step before, shape (R, D, n)
    noise: FloatArray  # standard deviation of the noise of messages, shape (R, 1)
    width: FloatArray  # the smallest change of a message, the step of rounding where they are rounded, shape (R, 1)
    level: FloatArray
    since: FloatArray
    means: FloatArray  # per rate, shape (R, L, D, n)
    variances: FloatArray  # of the means, in that of a message, shape (R, L, D, n)


def no_filters(layout: ObservationLayout) -> Filters:
    """The filters of one player at the start of an episode."""
    links, slots = np.zeros((1, layout.slots)), np.zeros((1, layout.slots, layout.dimension))
    means = np.zeros((1, len(RATES), layout.slots, layout.dimension))
    none = np.zeros((1, 1))
    return Filters(links, slots, slots, none, none + np.inf, none, none, means, means + 1e6)


def measured(
    messages: Messages, was: Filters, steps: FloatArray, owners: BoolArray, scale: FloatArray
) -> tuple[Filters, FloatArray]:
    """The filters with the noise of this step's messages, and the step of rounding, 0 where they are not rounded."""
    live, content = messages.live, messages.content
    age = np.where(live, was.age + 1, 0.0)
    first, second = content - was.last, content - 2 * was.last + was.before
    is_start = steps == 1
    change = np.abs(np.where(is_start[:, :, None], first * np.sqrt(3), second))
    is_new = (first != 0).any(axis=2)
    counts = live & (is_new | is_start) & (age >= np.where(is_start, 2, 3))
    sample = _median(np.where(counts[:, :, None] & ~owners, change, np.inf)) / (_NORMAL_MEDIAN * np.sqrt(6))
    most = np.maximum(LEAP * was.noise, _FINE * scale)
    sample = np.where(is_start | ~np.isfinite(sample), sample, np.minimum(sample, most))
    rate = np.where(is_start, 1.0, np.where(sample < was.noise, _FALLS, _RISES))
    noise = np.where(np.isfinite(sample), was.noise + rate * (np.where(np.isfinite(sample), sample, 0) - was.noise), was.noise)

    level = np.maximum(was.level, noise)
    halved = (noise < level / 2) & (steps > 1)
    level, since = np.where(halved, noise, level), np.where(halved, 0.0, was.since + 1)
    since = np.where(is_start, 100.0, since)
    moved = messages.lasted[:, :, None] & (messages.change > _FINE * scale[:, :, None])
    smallest = np.where(moved, messages.change, np.inf).min(axis=(1, 2))[:, None]
    width = np.minimum(was.width, smallest)
    known = np.where(np.isfinite(width), width, 1.0)[:, :, None]
    off = row_maxima(np.where(live[:, :, None], np.abs(content / known - np.round(content / known)), 0.0)).max(axis=1, keepdims=True)
    is_rounded = np.isfinite(width) & (width > 100 * _FINE * scale) & (off < _ON_GRID) & live.any(axis=1, keepdims=True) & (steps >= 20)
    step = np.where(is_rounded, width, 0.0)
    last, before = (np.where(live[:, :, None], part, 0.0) for part in (content, was.last))
    return was._replace(age=age, last=content, before=was.last, noise=noise, width=width, level=level, since=since), step


def filtered(messages: Messages, was: Filters, before: FloatArray, last: FloatArray, deviation: FloatArray) -> tuple[Filters, FloatArray, FloatArray]:
    """Intersection of confidence intervals: the slowest mean that agrees with all quicker ones, and its variance.

    Both (R, D, n), the variance in that of a message.
    """
    live, content = messages.live[:, :, None], messages.content
    lasted = (was.age >= 3)[:, :, None]
    middle = np.maximum(np.minimum(content, last), np.minimum(np.maximum(content, last), before))
    chosen = np.where(lasted, middle, content)
    variance = np.ones_like(chosen)
    renewed = (was.age == 1)[:, :, None]
    if MEDIAN:
        content = np.clip(content, chosen - 3 * deviation[:, :, None], chosen + 3 * deviation[:, :, None])
    half = _DEVIATIONS * deviation[:, :, None]
    lower, upper = chosen - half, chosen + half
    agrees = np.ones_like(lower, dtype=bool)
    means, variances = was.means.copy(), was.variances.copy()
    for level, least in enumerate(RATES):
        old, spread = means[:, level], variances[:, level]
        spread = np.where(renewed, np.maximum(spread, CAP), spread)
        rate = np.maximum(least, spread / (1 + spread))
        spread = (1 - rate) ** 2 * spread + rate**2
        mean = old + rate * (content - old)
        mean, spread = np.where(live, mean, old), np.where(live, spread, variances[:, level])
        wide = half * np.sqrt(spread)
        lower, upper = np.maximum(lower, mean - wide), np.minimum(upper, mean + wide)
        agrees = agrees & (lower <= upper)
        chosen = np.where(agrees, mean, chosen)
        variance = np.where(agrees, spread, variance)
        restart = live & ~agrees
        means[:, level] = np.where(restart, chosen, mean)
        variances[:, level] = np.where(restart, variance, spread)
    return was._replace(means=means, variances=variances), chosen, variance


def _median(array: FloatArray) -> FloatArray:
    """The lower median of the finite entries of each row, (R, D, n) to (R, 1); infinite where there is none."""
    ordered = np.sort(array.reshape(len(array), -1), axis=1)
    number = np.isfinite(ordered).sum(axis=1, keepdims=True)
    return np.take_along_axis(ordered, np.minimum(number // 4, ordered.shape[1] - 1), axis=1)


def dither(steps: FloatArray) -> FloatArray:
    """Evenly spread numbers in [−½, ½), shape (R, 1): the fractional part of steps × golden ratio, minus ½."""
    return (steps * _GOLDEN_RATIO) % 1.0 - 0.5
