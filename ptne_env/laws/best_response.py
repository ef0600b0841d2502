"""Best responses to the own estimates, from an identified model of the own gradient, and blocks of own components."""

from __future__ import annotations

import numpy as np

from ptne_env.laws.identification import Model
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, row_maxima

_MARGIN = 3.0
"""Standard deviations of a curvature that count as doubt."""

UNLIMITED = 1e6
"""A distance beyond all estimates."""

_FLAT = 1e-12
"""Smallest curvature, so that a linear cost gives a step as long as the trust region."""

_ACCURACY = 0.5
"""Largest error of a good prediction, relative to the gradient before."""

_SHORTEST = 1e-3
"""Smallest radius of the trust region, relative to the largest own estimate."""

LARGEST_ROW = 32
"""Largest n for which whole rows of dF are identified, which takes n² numbers per player; else own blocks alone."""


def own_entries(array: FloatArray, places: IntArray) -> FloatArray:
    """The entries of own components, (..., q) to (..., m), 0 where ``places`` (..., m) is padded with q."""
    return np.where(places == array.shape[-1], 0.0, np.take_along_axis(array, _inside(places, array), axis=-1))


def own_block(rows: FloatArray, places: IntArray) -> FloatArray:
    """G_ii of rows (R, m, q), with 1 on the diagonal where ``places`` (R, m) is padded with q: (R, m, m)."""
    padded = places == rows.shape[2]
    own = np.take_along_axis(rows, _inside(places, rows)[:, None, :], axis=2)
    return np.where(padded[:, :, None] | padded[:, None, :], np.eye(places.shape[1]), own)


def with_own(array: FloatArray, own: FloatArray, blocks: IntArray) -> FloatArray:
    """``array`` (R, n, ...) with ``own`` (R, m, ...) in the places ``blocks`` (R, m) of the own components."""
    wider = np.concatenate([array, np.zeros_like(array[:, :1])], axis=1)  # one place more, into which padding falls
    np.put_along_axis(wider, blocks.reshape(*blocks.shape, *(1,) * (own.ndim - 2)), own, axis=1)
    return wider[:, :-1]


def _inside(places: IntArray, array: FloatArray) -> IntArray:
    """``places`` with padding replaced by the last place of the last axis."""
    return np.minimum(places, array.shape[-1] - 1)


def largest(array: FloatArray) -> FloatArray:
    """The largest |entry| of each row, (R, k) to (R, 1)."""
    return row_maxima(np.abs(array))[:, None]


def own_curvatures(own: FloatArray, model: Model, places: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The eigenvalues of symmetric own blocks (R, m, m), shape (R, m), three standard deviations, and the eigenvectors.

    ``places`` (R, m) are those of own components among the regressors of the model.
    """
    if own.shape[1] == 1:  # the eigenvector is 1
        variance = np.take_along_axis(model.covariance.diagonal(axis1=1, axis2=2), places, axis=1)
        return own[:, 0], _MARGIN * np.sqrt(np.maximum(variance, 0.0)), np.ones_like(own)
    curvature, vectors = np.linalg.eigh(own)
    directions = with_own(np.zeros_like(model.rows).swapaxes(1, 2), vectors, places)
    variance = np.einsum("rpa,rpq,rqa->ra", directions, model.covariance, directions)
    return curvature, _MARGIN * np.sqrt(np.maximum(variance, 0.0)), vectors


def own_places(blocks: IntArray, model: Model, dimension: int) -> IntArray:
    """The places of own components ``blocks`` (R, m) among the regressors: all n, or the own ones alone; (R, m)."""
    _, outputs, regressors = model.rows.shape
    return blocks if regressors == dimension else np.where(blocks == dimension, outputs, np.arange(outputs))


def shortened(step: FloatArray, radius: FloatArray) -> FloatArray:
    """Steps (R, m), those with an entry beyond ``radius`` (R, 1) shortened to it."""
    return step * (radius / np.maximum(largest(step), radius))


def best_response(
    model: Model,
    gradient: FloatArray,
    drift: FloatArray,
    places: IntArray,
    held: BoolArray,
    radius: FloatArray,
    is_fixed: BoolArray,
) -> FloatArray:
    """Δx_i = −D⁻¹ (∂J_i/∂x_i + G_{i,−i} Δx_{−i}) with the identified rows G, shape (R, m).

    D has the eigenvectors of the own block G_ii, and its eigenvalues or the largest row sum of |G_{i,−i}|, whichever is
    larger. In a game that is diagonally dominant this is the best response to the estimates of the next step; in others
    it is damped, because best responses of all players at once need not converge there. Where a curvature is not
    certainly positive, it counts as the sum of its size and three standard deviations: a gradient step. Where it is
    certainly negative, though costs are convex, the model is wrong; where the graph never changes, so that all steps of
    others are smooth, the step is then as long as the trust region.

    Args:
        model: the identified rows, with q regressors.
        gradient: ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m).
        drift: Δx_{−i} of the regressors, 0 for own components, shape (R, q).
        places: of own components among the regressors, padded with q, shape (R, m).
        held: whether a bound holds an own component; the others then move as if it stayed, shape (R, m).
        radius: largest |Δx_i|, shape (R, 1).
        is_fixed: whether no link of the player ever broke, shape (R, 1).
    """
    rows = model.rows
    wanted = gradient + np.einsum("rmq,rq->rm", rows, drift)
    own = own_block(rows, places)
    beside = with_own(np.abs(rows).swapaxes(1, 2), np.zeros_like(own), places)
    own = np.where(held[:, :, None] | held[:, None, :], own * np.eye(own.shape[1]), (own + own.swapaxes(1, 2)) / 2)
    curvature, doubt, vectors = own_curvatures(own, model, places)
    is_wrong = is_fixed & (curvature < -doubt)
    curvature = np.where(curvature > doubt, curvature, np.abs(curvature) + doubt)
    curvature = np.maximum(curvature, np.add.reduce(beside, axis=1).max(axis=1, keepdims=True))
    curvature = np.maximum(np.where(is_wrong, 0.0, curvature), _FLAT)
    return shortened(-np.einsum("rab,rb->ra", vectors, np.einsum("rba,rb->ra", vectors, wanted) / curvature), radius)


def trust_radius(
    radius: FloatArray,
    own_moved: FloatArray,
    prediction: tuple[FloatArray, BoolArray],
    last_gradient: FloatArray,
    estimate: FloatArray,
) -> FloatArray:
    """The radius of the trust region: the largest |Δx_i| of the coming step, shape (R, 1).

    It is twice the largest own displacement so far, until a prediction of the own gradient fails by more than half of
    the gradient before; then it is half of the last displacement. ``prediction`` is its error and whether it failed, by
    :func:`~ptne_env.laws.identification.identify`; ``own_moved`` (R, m) is the last own displacement.
    """
    length, (error, failed) = largest(own_moved), prediction
    is_bad = failed & (error > _ACCURACY * largest(last_gradient))
    radius = np.where(is_bad, length / 2, np.maximum(radius, 2 * length))
    return np.maximum(radius, _SHORTEST * largest(estimate))


def within_reach(displacement: FloatArray, observation: Observation, layout: ObservationLayout) -> FloatArray:
    """Displacements (R, k), clipped to those that the input limit allows in the coming step."""
    reach = layout.action_bound * observation.theta
    return np.clip(displacement, -reach, reach)
