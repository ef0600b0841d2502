"""A model of the own gradient, which recursive least squares identifies, and best responses to it.

The own gradient ∂J_i/∂x_i(x^i) depends on the own estimates x^i alone, which a player moves as it likes. So messages
never disturb the identified rows of dF.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, row_maxima

RESOLUTION = float(np.finfo(np.float32).eps)
"""Relative resolution of observations."""

_SURPRISE = 9.0
"""The rows have changed where the squared error of a prediction exceeds this many variances."""

_REST = 1e-60
"""Squared length below which a displacement counts as none."""

_MARGIN = 3.0
"""Number of standard deviations by which a curvature must exceed 0 to count as positive."""

UNLIMITED = 1e6
"""A distance beyond all estimates."""

_FLAT = 1e-12
"""Smallest curvature, so that a linear cost gives a step as long as the trust region."""

_ACCURACY = 0.5
"""Largest error of a good prediction, relative to the gradient before."""

_SHORTEST = 1e-3
"""Smallest radius of the trust region, relative to the largest own estimate."""

LARGEST_ROW = 32
"""Largest n for which whole rows of dF are identified, which takes n² numbers per player; beyond it, own blocks are."""

_SPREAD = 3.0
"""Standard deviation of the entries of dF before anything is identified, in units of the first gradient per largest
estimate: the first step is about a ninth of the largest estimate."""

_BENT = 5.0
"""Multiple of the largest known entry of dF by which the rounding of estimates may enter the gradient."""

_HELD = 0.1
"""A bound holds a component that moved less than this share of the displacement that was asked for."""

_RESOLVED = 1e-6
"""Smallest displacement, relative to the largest own estimates, at which that is judged."""


# --- identification --------------------------------------------------------------------------------------------------


class Model(NamedTuple):
    """The identified rows of R players, with q regressors each."""

    rows: FloatArray  # estimate of the m rows, in units of gradient per strategy, shape (R, m, q)
    covariance: FloatArray  # P, the same for all rows of a player, in squared units of the rows, shape (R, q, q)


def initial_model(layout: ObservationLayout, spread: float) -> Model:
    """Return the model of one player before the first displacement: rows 0 with the standard deviation ``spread``."""
    outputs, n = max(layout.action_dims), layout.dimension
    regressors = n if n <= LARGEST_ROW else outputs
    return Model(np.zeros((1, outputs, regressors)), spread**2 * np.eye(regressors)[None])


def identify(
    model: Model, displacement: FloatArray, change: FloatArray, variance: FloatArray
) -> tuple[Model, FloatArray, BoolArray]:
    """Update a model by recursive least squares with y = G φ + noise.

    G ← G + (y − G φ) kᵀ and P ← P − P φ kᵀ with k = P φ/(φᵀ P φ + r). Where the prediction fails,
    ‖y − G φ‖²_∞ > 9 (φᵀ P φ + r), the rows have changed, and the old data are forgotten first, in the direction of φ
    alone and as far as the failure shows: P ← P + (‖y − G φ‖²_∞ − 9 (φᵀ P φ + r)) φφᵀ/‖φ‖⁴. So P never grows without a
    displacement, data in other directions are kept, and on a game that is not affine the update tends to Broyden's.

    Args:
        model: the rows G and their covariance P.
        displacement: φ, the move of the regressors, shape (R, q).
        change: y, the move of the own gradient with them, shape (R, m).
        variance: r > 0 of the entries of y, in squared units of the gradient, shape (R, 1).

    Returns:
        The model after this displacement, the error ‖y − G φ‖_∞ of its prediction, shape (R, 1), and whether the
        prediction failed, shape (R, 1).
    """
    rows, covariance = model
    error = change - np.einsum("rmq,rq->rm", rows, displacement)
    largest_error = np.abs(error).max(axis=1, keepdims=True)
    spread = np.einsum("rpq,rq->rp", covariance, displacement)
    known = np.maximum(np.einsum("rq,rq->r", displacement, spread)[:, None], 0.0)
    length = np.einsum("rq,rq->r", displacement, displacement)[:, None]
    surprise = largest_error**2 - _SURPRISE * (known + variance)
    failed = (surprise > 0) & (length > _REST)
    forgotten = np.where(failed, surprise, 0.0) / np.maximum(length, _REST) ** 2
    spread = spread + forgotten * length * displacement
    gain = spread / np.maximum(known + forgotten * length**2 + variance, 1e-300)
    rows = rows + error[:, :, None] * gain[:, None, :]
    smaller = spread[:, :, None] * gain[:, None, :]
    np.subtract(covariance, smaller, out=smaller)
    if len(failures := np.flatnonzero(failed)):
        wider = covariance[failures] + (forgotten * displacement)[failures, :, None] * displacement[failures, None, :]
        smaller[failures] = wider - spread[failures, :, None] * gain[failures, None, :]
    return Model(rows, smaller), largest_error, failed


# --- the own components among all, and among the regressors ----------------------------------------------------------


def own_entries(array: FloatArray, places: IntArray) -> FloatArray:
    """Return the entries of own components, (..., q) to (..., m), 0 where ``places`` (..., m) is padded with q."""
    return np.where(places == array.shape[-1], 0.0, np.take_along_axis(array, _inside(places, array), axis=-1))


def own_block(rows: FloatArray, places: IntArray) -> FloatArray:
    """Return G_ii of rows (R, m, q), with 1 on the diagonal where ``places`` (R, m) is padded with q: (R, m, m)."""
    padded = places == rows.shape[2]
    own = np.take_along_axis(rows, _inside(places, rows)[:, None, :], axis=2)
    return np.where(padded[:, :, None] | padded[:, None, :], np.eye(places.shape[1]), own)


def own_places(blocks: IntArray, model: Model, dimension: int) -> IntArray:
    """Return the places of own components ``blocks`` (R, m) among the regressors, which are all n or the own ones."""
    _, outputs, regressors = model.rows.shape
    return blocks if regressors == dimension else np.where(blocks == dimension, outputs, np.arange(outputs))


def with_own(array: FloatArray, own: FloatArray, blocks: IntArray) -> FloatArray:
    """Return ``array`` (R, n, ...) with ``own`` (R, m, ...) in the places ``blocks`` (R, m) of the own components."""
    wider = np.concatenate([array, np.zeros_like(array[:, :1])], axis=1)  # one place more, into which padding falls
    np.put_along_axis(wider, blocks.reshape(*blocks.shape, *(1,) * (own.ndim - 2)), own, axis=1)
    return wider[:, :-1]


def _inside(places: IntArray, array: FloatArray) -> IntArray:
    """Return ``places`` with padding replaced by the last place of the last axis."""
    return np.minimum(places, array.shape[-1] - 1)


def largest(array: FloatArray) -> FloatArray:
    """Return the largest |entry| of each row, (R, k) to (R, 1)."""
    return row_maxima(np.abs(array))[:, None]


# --- best responses --------------------------------------------------------------------------------------------------


def own_curvatures(own: FloatArray, model: Model, places: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the eigenvalues of symmetric own blocks, three standard deviations of them, and the eigenvectors.

    The own blocks have the shape (R, m, m), the eigenvalues (R, m). ``places`` (R, m) are those of own components among
    the regressors of the model.
    """
    if own.shape[1] == 1:  # the eigenvector is 1
        variance = np.take_along_axis(model.covariance.diagonal(axis1=1, axis2=2), places, axis=1)
        return own[:, 0], _MARGIN * np.sqrt(np.maximum(variance, 0.0)), np.ones_like(own)
    curvature, vectors = np.linalg.eigh(own)
    directions = with_own(np.zeros_like(model.rows).swapaxes(1, 2), vectors, places)
    variance = np.einsum("rpa,rpq,rqa->ra", directions, model.covariance, directions)
    return curvature, _MARGIN * np.sqrt(np.maximum(variance, 0.0)), vectors


