"""Identification of the own gradient: rows of dF from displacements of the own estimates, by recursive least squares.

The own gradient ∂J_i/∂x_i(x^i) depends on the own estimates x^i alone, which a player moves as it likes. So messages
never disturb the identified rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.shared.arrays import BoolArray, FloatArray

RESOLUTION = float(np.finfo(np.float32).eps)
"""Relative resolution of observations."""

_SURPRISE = 9.0
"""A squared error of the prediction above this many variances shows that the rows have changed."""

_REST = 1e-60
"""A displacement of which the squared length is below this is none."""


class Model(NamedTuple):
    """The identified rows of R players, with q regressors each."""

    rows: FloatArray  # estimate of the m rows, in units of gradient per strategy, shape (R, m, q)
    covariance: FloatArray  # P, the same for all rows of a player, in squared units of the rows, shape (R, q, q)


def blank(players: int, outputs: int, regressors: int, spread: float) -> Model:
    """The model before the first displacement: rows 0 with the standard deviation ``spread``, in units of the rows."""
    covariance = np.broadcast_to(spread**2 * np.eye(regressors), (players, regressors, regressors))
    return Model(np.zeros((players, outputs, regressors)), covariance)


def identify(
    model: Model, displacement: FloatArray, change: FloatArray, variance: FloatArray
) -> tuple[Model, FloatArray, BoolArray]:
    """G ← G + (y − G φ) kᵀ, P ← P − P φ kᵀ with k = P φ/(φᵀ P φ + r): recursive least squares with y = G φ + noise.

    Where the prediction fails, ‖y − G φ‖²_∞ > 9 (φᵀ P φ + r), the rows have changed, and the old data are forgotten
    first, in the direction of φ alone and as far as the failure shows: P ← P + (‖y − G φ‖²_∞ − 9 (φᵀ P φ + r))
    φφᵀ/‖φ‖⁴. So P never grows without a displacement, data in other directions are kept, and on a game that is not
    affine the update tends to Broyden's.

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
    largest = np.abs(error).max(axis=1, keepdims=True)
    spread = np.einsum("rpq,rq->rp", covariance, displacement)
    known = np.maximum(np.einsum("rq,rq->r", displacement, spread)[:, None], 0.0)
    length = np.einsum("rq,rq->r", displacement, displacement)[:, None]
    surprise = largest**2 - _SURPRISE * (known + variance)
    failed = (surprise > 0) & (length > _REST)
    forgotten = np.where(failed, surprise, 0.0) / np.maximum(length, _REST) ** 2
    spread = spread + forgotten * length * displacement
    gain = spread / (known + forgotten * length**2 + variance)
    rows = rows + error[:, :, None] * gain[:, None, :]
    smaller = spread[:, :, None] * gain[:, None, :]
    np.subtract(covariance, smaller, out=smaller)
    if len(failures := np.flatnonzero(failed)):
        wider = covariance[failures] + (forgotten * displacement)[failures, :, None] * displacement[failures, None, :]
        smaller[failures] = wider - spread[failures, :, None] * gain[failures, None, :]
    return Model(rows, smaller), largest, failed
