"""Reactions of players to each other: whether best responses settle, and how neighbours will respond.

Responses are damped where best responses of all players at once do not settle.

A neighbour j that plays best responses, and whose estimates rest, sends a point of the plane x_j = r + R x_{−j}. Two
such messages differ by a displacement within the plane, so recursive least squares identifies R. Where links break, a
player then solves its own first-order condition and the planes of its neighbours together, in place of waiting for
answers (overlapping Schwarz iteration over the players).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.laws.building_blocks.messages import NeighbourMessages
from ptne_env.laws.building_blocks.own_gradient import (
    Model,
    OwnSide,
    identify,
    largest,
    own_block,
    own_entries,
    own_places,
    with_own,
)
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, row_maxima

START = 20
"""Steps before planes are solved and errors of predictions are judged: until then, estimates move by more."""


# --- damping ---------------------------------------------------------------------------------------------------------

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


def is_loose(own: OwnSide, steps: FloatArray, dimension: int) -> BoolArray:
    """Return whether the own rows of dF are identified and not diagonally dominant, shape (R, 1)."""
    _, outputs, regressors = own.model.rows.shape
    if regressors != dimension:  # own blocks alone are known
        return np.zeros(own.radius.shape, dtype=np.bool_)
    is_padding = own.blocks == dimension
    block = np.abs(own_block(own.model.rows, own_places(own.blocks, own.model, dimension)))
    inside = np.where(is_padding[:, None, :], 0.0, block).sum(axis=2)
    others = np.where(is_padding, 0.0, np.abs(own.model.rows).sum(axis=2) - inside).max(axis=1, keepdims=True)
    curvature = np.where(is_padding, np.inf, block.diagonal(axis1=1, axis2=2)).min(axis=1, keepdims=True)
    return np.asarray((others > curvature) & (steps > outputs + 1))


def damp_response(own: OwnSide, was: Damping, last_gradient: FloatArray, drift: FloatArray) -> FloatArray:
    """Return the damped best response, (R, m): the best response times the factor.

    Where the factor is below 1, it answers to the gradient that is expected after this step: the gradient changes in
    the coming step as it did in the last one, from ``last_gradient`` (R, m), and in the one before, as far as both
    agree. So players who chase each other come to rest, and noise is not amplified. ``drift`` (R, n) is the coming
    displacement of the others.
    """
    factor, last_change = was.factor, was.change
    change = own.gradient - last_gradient
    steady = np.where(change * last_change > 0, np.sign(change) * np.minimum(np.abs(change), np.abs(last_change)), 0.0)
    return factor * own._replace(gradient=own.gradient + np.where(factor < 1, steady, 0.0)).respond(drift)


def update_damping(
    was: Damping,
    loose: BoolArray,
    response: FloatArray,
    change: FloatArray,
    steps: FloatArray,
    noise: FloatArray,
    doubt: FloatArray,
    scale: FloatArray,
) -> Damping:
    """Return the damping after a ``response`` (R, n); the other arrays have the shape (R, 1).

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


# --- planes ----------------------------------------------------------------------------------------------------------

_WARM_UP = 3
"""Steps in which players move for identification, not in answer to messages."""

_PLANE_SPREAD, _PLANE_COMMON = 0.15, 1000.0
"""Deviation of the entries of R before any sample, and the variance that all entries share, in that of each: players
barely react to each other, and alike to all others."""

_REST_CHANGE, _REST = 1e-2, 1e-7
"""A message is at rest that changed less than the first share of its way since the last sample, or less than the second
share of the largest own estimate."""

_NEW_SAMPLE, _RESOLUTION = 1e-10, 1e-7
"""Shares of the largest own estimate: a shorter displacement is no new sample; the deviation of a sample."""

_SOFT, _FADE = 0.3, 0.3
"""Share of a plane's recent error that counts as deviation of its samples; share of it that is left after a step."""

_PLANE_SAMPLES, _WORST = 3, 0.1
"""A plane counts after so many samples, and with a recent error below this share of the largest own estimate."""

