"""Estimators of :class:`~ptne_env.field.laws.ObserverRelay`: noise and rounding, private means, damping, pushes.

Each has a record of what it remembers. Shapes are those of R players: ``steps`` (the number so far), ``noise`` (σ_i),
``scale`` (the largest own estimate) and ``doubt`` (the recent error of predictions of the own gradient, as a
displacement) are (R, 1); lengths are in natural units. Constants are in :mod:`ptne_env.field.laws.constants`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import UNLIMITED, largest, own_block, own_places
from ptne_env.field.laws.constants import C
from ptne_env.field.laws.contact_relay import Own
from ptne_env.field.laws.contacts import Messages
from ptne_env.shared.arrays import BoolArray, FloatArray, fold, row_maxima

_GOLDEN_RATIO = (5**0.5 - 1) / 2


class Damage(NamedTuple):
    """Why messages do not come to rest, shapes (R, 1)."""

    width: FloatArray  # the smallest change of a message: the step of rounding, where messages are rounded
    level: FloatArray  # σ_i when it last halved
    since: FloatArray  # steps since then
    noisy: FloatArray  # whether messages carry noise


def damage(
    messages: Messages, was: Damage, noise: FloatArray, steps: FloatArray, scale: FloatArray
) -> tuple[Damage, BoolArray, BoolArray]:
    """What is remembered, whether messages carry noise, and whether they are rounded: all multiples of one step."""
    live = messages.live
    moved = messages.lasted[:, :, None] & (messages.change > C.moved * scale[:, :, None])
    smallest = np.where(moved, messages.change, UNLIMITED).min(axis=(1, 2))[:, None]
    width = np.minimum(was.width, smallest)
    ticks = messages.content / width[:, :, None]
    off = row_maxima(np.where(live[:, :, None], np.abs(ticks - np.round(ticks)), 0.0)).max(axis=1, keepdims=True)

    is_late, halved = steps >= C.start, (noise < was.level / 2) | (steps < 2)
    level, since = np.where(halved, noise, was.level), np.where(halved, 0.0, was.since + 1)
    is_noisy = is_late & (noise > C.noisy * scale) & (since >= C.calm)
    is_noisy |= (was.noisy > 0) & (noise > C.still_noisy * C.noisy * scale)
    is_seen = (width > C.coarse * scale) & (width < UNLIMITED / 10) & live.any(axis=1, keepdims=True)
    is_rounded = is_late & ~is_noisy & is_seen & (off < C.on_grid)
    return Damage(width, level, since, is_noisy.astype(np.float64)), is_noisy, is_rounded


class Samples(NamedTuple):
    """What a player knows of its neighbours' messages, shapes (R, D, n); all 0 at the start."""

    mean: FloatArray  # private mean
    smooth: FloatArray  # mean of means, for rounded messages
    quick: FloatArray  # mean of the last messages
    number: FloatArray  # of messages that the mean counts for
    variance: FloatArray  # of the messages
    present: FloatArray  # variance of the last messages
    lies: FloatArray  # steps in which statements about the own strategy were far off, less the others, shape (R, D)


