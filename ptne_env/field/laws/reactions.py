"""Models of the neighbours' reactions: own strategies as functions of own estimates, learned from messages.

A neighbour j that plays best responses, and whose estimates rest, sends a point of the plane x_j = r + R x_{−j}. Two
such messages differ by a displacement within the plane, so recursive least squares identifies R. Where links break, a
player then solves its own first-order condition and the planes of its neighbours together, in place of waiting for
answers (overlapping Schwarz iteration over the players).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import largest, own_block, with_own
from ptne_env.field.laws.identification import Model, identify
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, row_maxima

START = 20
"""Steps after which planes count."""

_WARM_UP = 3
"""Steps in which players move for identification, not in answer to messages."""

_SPREAD = 0.15
"""Standard deviation of the entries of R before anything is identified: players barely react to each other."""

_COMMON = 1000.0
"""Variance that all entries share, as a multiple of that of each: players of a game tend to react alike to all."""

_REST = (1e-2, 1e-7)
"""A message that changed less than this share of its change since the last sample, or of the scale, is at rest."""

_NEW = 1e-10
"""A displacement from the last sample below this share of the scale is no new sample."""

_RESOLUTION = 1e-7
"""Standard deviation of the entries of a sample, relative to the largest own estimate."""

_SOFT = 0.3
"""The share of a plane's recent error that counts as deviation of its samples."""

_FADE = 0.7
"""The share of a plane's recent error that is left after a step."""

_WORST = 0.1
"""A plane with a recent error above this share of the scale does not count."""

_SAMPLES = 3
"""Samples after which a plane counts."""

_CURVED = 1e-3
"""An own curvature below this is not known."""

_TRUSTED = (1e-7, 3.0, 0.5)
"""A joint solution counts where it is at least this share of the scale away, at least this multiple of the largest
recent error of its planes, and at most this share of the scale."""


def reaction_parts(layout: ObservationLayout) -> dict[str, tuple[int, ...]]:
    """Shapes of the parts of the memory of :func:`react`, with the m components of the largest own block."""
    slots, n, m = layout.slots, layout.dimension, max(layout.action_dims)
    return {
        "planes": (slots, m, n),
        "plane_covariance": (slots, n, n),
        "anchor": (slots, n),  # the last sample
        "plane_samples": (slots,),
        "plane_error": (slots,),
    }


def initial_covariance(layout: ObservationLayout) -> FloatArray:
    """The covariance of the rows of R before any sample, shape (n, n)."""
    n = layout.dimension
    return np.asarray(_SPREAD**2 * (np.eye(n) + _COMMON * np.ones((n, n))))


class Reactions(NamedTuple):
    """The joint solution of the own first-order condition and the planes of the neighbours, for R players.

    Attributes:
        point: the solution, shape (R, n).
        error: the largest recent error of its planes, in natural units, shape (R, 1).
        is_trusted: whether it counts, shape (R, 1).
    """

    point: FloatArray
    error: FloatArray
    is_trusted: BoolArray


class Condition(NamedTuple):
    """The own first-order condition ∂J_i + G_i Δx = 0 of R players.

    Attributes:
        rows: G_i, shape (R, m, n).
        gradient: ∂J_i, shape (R, m).
        blocks: own components, padded with n, shape (R, m).
        doubt: the largest recent error of predictions of the own gradient, as a displacement, shape (R, 1).
    """

    rows: FloatArray
    gradient: FloatArray
    blocks: IntArray
    doubt: FloatArray


def reckoned_estimate(observation: Observation, memory: Mapping[str, FloatArray]) -> FloatArray:
    """The own estimates by dead reckoning where they agree with the observed ones, which have float32, shape (R, n)."""
    seen, reckoned = observation.own_estimate, memory["reckoned"]
    is_off = (memory["steps"] == 0) | (np.abs(reckoned - seen) > 1e-5 * largest(seen))
    return np.where(is_off, seen, reckoned)


def learned_planes(
    observation: Observation, memory: Mapping[str, FloatArray], layout: ObservationLayout, here: FloatArray
) -> dict[str, FloatArray]:
    """The planes of the neighbours with the present messages: the changed parts of the memory.

    Args:
        observation: of R players.
        memory: the parts of :func:`reaction_parts`; of the step before whether links were ``live``, shape (R, D), and
            the ``messages``, shape (R, D, n); the number of ``steps``, shape (R, 1).
        layout: of the observations.
        here: own estimates, shape (R, n).
    """
    live, neighbours = observation.weights > 0, np.array(layout.neighbours)[observation.player]
    scale, is_warm = largest(here), memory["steps"] >= _WARM_UP
    messages = here[:, None] + observation.relative_estimates
    change = observation.own_estimate[:, None] + observation.relative_estimates - memory["messages"]
    rest = np.where(memory["live"] > 0, row_maxima(np.abs(change)), np.inf)
    moved = messages - memory["anchor"]
    length = row_maxima(np.abs(moved))
    is_first = memory["plane_samples"] == 0
    is_rest = live & is_warm & (rest <= np.maximum(_REST[0] * length, _REST[1] * scale))
    is_sample = is_rest & ~is_first & (length > _NEW * scale)
    is_kept = is_sample | (is_rest & is_first)

    blocks, planes = layout.own_components[neighbours], memory["planes"]
    regressors = np.where(layout.own_mask[neighbours], 0.0, moved)
    theirs = _entries(moved, blocks)
    error = row_maxima(np.abs(theirs - np.einsum("rdmn,rdn->rdm", planes, regressors)))
    is_known = live & is_warm & (memory["plane_samples"] >= _SAMPLES)
    fresh = {"plane_error": np.where(is_known, np.maximum(_FADE * memory["plane_error"], error), memory["plane_error"])}
    if is_kept.any():
        fresh["anchor"] = np.where(is_kept[:, :, None], messages, memory["anchor"])
        fresh["plane_samples"] = memory["plane_samples"] + is_kept
    if is_sample.any():
        covariance = memory["plane_covariance"]
        resolution = (np.broadcast_to(scale, is_sample.shape)[is_sample] * _RESOLUTION) ** 2
        variance = resolution + (_SOFT * memory["plane_error"][is_sample]) ** 2
        model = Model(planes[is_sample], covariance[is_sample])
        model, _, _ = identify(model, regressors[is_sample], theirs[is_sample], variance[:, None])
        fresh["planes"], fresh["plane_covariance"] = planes.copy(), covariance.copy()
        fresh["planes"][is_sample], fresh["plane_covariance"][is_sample] = model
    return fresh


