"""Damping where best responses of all players at once do not settle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import largest, own_block, own_places
from ptne_env.field.laws.relay import Own
from ptne_env.perception.observation import Observation
from ptne_env.shared.arrays import BoolArray, FloatArray

_WINDOW = 10
"""Steps in which the largest response must shrink."""

_SHRINKS = 0.8
"""The share of the window before that counts as shrinking."""

_FACTOR = 0.8
"""The damping is multiplied by this where responses do not shrink."""

_RECOVERED = 0.5
"""Below this share of the window before, responses settle, and the damping rises by the same factor."""

_LEAST = 0.3
"""Smallest damping."""

_OPTIMISTIC = 0.8
"""Below this damping, players respond to the gradient that they expect, ∂J_i + (∂J_i − ∂J_i before)."""

_AUDIBLE = (20.0, 1e-6, 100.0)
"""A response is no unrest below this many times σ_i, this share of the largest own estimate, or this many errors."""

PARTS = dict.fromkeys(("damping", "largest_before", "largest_now"), (1,))
"""Shapes of the parts of the memory of :func:`settle`; ``damping`` is 1 at the start, others 0."""


class Settling(NamedTuple):
    """The damping of R players.

    Attributes:
        damping: of the best response, in (0, 1], shape (R, 1).
        expected: the expected change of the own gradient, shape (R, m).
        is_loose: whether the own rows of dF are not diagonally dominant, shape (R, 1).
    """

    damping: FloatArray
    expected: FloatArray
    is_loose: BoolArray

    @property
    def is_optimistic(self) -> BoolArray:
        """Whether players respond to the gradient that they expect, shape (R, 1)."""
        return np.asarray(self.is_loose & (self.damping < _OPTIMISTIC))

    def response(self, own: Own, drift: FloatArray) -> FloatArray:
        """The damped best response to the own estimates after a displacement ``drift`` (R, n) of the others, (R, m)."""
        return self.damping * own._replace(gradient=own.gradient + self.expected).response(drift)


def settling(own: Own, memory: Mapping[str, FloatArray], dimension: int) -> Settling:
    """The damping of the coming step; see :func:`settle`.

    Args:
        own: the own side of R players.
        memory: ``damping`` and ``steps``, shape (R, 1), and the own ``gradient`` of the step before, shape (R, m).
        dimension: n.
    """
    _, outputs, regressors = own.model.rows.shape
    if regressors != dimension:  # own blocks alone are known
        rest = np.zeros_like(own.gradient)
        return Settling(np.ones_like(own.radius), rest, np.zeros_like(own.is_probe))
    size = np.abs(own.model.rows)
    is_padding = own.blocks == dimension
    block = np.abs(own_block(own.model.rows, own_places(own.blocks, own.model, dimension)))
    inside = np.where(is_padding[:, None, :], 0.0, block).sum(axis=2)
    beside = np.where(is_padding, 0.0, size.sum(axis=2) - inside).max(axis=1, keepdims=True)
    curvature = np.where(is_padding, np.inf, block.diagonal(axis1=1, axis2=2)).min(axis=1, keepdims=True)
    is_loose = (beside > curvature) & (memory["steps"] > outputs + 1)
    damping = np.where(is_loose, memory["damping"], 1.0)
    found = Settling(damping, np.zeros_like(own.gradient), is_loose)
    return found._replace(expected=np.where(found.is_optimistic, own.gradient - memory["gradient"], 0.0))


def settle(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    found: Settling,
    response: FloatArray,
    noise: FloatArray,
    doubt: FloatArray,
) -> dict[str, FloatArray]:
    """The parts of the memory after a step.

    The damping falls by a fifth where own rows are loose and the largest response of ten steps is not smaller than 0.8
    times that of the ten steps before, unless noise or a gradient that changes by itself explains it. It rises again
    where that response is smaller than half of the one before.

    Args:
        observation: of R players.
        memory: :data:`PARTS`, and the number of ``steps``, shape (R, 1).
        found: of this step.
        response: the own displacement, shape (R, m) or (R, n).
        noise: σ_i, shape (R, 1).
        doubt: the recent error of predictions of the own gradient, as a displacement, shape (R, 1).
    """
    step, size = memory["steps"], np.maximum(memory["largest_now"], largest(response))
    ends = (step % _WINDOW == 0) & (step > 0)
    multiple, share, errors = _AUDIBLE
    least = np.maximum(multiple * noise, share * largest(observation.own_estimate))
    is_audible = size > np.maximum(least, errors * doubt)
    is_stuck = ends & found.is_loose & (step > 2 * _WINDOW) & is_audible & (size > _SHRINKS * memory["largest_before"])
    recovers = ends & (size < _RECOVERED * memory["largest_before"])
    damping = np.where(is_stuck, _FACTOR, np.where(recovers, 1 / _FACTOR, 1.0)) * memory["damping"]
    return {
        "damping": np.clip(damping, _LEAST, 1.0),
        "largest_before": np.where(ends, size, memory["largest_before"]),
        "largest_now": np.where(ends, 0.0, size),
    }