def sampled(
    messages: Messages, was: Samples, estimate: FloatArray, is_own: BoolArray, is_rounded: BoolArray
) -> tuple[Samples, FloatArray]:
    """Private means of messages that never come to rest, and the means to believe, shape (R, D, n).

    Averages that are stated would be averaged again by their receivers, and arrive late and correlated. So the
    estimates carry raw copies, every player averages in its own memory, and means are stated near the end alone.

    The weight of the k-th sample is p/(p + k). Where a quick mean leaves the mean, the mean lags and becomes the quick
    mean. Rounded messages of a dithered strategy are averaged twice, so that the weights vanish at both ends: the
    dither is no noise, and its mean over a smooth window is closer to 0.
    """
    live, lasted, content = messages.live[:, :, None], messages.was_live[:, :, None], messages.content
    rounded = is_rounded[:, :, None]
    old = np.where(lasted, was.number, np.minimum(was.number, C.reconnected))
    forgetting = np.where(rounded, C.forgetting_rounded, C.forgetting_noisy)
    mean = np.where(live, was.mean + forgetting / (forgetting + old) * (content - was.mean), was.mean)
    number = np.where(live, old + 1, old)

    change = messages.change**2 / 2
    weight, heard = 1 / (1 + old), live & lasted
    variance = was.variance + np.where(heard, np.maximum(C.recent, weight), 0.0) * (change - was.variance)
    present = was.present + np.where(heard, np.maximum(C.present, weight), 0.0) * (change - was.present)
    quick = was.quick + C.quick * (content - was.quick)
    quick = np.where(live, np.where(old < 1 / C.quick, mean, quick), was.quick)
    limit = C.lag**2 * C.quick / (2 - C.quick) * np.minimum(variance, C.present_limit * present)
    lags = ((quick - mean) ** 2 > limit) & live & (number > 2 / C.quick) & ~rounded
    mean, number = np.where(lags, quick, mean), np.where(lags, 1 / C.quick, number)
    smooth = was.smooth + C.forgetting_smooth / (C.forgetting_smooth + old) * (mean - was.smooth)
    smooth = np.where(live, np.where((old == 0) | lags, mean, smooth), was.smooth)
    shown = np.where(rounded, smooth, mean)

    gap = np.where(is_own[:, None] & (number > C.lying_samples), np.abs(shown - estimate[:, None]), 0.0)
    is_off = (gap > C.lying_deviations * np.sqrt(variance + C.smallest_variance)).any(axis=2)
    lies = np.where(is_off, np.minimum(was.lies + 1, C.lying_limit), np.maximum(was.lies - 1, 0.0))
    return Samples(mean, smooth, quick, number, variance, present, lies), shown


def belief(weights: FloatArray, samples: Samples, means: FloatArray, otherwise: FloatArray) -> FloatArray:
    """Σ_j w_j m_j / Σ_j w_j with w_j = weights × number/variance, and ``otherwise`` (R, n) where that is 0/0.

    Weights and means m_j have the shape (R, D, n).
    """
    weights = weights * samples.number / np.maximum(samples.variance, C.smallest_variance)
    total = fold(np.add, weights, axis=1)
    mean = fold(np.add, weights * means, axis=1) / np.where(total > 0, total, 1.0)
    return np.where(total > 0, mean, otherwise)


def without_liars(sources: BoolArray, others: BoolArray, owners: BoolArray, lies: FloatArray) -> BoolArray:
    """Sources of which none lies, as far as there are any; else live neighbours that do not lie; else all sources.

    Shapes are (R, D, n), ``others`` being all live neighbours and ``owners`` those that own c, who do not lie about
    themselves; ``lies`` are those of :class:`Samples`.
    """
    suspect = (lies >= C.lying_steps)[:, :, None] & ~owners
    if not suspect.any():
        return sources
    clean, other = sources & ~suspect, others & ~suspect
    has_source, has_clean, has_other = (fold(np.logical_or, part, axis=1)[:, None] for part in (sources, clean, other))
    return np.where(has_clean, clean, np.where(has_source & has_other, other, sources))


def mature(number: FloatArray, sources: BoolArray, is_own: BoolArray, lies: FloatArray) -> BoolArray:
    """Whether a mean of a neighbour that is no source counts: it is old, and so are all sources' means, (R, D, n).

    No neighbour counts that seems to lie. ``number`` and ``lies`` are those of :class:`Samples`.
    """
    is_old = number > C.old
    has_young = fold(np.logical_or, sources & ~is_old, axis=1)[:, None]
    return np.asarray(is_old & ~has_young & ~is_own[:, None] & (lies == 0)[:, :, None])


def dither(steps: FloatArray) -> FloatArray:
    """Evenly spread numbers in [−½, ½), shape (R, 1): the fractional part of steps × golden ratio, minus ½.

    A strategy that moves by ``dither`` × the step of rounding is rounded up in the share of steps by which it lies
    above the multiple below, so the mean of its rounded messages is the strategy.
    """
    return (steps * _GOLDEN_RATIO) % 1.0 - 0.5


class Damping(NamedTuple):
    """Whether responses of all players at once settle, shapes (R, 1)."""

    factor: FloatArray  # of the best response, in (0, 1]
    before: FloatArray  # the largest response of the window before
    now: FloatArray  # the largest response of this window so far