_NEAREST, _TRUSTED, _FARTHEST = 1e-9, 1.0, 0.5
"""A joint solution is followed that is farther than the first share of the largest own estimate and than so many recent
errors, and not farther than the last share. With 1e-7 and 3 errors it has a digit less where messages are exact."""


class Planes(NamedTuple):
    """What R players know of their neighbours' reactions, with the m components of the largest own block."""

    slopes: FloatArray  # R, shape (R, D, m, n)
    covariance: FloatArray  # of the rows of R, shape (R, D, n, n)
    anchor: FloatArray  # the last sample, shape (R, D, n)
    samples: FloatArray  # their number, shape (R, D)
    error: FloatArray  # the recent error of predictions by the plane, shape (R, D)


def initial_planes(layout: ObservationLayout) -> Planes:
    """Return the planes of one player at the start of an episode."""
    slots, n, m = layout.slots, layout.dimension, max(layout.action_dims)
    covariance = np.tile(_PLANE_SPREAD**2 * (np.eye(n) + _PLANE_COMMON * np.ones((n, n))), (1, slots, 1, 1))
    none = np.zeros((1, slots))
    return Planes(np.zeros((1, slots, m, n)), covariance, np.zeros((1, slots, n)), none, none)


def reckon_estimate(seen: FloatArray, reckoned: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the own estimates (R, n) by dead reckoning, or as ``seen`` in float32 where the two disagree."""
    is_off = (steps == 0) | (np.abs(reckoned - seen) > 1e-5 * largest(seen))
    return np.where(is_off, seen, reckoned)


def learn_planes(
    observation: Observation,
    messages: NeighbourMessages,
    was: Planes,
    steps: FloatArray,
    here: FloatArray,
    layout: ObservationLayout,
) -> Planes:
    """Update the planes of the neighbours by this step's messages; ``here`` (R, n) are the own estimates."""
    neighbours, scale, is_warm = np.array(layout.neighbours)[observation.player], largest(here), steps >= _WARM_UP
    content = here[:, None] + observation.relative_estimates
    rest = np.where(messages.was_live, row_maxima(messages.change), np.inf)
    moved = content - was.anchor
    length = row_maxima(np.abs(moved))
    is_first = was.samples == 0
    is_rest = messages.live & is_warm & (rest <= np.maximum(_REST_CHANGE * length, _REST * scale))
    is_sample = is_rest & ~is_first & (length > _NEW_SAMPLE * scale)
    is_kept = is_sample | (is_rest & is_first)

    regressors = np.where(layout.own_mask[neighbours], 0.0, moved)
    theirs = own_entries(moved, layout.own_components[neighbours])
    error = row_maxima(np.abs(theirs - np.einsum("rdmn,rdn->rdm", was.slopes, regressors)))
    is_known = messages.live & is_warm & (was.samples >= _PLANE_SAMPLES)
    fresh = was._replace(
        anchor=np.where(is_kept[:, :, None], content, was.anchor),
        samples=was.samples + is_kept,
        error=np.where(is_known, np.maximum(_FADE * was.error, error), was.error),
    )
    if not is_sample.any():
        return fresh
    resolution = (np.broadcast_to(scale, is_sample.shape)[is_sample] * _RESOLUTION) ** 2
    variance = resolution + (_SOFT * was.error[is_sample]) ** 2
    model = Model(was.slopes[is_sample], was.covariance[is_sample])
    model, _, _ = identify(model, regressors[is_sample], theirs[is_sample], variance[:, None])
    slopes, covariance = was.slopes.copy(), was.covariance.copy()
    slopes[is_sample], covariance[is_sample] = model
    return fresh._replace(slopes=slopes, covariance=covariance)


def solve_jointly(
    player: IntArray,
    known: Planes,
    here: FloatArray,
    planned: FloatArray,
    own: OwnSide,
    doubt: FloatArray,
    layout: ObservationLayout,
) -> tuple[FloatArray, BoolArray]:
    """Solve the own first-order condition and the planes of the neighbours.

    Args:
        player: index of each of R players, shape (R,).
        known: planes of the neighbours.
        here: own estimates, shape (R, n).
        planned: the next estimates without the joint solution, which fixes all components that no plane does, (R, n).
        own: the own side with whole rows: the condition is ∂J_i + G_i Δx = 0.
        doubt: the recent error of predictions of the own gradient, as a displacement, shape (R, 1).
        layout: of the observations.

    Returns:
        The solution, shape (R, n), and whether it counts, shape (R, 1).
    """
    neighbours, scale = np.array(layout.neighbours)[player], largest(here)
    slopes = np.where(layout.own_mask[neighbours][:, :, None], 0.0, known.slopes)  # own components react to others
    error, is_known = known.error, known.samples >= _PLANE_SAMPLES
    is_tame = np.abs(slopes).sum(axis=3).max(axis=2) < 1
    counts = is_known & is_tame & (error < _WORST * scale) & (neighbours != player[:, None])
    blocks = np.where(counts[:, :, None], layout.own_components[neighbours], layout.dimension)
    point = _joint(slopes, known.anchor, blocks, planned, here, own)
    jump = largest(point - planned)
    doubt = np.maximum(np.where(is_known, error, 0.0).max(axis=1, keepdims=True), doubt)
    is_trusted = (jump >= np.maximum(_NEAREST * scale, _TRUSTED * doubt)) & (jump <= _FARTHEST * scale)
    return point, is_trusted & _is_dominant(own)


def _is_dominant(own: OwnSide) -> BoolArray:
    """Return whether every own row of G is diagonally dominant, so that joint solutions contract, shape (R, 1)."""
    size, places = np.abs(own.model.rows), np.minimum(own.blocks, own.model.rows.shape[2] - 1)
    diagonal = np.take_along_axis(size, places[:, :, None], axis=2)[:, :, 0]
    is_padding = own.blocks == own.model.rows.shape[2]
    return np.asarray((is_padding | (size.sum(axis=2) < 2 * diagonal)).all(axis=1, keepdims=True))


def _joint(
    slopes: FloatArray, anchor: FloatArray, blocks: IntArray, planned: FloatArray, here: FloatArray, own: OwnSide
) -> FloatArray:
    """Solve x_j − R x_{−j} = r for the neighbours in ``blocks``, the own condition, and x = ``planned`` elsewhere.

    Singular systems give ``planned``.
    """
    rows, n = planned.shape
    equations, values = np.broadcast_to(np.eye(n), (rows, n, n)).copy(), planned
    identity = np.concatenate([np.eye(n), np.zeros((1, n))])
    for slot in range(slopes.shape[1]):
        places = blocks[:, slot]
        plane = identity[places] - np.where((places < n)[:, :, None], slopes[:, slot], 0.0)
        right = np.einsum("rmn,rn->rm", plane, anchor[:, slot])
        equations, values = with_own(equations, plane, places), with_own(values, right, places)
    curvature = own_block(own.model.rows, own.blocks).diagonal(axis1=1, axis2=2)
    places = np.where(curvature != 0, own.blocks, n)
    right = np.einsum("rmn,rn->rm", own.model.rows, here) - own.gradient
    return _solve(with_own(equations, own.model.rows, places), with_own(values, right, places), planned)


def _solve(equations: FloatArray, values: FloatArray, otherwise: FloatArray) -> FloatArray:
    """Solve ``equations`` x = ``values``, (R, n, n) and (R, n); x is ``otherwise`` (R, n) where they are singular."""
    try:
        solution = np.linalg.solve(equations, values[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        is_regular = np.linalg.slogdet(equations)[0] != 0
        safe = np.where(is_regular[:, None, None], equations, np.eye(values.shape[1]))
        solution = np.where(is_regular[:, None], np.linalg.solve(safe, values[:, :, None])[:, :, 0], otherwise)
    return np.where(np.isfinite(solution).all(axis=1, keepdims=True), solution, otherwise)
