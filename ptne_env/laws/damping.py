"""Damping of responses: whether best responses of all players at once settle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.laws.best_response import largest, own_block, own_places
from ptne_env.laws.contact_relay import Own
from ptne_env.shared.arrays import BoolArray, FloatArray

_WINDOW = 10
"""Steps in which the largest response must shrink."""

_SHRINKS, _SETTLES = 0.8, 0.5
"""Shares of the largest response of the window before: above the first responses do not shrink, below the second they
settle."""

_FACTOR, _LEAST = 0.8, 0.3
"""Factor of a response that does not shrink, and the smallest: a player that hardly moves is of no use to others."""

_RECENT, _ASTRAY = 0.95, 0.35
"""Share of a sum of responses that is left after a step; and share of their length below which they lead nowhere."""

_NOISE, _ERRORS, _SHARE = 2.0, 100.0, 1e-6
"""A response counts above so many deviations of noise, recent errors of predictions, and this share of estimates."""


class Damping(NamedTuple):
    """What R players remember of their responses, shapes (R, 1)."""

    factor: FloatArray  # of the best response, in (0, 1]
    before: FloatArray  # the largest response of the window before
    now: FloatArray  # the largest response of this window so far
    way: FloatArray  # recent responses, added up, shape (R, n)
    length: FloatArray  # the sum of their sizes
    change: FloatArray  # the last change of the own gradient, shape (R, m)


def is_loose(own: Own, steps: FloatArray, dimension: int) -> BoolArray:
    """Whether the own rows of dF are identified and not diagonally dominant, shape (R, 1)."""
    _, outputs, regressors = own.model.rows.shape
    if regressors != dimension:  # own blocks alone are known
        return np.zeros(own.radius.shape, dtype=np.bool_)
    is_padding = own.blocks == dimension
    block = np.abs(own_block(own.model.rows, own_places(own.blocks, own.model, dimension)))
    inside = np.where(is_padding[:, None, :], 0.0, block).sum(axis=2)
    others = np.where(is_padding, 0.0, np.abs(own.model.rows).sum(axis=2) - inside).max(axis=1, keepdims=True)
    curvature = np.where(is_padding, np.inf, block.diagonal(axis1=1, axis2=2)).min(axis=1, keepdims=True)
    return np.asarray((others > curvature) & (steps > outputs + 1))


def tempered(own: Own, was: Damping, last_gradient: FloatArray, drift: FloatArray) -> FloatArray:
    """The best response times the factor; where it is below 1, to the gradient that is expected after this step.

    The gradient changes in the coming step as it did in the last one, from ``last_gradient`` (R, m), and in the one
    before, as far as both agree: so players who chase each other come to rest, and noise is not amplified. ``drift``
    (R, n) is the coming displacement of the others; the result (R, m).
    """
    factor, last_change = was.factor, was.change
    change = own.gradient - last_gradient
    steady = np.where(change * last_change > 0, np.sign(change) * np.minimum(np.abs(change), np.abs(last_change)), 0.0)
    return factor * own._replace(gradient=own.gradient + np.where(factor < 1, steady, 0.0)).response(drift)


def damped(
    was: Damping,
    loose: BoolArray,
    response: FloatArray,
    change: FloatArray,
    steps: FloatArray,
    noise: FloatArray,
    doubt: FloatArray,
    scale: FloatArray,
) -> Damping:
    """The damping after a ``response`` (R, n); the other arrays are (R, 1).

    The factor falls where own rows are loose and the largest response of ten steps is hardly smaller than that of the
    ten steps before, unless ``noise`` or ``doubt``, the recent error of predictions of the own gradient, explains it.
    """
    size = np.maximum(was.now, largest(response))
    ends = (steps % _WINDOW == 0) & (steps > 0)
    counts = size > np.maximum(np.maximum(_NOISE * noise, _ERRORS * doubt), _SHARE * scale)
    sticks = ends & loose & (steps > 2 * _WINDOW) & counts & (size > _SHRINKS * was.before)
    way, length = _RECENT * was.way + response, _RECENT * was.length + largest(response)
    leads = largest(way) >= _ASTRAY * length
    sticks &= ~leads
    settles = ends & (leads | (size < _SETTLES * was.before))
    factor = np.where(sticks, _FACTOR, np.where(settles, 1 / _FACTOR, 1.0)) * was.factor
    factor = np.clip(np.where(loose, factor, 1.0), _LEAST, 1.0)
    return Damping(factor, np.where(ends, size, was.before), np.where(ends, 0.0, size), way, length, change)
