"""A model of the own gradient, which recursive least squares identifies, and the limits of steps that rely on it.

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

_PRECISION = 1e-11
"""Smallest variance of a change, in (trace(P) + w²) ‖φ‖²: far above the rounding of float64, so P stays positive."""

_REST = 1e-24
"""A displacement is none whose square is below this share of the square of the largest own estimate."""

_SEEN = 8.0
"""A change of the gradient is seen that is above this many resolutions."""

_MARGIN = 3.0
"""Number of standard deviations by which a curvature must exceed 0 to count as positive."""

_ACCURACY = 0.5
"""Largest error of a good prediction, relative to the gradient before."""

_SHORTEST = 1e-3
"""Smallest radius of the trust region, relative to the largest own estimate."""

_BENT = 5.0
"""Multiple of the largest known entry of dF by which the rounding of estimates may enter the gradient."""


class Model(NamedTuple):
    """The identified rows of R players, and what they were identified from."""

    rows: FloatArray  # estimate of the m rows of dF, in units of gradient per strategy, shape (R, m, n)
    covariance: FloatArray  # P, the same for all rows of a player, in squared units of the rows, shape (R, n, n)
    widest: FloatArray  # standard deviation of the entries before anything is identified, shape (R, 1)
    estimate: FloatArray  # own estimates of the step before, shape (R, n)
    gradient: FloatArray  # own gradient there, shape (R, m)
    radius: FloatArray  # of the trust region: the largest |Δx_i| of the coming step, shape (R, 1)
    started: FloatArray  # whether there was a step before, shape (R, 1)


def initial_model(layout: ObservationLayout, rows: int) -> Model:
    """Return the models of R players before the first step: they know nothing."""
    n, m, none = layout.dimension, max(layout.action_dims), np.zeros((rows, 1))
    jacobians, covariance = np.zeros((rows, m, n)), np.zeros((rows, n, n))
    return Model(jacobians, covariance, none, np.zeros((rows, n)), np.zeros((rows, m)), none, none)


def identify(
    was: Model, estimate: FloatArray, gradient: FloatArray, widest: FloatArray, first: FloatArray, is_own: BoolArray
) -> Model:
    """Update a model by recursive least squares with y = G φ + noise, where φ and y are the changes since last step.

    G ← G + (y − G φ) kᵀ and P ← P − (φᵀ P φ + r) k kᵀ with k = P φ/(φᵀ P φ + r). The variance r of y is that of
    float32, and 1e-11 (trace(P) + w²) ‖φ‖², which keeps P positive.

    Where the prediction fails, ‖y − G φ‖²_∞ > 9 (φᵀ P φ + r), the rows have changed, and the old data are forgotten
    first, in the direction of φ alone, as far as the failure shows, and no further than at the start:
    P ← P + min(‖y − G φ‖²_∞ − 9 (φᵀ P φ + r), w² ‖φ‖²) φφᵀ/‖φ‖⁴, where w grows to the largest ‖y‖_∞/‖φ‖ that was seen.
    So P never grows without a displacement, data in other directions are kept, and on a game that is not affine the
    update tends to Broyden's.

    The radius of the trust region is twice the largest own displacement since a prediction failed by more than half of
    the gradient before it; then it is half of the last displacement, and never below 1e-3 of the largest estimate.

    Args:
        was: the model of the step before.
        estimate: own estimates x^i, shape (R, n).
        gradient: ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m).
        widest: w, the standard deviation of the entries of G before anything is identified, shape (R, 1); it counts in
            the first step.
        first: the radius in the first step, shape (R, 1).
        is_own: own components, shape (R, n).
    """
    started = was.started > 0
    widest = np.where(started, was.widest, widest)
    covariance = np.where(started[:, :, None], was.covariance, widest[:, :, None] ** 2 * np.eye(estimate.shape[1]))
    displacement = np.where(started, estimate - was.estimate, 0.0)
    change = np.where(started, gradient - was.gradient, 0.0)
    scale = np.maximum(largest(estimate), largest(was.estimate))

    known = np.abs(was.rows).max(axis=(1, 2))[:, None]
    seen = RESOLUTION * (largest(gradient) + largest(was.gradient) + 2 * _BENT * known * scale)
    length = np.einsum("rn,rn->r", displacement, displacement)[:, None]
    is_seen = (largest(change) > _SEEN * seen) & (length > _REST * scale**2)
    secant = np.where(is_seen, largest(change) / np.sqrt(np.where(is_seen, length, 1.0)), 0.0)
    widest = np.maximum(widest, secant)
    most = np.trace(covariance, axis1=1, axis2=2)[:, None] + widest**2
    variance = seen**2 + _PRECISION * most * length
    error = change - np.einsum("rmn,rn->rm", was.rows, displacement)
    spread = np.einsum("rpn,rn->rp", covariance, displacement)
    total = np.einsum("rn,rn->r", displacement, spread)[:, None] + variance
    surprise = largest(error) ** 2 - _SURPRISE * total
    failed = (surprise > 0) & (length > _REST * scale**2)
    length = np.where(failed, length, 1.0)
    forgotten = np.where(failed, np.minimum(surprise, widest**2 * length), 0.0)
    along = displacement / length
    spread = spread + forgotten * along
    total = total + forgotten
    gain = spread / np.where(total > 0, total, 1.0)
    covariance = covariance + (forgotten * along)[:, :, None] * along[:, None, :]
    covariance = covariance - (total * gain)[:, :, None] * gain[:, None, :]

    moved = largest(np.where(is_own, displacement, 0.0))
    is_bad = failed & (largest(error) > _ACCURACY * largest(was.gradient))
    radius = np.where(is_bad, moved / 2, np.maximum(was.radius, 2 * moved))
    radius = np.where(started, np.maximum(radius, _SHORTEST * scale), first)
    rows = was.rows + error[:, :, None] * gain[:, None, :]
    return Model(rows, covariance, widest, estimate, gradient, radius, np.ones_like(radius))


class Curvature(NamedTuple):
    """The curvature of their own costs that R players have seen, and what they saw it by, in natural units."""

    largest: FloatArray  # L, in units of gradient per strategy, shape (R, 1)
    gradient: FloatArray  # own gradient in the step before, shape (R, n)
    moves: FloatArray  # of the own estimates in that step, shape (R, n)


def see_curvature(was: Curvature, observation: Observation, is_own: BoolArray) -> Curvature:
    """Update L, the largest ‖Δ∂J_i/∂x_i‖_∞/‖Δx_i‖_∞ so far, of steps in which Δx_i was the largest move."""
    gradient = observation.gradient * observation.unit
    change = largest(gradient - was.gradient) - _SEEN * RESOLUTION * (largest(gradient) + largest(was.gradient))
    moved, others = largest(np.where(is_own, was.moves, 0.0)), largest(np.where(is_own, 0.0, was.moves))
    secant = np.where(moved > others, change / np.where(moved > others, moved, 1.0), 0.0)
    return Curvature(np.maximum(was.largest, secant), gradient, was.moves)


def own_curvatures(
    model: Model, blocks: IntArray, held: BoolArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the eigenvalues of the symmetric own blocks G_ii, three standard deviations of them, and the eigenvectors.

    Args:
        model: the model of R players.
        blocks: own components, padded with n, shape (R, m).
        held: own components that a bound holds, whose entries beside the diagonal count as 0, shape (R, m).

    Returns:
        Arrays of shape (R, m), (R, m) and (R, m, m). The curvature of a padded component is infinite.
    """
    padded, places = blocks == model.rows.shape[2], np.arange(blocks.shape[1])
    block = np.take_along_axis(model.rows, np.minimum(blocks, model.rows.shape[2] - 1)[:, None, :], axis=2)
    if held is not None:
        block = np.where(held[:, :, None] | held[:, None, :], block * np.eye(len(places)), block)
    above = 1 + 2 * np.abs(block).sum(axis=(1, 2), keepdims=True)  # so padded components have the largest eigenvalues
    block = np.where(padded[:, :, None] | padded[:, None, :], above * np.eye(len(places)), block)
    curvature, vectors = np.linalg.eigh((block + block.swapaxes(1, 2)) / 2)
    curvature = np.where(places < (~padded).sum(axis=1, keepdims=True), curvature, np.inf)
    directions = with_own(np.zeros_like(model.rows).swapaxes(1, 2), vectors, blocks)
    variance = np.einsum("rpa,rpq,rqa->ra", directions, model.covariance, directions)
    return curvature, _MARGIN * np.sqrt(np.maximum(variance, 0.0)), vectors