def shorten(step: FloatArray, radius: FloatArray) -> FloatArray:
    """Shorten the steps (R, m) that have an entry beyond ``radius`` (R, 1)."""
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
    """Return Δx_i = −D⁻¹ (∂J_i/∂x_i + G_{i,−i} Δx_{−i}) with the identified rows G, shape (R, m).

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
    return shorten(-np.einsum("rab,rb->ra", vectors, np.einsum("rba,rb->ra", vectors, wanted) / curvature), radius)


def trust_radius(
    radius: FloatArray,
    own_moved: FloatArray,
    prediction: tuple[FloatArray, BoolArray],
    last_gradient: FloatArray,
    estimate: FloatArray,
) -> FloatArray:
    """Return the radius of the trust region, the largest |Δx_i| of the coming step, shape (R, 1).

    It is twice the largest own displacement so far, until a prediction of the own gradient fails by more than half of
    the gradient before; then it is half of the last displacement. ``prediction`` is its error and whether it failed, by
    :func:`identify`; ``own_moved`` (R, m) is the last own displacement.
    """
    length, (error, failed) = largest(own_moved), prediction
    is_bad = failed & (error > _ACCURACY * largest(last_gradient))
    radius = np.where(is_bad, length / 2, np.maximum(radius, 2 * length))
    return np.maximum(radius, _SHORTEST * largest(estimate))


def clip_to_reach(displacement: FloatArray, observation: Observation, layout: ObservationLayout) -> FloatArray:
    """Clip displacements (R, k) to those that the input limit allows in the coming step."""
    reach = layout.action_bound * observation.theta
    return np.clip(displacement, -reach, reach)


# --- the own side of a relay -----------------------------------------------------------------------------------------


class OwnMemory(NamedTuple):
    """What R players remember of their own side."""

    model: Model  # the identified rows of dF
    estimate: FloatArray  # own estimates, shape (R, n)
    gradient: FloatArray  # own gradient, shape (R, m)
    asked: FloatArray  # the displacement that was asked for, shape (R, n)
    radius: FloatArray  # of the trust region, shape (R, 1)


def initial_own_memory(layout: ObservationLayout) -> OwnMemory:
    """Return what one player remembers at the start of an episode: a model of 0, with the deviation 1."""
    estimate, gradient = np.zeros((1, layout.dimension)), np.zeros((1, max(layout.action_dims)))
    return OwnMemory(initial_model(layout, 1.0), estimate, gradient, estimate, np.zeros((1, 1)))


class OwnSide(NamedTuple):
    """The own side of R players: their models of their own gradients, and the limits of their own displacements."""

    model: Model  # the identified rows of dF
    gradient: FloatArray  # ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m)
    blocks: IntArray  # own components, padded with n, shape (R, m)
    held: BoolArray  # own components that a bound holds, shape (R, m)
    radius: FloatArray  # of the trust region, shape (R, 1)
    error: FloatArray  # of the last prediction of the own gradient, shape (R, 1)
    is_probe: BoolArray  # whether the own components move one after the other, in the first m steps, shape (R, 1)
    turn: BoolArray  # the own components that move in this step, shape (R, m)
    is_fixed: BoolArray  # whether no link of the player ever broke, shape (R, 1)

    def respond(self, drift: FloatArray) -> FloatArray:
        """Return the best response Δx_i (R, m) to the estimates after a displacement ``drift`` (R, n) of the others."""
        outputs, is_whole = self.blocks.shape[1], self.model.rows.shape[2] == drift.shape[1]
        places = own_places(self.blocks, self.model, drift.shape[1])
        shift = drift if is_whole else np.zeros((len(drift), outputs))
        radius = np.where(self.is_probe, UNLIMITED, self.radius)
        step = best_response(self.model, self.gradient, shift, places, self.held, radius, self.is_fixed)
        return np.where(self.turn, step, 0.0)

    def remember(self, observation: Observation, displacement: FloatArray, layout: ObservationLayout) -> OwnMemory:
        """Return what the next step needs, after ``displacement`` (R, n)."""
        asked = clip_to_reach(displacement, observation, layout)
        return OwnMemory(self.model, observation.own_estimate, self.gradient, asked, self.radius)


def observe_own_side(
    observation: Observation, was: OwnMemory, steps: FloatArray, layout: ObservationLayout, broke: BoolArray
) -> OwnSide:
    """Return the own side of R players after ``steps`` (R, 1); ``broke`` (R, 1) says whether a link ever broke."""
    estimate = observation.own_estimate
    blocks, is_own = layout.own_components[observation.player], layout.own_mask[observation.player]
    outputs, is_whole = blocks.shape[1], was.model.rows.shape[2] == layout.dimension
    gradient = own_entries(observation.gradient, blocks)
    moved = np.where(steps == 0, 0.0, estimate - was.estimate)
    own_moved = own_entries(moved, blocks)

    scale = largest(estimate) + largest(was.estimate)
    known = np.abs(was.model.rows).max(axis=(1, 2))[:, None]  # 0 at the start
    deviation = RESOLUTION * (largest(gradient) + largest(was.gradient) + _BENT * known * scale)
    if not is_whole:
        deviation = deviation + known * largest(np.where(is_own, 0.0, moved))
    shift = moved if is_whole else own_moved
    widening = np.where(steps == 0, _first_variance(gradient, scale), 1.0)
    model = was.model._replace(covariance=was.model.covariance * widening[:, :, None])
    model, error, failed = identify(model, shift, gradient - was.gradient, deviation**2)

    radius = trust_radius(was.radius, own_moved, (error, failed), was.gradient, estimate)
    asked = np.abs(own_entries(was.asked, blocks))
    held = (np.abs(own_moved) < _HELD * asked) & (asked > _RESOLVED * scale)
    is_probe = steps < outputs
    turn = ~is_probe | (np.arange(outputs) == steps)
    return OwnSide(model, gradient, blocks, held, radius, error, is_probe, turn, ~broke)


def _first_variance(gradient: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the variance of the entries of dF before the first step, from the first gradient (R, m) and estimates."""
    is_known = (scale > 0) & (gradient != 0).any(axis=1, keepdims=True)
    return (_SPREAD * np.where(is_known, largest(gradient) / np.where(scale > 0, scale, 1.0), 1.0)) ** 2