def joint_solution(
    player: IntArray,
    memory: Mapping[str, FloatArray],
    layout: ObservationLayout,
    here: FloatArray,
    planned: FloatArray,
    own: Condition,
) -> Reactions:
    """The joint solution of the own first-order condition and the planes of the neighbours.

    Args:
        player: index of each of R players, shape (R,).
        memory: the parts that :func:`learned_planes` changes, after this step's messages, and the number of ``steps``.
        layout: of the observations.
        here: own estimates, shape (R, n).
        planned: the next estimates without the joint solution, which fixes all components that no plane does, (R, n).
        own: the own first-order condition at ``here``.
    """
    neighbours, scale = np.array(layout.neighbours)[player], largest(here)
    planes = np.where(layout.own_mask[neighbours][:, :, None], 0.0, memory["planes"])  # own components react to others
    error, is_known = memory["plane_error"], memory["plane_samples"] >= _SAMPLES
    is_tame = np.abs(planes).sum(axis=3).max(axis=2) < 1
    counts = is_known & is_tame & (error < _WORST * scale) & (neighbours != player[:, None])
    blocks = np.where(counts[:, :, None], layout.own_components[neighbours], layout.dimension)
    point = _joint(planes, memory["anchor"], blocks, planned, here, own)
    largest_error = np.where(is_known, error, 0.0).max(axis=1, keepdims=True)
    jump = largest(point - planned)
    nearest, multiple, farthest = _TRUSTED
    doubt = np.maximum(largest_error, own.doubt)
    is_trusted = (jump >= np.maximum(nearest * scale, multiple * doubt)) & (jump <= farthest * scale)
    return Reactions(point, doubt, is_trusted & _is_dominant(own) & (memory["steps"] >= START))


def _is_dominant(own: Condition) -> BoolArray:
    """Whether every own row of G is diagonally dominant, shape (R, 1): then joint solutions of all players contract."""
    size, places = np.abs(own.rows), np.minimum(own.blocks, own.rows.shape[2] - 1)
    diagonal = np.take_along_axis(size, places[:, :, None], axis=2)[:, :, 0]
    is_padding = own.blocks == own.rows.shape[2]
    return np.asarray((is_padding | (size.sum(axis=2) < 2 * diagonal)).all(axis=1, keepdims=True))


def _entries(array: FloatArray, blocks: IntArray) -> FloatArray:
    """The entries of ``array`` (R, D, n) in the places ``blocks`` (R, D, m), 0 where padded with n."""
    n = array.shape[2]
    return np.where(blocks == n, 0.0, np.take_along_axis(array, np.minimum(blocks, n - 1), axis=2))


def _joint(
    planes: FloatArray, anchor: FloatArray, blocks: IntArray, planned: FloatArray, here: FloatArray, own: Condition
) -> FloatArray:
    """The solution of x_j − R x_{−j} = r for the neighbours in ``blocks``, of the own condition, and x = planned else.

    Singular systems give ``planned``.
    """
    rows, n = planned.shape
    equations, values = np.broadcast_to(np.eye(n), (rows, n, n)).copy(), planned
    identity = np.concatenate([np.eye(n), np.zeros((1, n))])
    for slot in range(planes.shape[1]):
        places = blocks[:, slot]
        plane = identity[places] - np.where((places < n)[:, :, None], planes[:, slot], 0.0)
        right = np.einsum("rmn,rn->rm", plane, anchor[:, slot])
        equations, values = with_own(equations, plane, places), with_own(values, right, places)
    curvature = own_block(own.rows, own.blocks).diagonal(axis1=1, axis2=2)
    places = np.where(np.abs(curvature) > _CURVED, own.blocks, n)
    right = np.einsum("rmn,rn->rm", own.rows, here) - own.gradient
    return _solve(with_own(equations, own.rows, places), with_own(values, right, places), planned)


def _solve(equations: FloatArray, values: FloatArray, otherwise: FloatArray) -> FloatArray:
    """x with ``equations`` x = ``values``, (R, n, n) and (R, n); ``otherwise`` (R, n) where they are singular."""
    try:
        found = np.linalg.solve(equations, values[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        is_regular = np.linalg.slogdet(equations)[0] != 0
        safe = np.where(is_regular[:, None, None], equations, np.eye(values.shape[1]))
        found = np.where(is_regular[:, None], np.linalg.solve(safe, values[:, :, None])[:, :, 0], otherwise)
    return np.where(np.isfinite(found).all(axis=1, keepdims=True), found, otherwise)
