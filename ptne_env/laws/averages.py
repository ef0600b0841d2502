"""Private means of messages that never come to rest: each player relays raw copies, and averages in its own memory.

Averages that are stated would be averaged again by their receivers, and arrive late and correlated. So the estimates
carry raw copies, and the mean is stated in the last step alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray, fold, row_maxima
from ptne_env.laws.best_response import largest
from ptne_env.observation import Observation, ObservationLayout

START = 20
"""Steps after which noise and rounding are judged; before, estimates still move by more."""

_NOISY = 1e-4
"""A smallest change of messages above this share of the largest own estimate is noise."""

_RESOLVED = 1e-5
"""A change of a message below this share of the largest own estimate is no step of rounding."""

_ON_GRID = 1e-2
"""Largest distance of a rounded message from a multiple of the step, in steps."""

_UNSEEN = 1e6
"""A step of rounding before any was seen."""

_ECHO_DECAY = 0.99
_ECHO_STEPS = 2
_NO_ECHO = 0.5
_JUDGED = 40
"""Samples after which the variance of a neighbour that is no source is known well enough to count it."""

_FORGETTING = 1.2
"""p of the weights p/(p + k) of the k-th sample."""

_SMALLEST_VARIANCE = 1e-12

_GOLDEN_RATIO = (5**0.5 - 1) / 2


def average_parts(layout: ObservationLayout) -> dict[str, tuple[int, ...]]:
    """Shapes of the parts of the memory of this module; at the start ``width`` is 1e6, the others 0."""
    shape = (layout.slots, layout.dimension)
    return {"width": (1,), **dict.fromkeys(("mean", "samples", "echo", "moves", "spread"), shape)}


class Unrest(NamedTuple):
    """Why messages do not come to rest, shapes (R, 1).

    Attributes:
        width: the smallest change of a message, the step of rounding where messages are rounded; natural units.
        is_noisy: whether messages carry noise.
        is_rounded: whether all messages of this step are multiples of ``width``.
    """

    width: FloatArray
    is_noisy: BoolArray
    is_rounded: BoolArray


def unrest(observation: Observation, memory: Mapping[str, FloatArray], noise: FloatArray) -> Unrest:
    """Whether messages carry noise, or are rounded.

    Args:
        observation: of R players.
        memory: ``width``, the number of ``steps``, shapes (R, 1); of the step before whether links were ``live``,
            shape (R, D), and the ``messages``, shape (R, D, n).
        noise: σ_i of :func:`~ptne_env.laws.contacts.noise_level`, shape (R, 1).
    """
    live = observation.weights > 0
    scale = largest(observation.own_estimate)
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    change = np.abs(messages - memory["messages"])
    moved = (live & (memory["live"] > 0))[:, :, None] & (change > _RESOLVED * scale[:, :, None])
    smallest = np.where(moved, change, _UNSEEN).min(axis=(1, 2))[:, None]
    width = np.minimum(memory["width"], smallest)
    steps = messages / width[:, :, None]
    off = row_maxima(np.where(live[:, :, None], np.abs(steps - np.round(steps)), 0.0)).max(axis=1, keepdims=True)
    is_late = memory["steps"] >= START
    is_noisy = is_late & (noise > _NOISY * scale)
    is_seen = (width > _NOISY * scale) & (width < _UNSEEN / 10) & live.any(axis=1, keepdims=True)
    return Unrest(width, is_noisy, is_late & ~is_noisy & is_seen & (off < _ON_GRID))


class Averages(NamedTuple):
    """Private means of the messages of each neighbour, in natural units.

    Attributes:
        mean: of the messages about c, shape (R, D, n).
        samples: their number, shape (R, D, n).
        variance: of the messages, up to a factor that is the same for all of a player, shape (R, D, n).
        counts: whether a neighbour's mean says something new: it is a source, or none is known, or its messages are
            no echo of the own estimates; shape (R, D, n).
    """

    mean: FloatArray
    samples: FloatArray
    variance: FloatArray
    counts: BoolArray

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
    observation: Observation, memory: Mapping[str, FloatArray], sources: BoolArray, is_own: BoolArray
) -> tuple[Averages, dict[str, FloatArray]]:
    """The means with the present messages, and the changed parts of the memory.

    The weight of the k-th sample is p/(p + k), so that early samples, which were taken while estimates still moved,
    fade. A message that repeats the own estimates of the step before is an echo: its deviations from the mean have a
    slope above ½ on their deviations from the sources' mean.

    Args:
        observation: of R players.
        memory: the parts of :func:`average_parts`, and ``estimate``, the own estimates of the step before, (R, n).
        sources: from which neighbours each component is copied where they are live, shape (R, D, n).
        is_own: own components, shape (R, n).
    """
    live = (observation.weights > 0)[:, :, None] & ~is_own[:, None]
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    mean, samples = memory["mean"], memory["samples"]
    number = fold(np.add, sources.astype(np.float64), axis=1)
    stated = memory["estimate"] - fold(np.add, np.where(sources, mean, 0.0), axis=1) / np.maximum(number, 1)
    is_judged = samples > _ECHO_STEPS
    stated = np.where(is_judged, stated[:, None], 0.0)
    heard = np.where(is_judged & live, messages - mean, 0.0)
    echo = _ECHO_DECAY * memory["echo"] + stated * heard
    moves = _ECHO_DECAY * memory["moves"] + stated**2
    spread = _ECHO_DECAY * memory["spread"] + heard**2
    mean = np.where(live, mean + _FORGETTING / (_FORGETTING + samples) * (messages - mean), mean)
    samples = np.where(live, samples + 1, samples)
    is_fresh = (echo < _NO_ECHO * moves) & (samples > _JUDGED)
    counts = sources | is_fresh
    return Averages(mean, samples, spread, counts & ~is_own[:, None]), {
        "mean": mean,
        "samples": samples,
        "echo": echo,
        "moves": moves,
        "spread": spread,
    }


def dither(step: FloatArray) -> FloatArray:
    """Evenly spread numbers in [−½, ½), shape (R, 1): the fractional part of step × golden ratio, minus ½.

    A strategy that moves by ``dither`` × the step of rounding is rounded up in the share of steps by which it lies
    above the multiple below, so the mean of its rounded messages is the strategy.

    Args:
        step: number of the step, shape (R, 1).
    """
    return (step * _GOLDEN_RATIO) % 1.0 - 0.5