class Tempered(NamedTuple):
    """How R players respond in a step."""

    factor: FloatArray  # of the best response, in (0, 1], shape (R, 1)
    expected: FloatArray  # change of the own gradient, shape (R, m)
    is_loose: BoolArray  # whether the own rows of dF are not diagonally dominant, shape (R, 1)

    def response(self, own: Own, drift: FloatArray) -> FloatArray:
        """The damped best response to the own estimates after a displacement ``drift`` (R, n) of the others, (R, m)."""
        return self.factor * own._replace(gradient=own.gradient + self.expected).response(drift)


def tempered(own: Own, was: Damping, last_gradient: FloatArray, steps: FloatArray, dimension: int) -> Tempered:
    """Damping where own rows of dF are loose; ``last_gradient`` (R, m) is the own one of the step before."""
    _, outputs, regressors = own.model.rows.shape
    if regressors != dimension:  # own blocks alone are known
        return Tempered(np.ones_like(own.radius), np.zeros_like(own.gradient), np.zeros_like(own.is_probe))
    size = np.abs(own.model.rows)
    is_padding = own.blocks == dimension
    block = np.abs(own_block(own.model.rows, own_places(own.blocks, own.model, dimension)))
    inside = np.where(is_padding[:, None, :], 0.0, block).sum(axis=2)
    beside = np.where(is_padding, 0.0, size.sum(axis=2) - inside).max(axis=1, keepdims=True)
    curvature = np.where(is_padding, np.inf, block.diagonal(axis1=1, axis2=2)).min(axis=1, keepdims=True)
    is_loose = (beside > curvature) & (steps > outputs + 1)
    factor = np.where(is_loose, was.factor, 1.0)
    is_optimistic = is_loose & (factor < C.optimistic)
    return Tempered(factor, np.where(is_optimistic, own.gradient - last_gradient, 0.0), is_loose)


def damped(
    was: Damping,
    is_loose: BoolArray,
    response: FloatArray,
    steps: FloatArray,
    noise: FloatArray,
    scale: FloatArray,
    doubt: FloatArray,
) -> Damping:
    """The damping after a ``response`` (R, n).

    It falls by a fifth where own rows are loose and the largest response of ten steps is not smaller than 0.8 times
    that of the ten steps before, unless noise or a gradient that changes by itself explains it. It rises again where
    that response is smaller than half of the one before.
    """
    size = np.maximum(was.now, largest(response))
    ends = (steps % C.window == 0) & (steps > 0)
    least = np.maximum(C.audible_noise * noise, C.audible * scale)
    is_audible = size > np.maximum(least, C.audible_errors * doubt)
    is_stuck = ends & is_loose & (steps > 2 * C.window) & is_audible & (size > C.shrinks * was.before)
    recovers = ends & (size < C.recovered * was.before)
    factor = np.where(is_stuck, C.damps, np.where(recovers, 1 / C.damps, 1.0)) * was.factor
    factor = np.clip(factor, C.least_damping, 1.0)
    return Damping(factor, np.where(ends, size, was.before), np.where(ends, 0.0, size))


class Push(NamedTuple):
    """What moves the own strategy beside the own inputs; all 0 at the start."""

    velocity: FloatArray  # shape (R, n)
    steps: FloatArray  # since it last changed, shape (R, 1)


def observed_push(was: Push, residual: FloatArray, last_dt: FloatArray, scale: FloatArray) -> Push:
    """The velocity of the push: the mean of ``residual``/Δt over the steps since the push last changed.

    Args:
        was: the push so far.
        residual: the last displacement of own components beside the displacement that was asked for, 0 for the others
            and for components that a bound holds, shape (R, n).
        last_dt: Δt of the last step, shape (R, 1).
        scale: the largest own estimate, shape (R, 1).
    """
    resolution = C.push_seen * scale
    velocity = residual / np.where(last_dt > 0, last_dt, np.inf)
    changes = largest(velocity - was.velocity) * last_dt > 2 * resolution
    steps = np.where(changes, 1.0, was.steps + 1)
    is_pushed = (np.abs(residual) > resolution) | (was.velocity != 0)
    mean = was.velocity + (velocity - was.velocity) / np.minimum(steps, C.push_steps)
    return Push(np.where(is_pushed, mean, 0.0), steps)