def own_entries(array: FloatArray, blocks: IntArray) -> FloatArray:
    """Return the entries of own components, (R, n) to (R, m), 0 where ``blocks`` (R, m) is padded with n."""
    n = array.shape[1]
    return np.where(blocks == n, 0.0, np.take_along_axis(array, np.minimum(blocks, n - 1), axis=1))


def with_own(array: FloatArray, own: FloatArray, blocks: IntArray) -> FloatArray:
    """Return ``array`` (R, n, ...) with ``own`` (R, m, ...) in the places ``blocks`` (R, m) of the own components."""
    wider = np.concatenate([array, np.zeros_like(array[:, :1])], axis=1)  # one place more, into which padding falls
    np.put_along_axis(wider, blocks.reshape(*blocks.shape, *(1,) * (own.ndim - 2)), own, axis=1)
    return wider[:, :-1]


def largest(array: FloatArray) -> FloatArray:
    """Return the largest |entry| of each row, (R, k) to (R, 1)."""
    return row_maxima(np.abs(array))[:, None]


def shorten(step: FloatArray, radius: FloatArray) -> FloatArray:
    """Shorten the steps (R, m) that have an entry beyond ``radius`` (R, 1)."""
    longest = largest(step)
    return step * np.where(longest > radius, radius / np.where(longest > radius, longest, 1.0), 1.0)


def clip_to_reach(displacement: FloatArray, observation: Observation, layout: ObservationLayout) -> FloatArray:
    """Clip displacements (R, k) to those that the input limit allows in the coming step."""
    reach = layout.action_bound * observation.theta
    return np.clip(displacement, -reach, reach)
