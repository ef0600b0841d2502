"""Tracking where the game moves: the own gradient changes although the own estimates rest.

The model of the own gradient then has one regressor more, the time since the step before: its coefficient is the
gradient's own velocity. Copies of others' estimates are late by as many steps as they travelled, so they are
extrapolated by a tracking filter of position, velocity and acceleration.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import largest, own_entries, trust_radius
from ptne_env.field.laws.relay import Own
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray

_SPREAD = 10.0
"""Standard deviation of the entries of the model before anything is identified."""

_WALK = 0.05
"""Standard deviation by which the velocity changes from step to step, relative to the largest so far."""

_SETTLED = 8
"""Steps before the largest velocity counts."""

_BETTER = 0.2
"""The model with time is better where its error is below this share of the other one's."""

_AUDIBLE = 100.0
"""Errors and velocities count above this many standard deviations of observed gradients."""

_STEADY = 0.3
"""The velocity may change from step to step by this share of it."""

_LOUD, _FADE = 0.9, 0.97
"""The velocity counts above this share of its largest recent value, which fades by this factor per step."""

_CONFIRMED = 5.0
"""Number of steps in which the model with time was better, less the others, from which on the game drifts for good."""

_POSITION, _VELOCITY, _ACCELERATION = 0.8, 0.35, 0.05
"""Gains of the tracking filter."""


def drift_parts(layout: ObservationLayout) -> dict[str, tuple[int, ...]]:
    """Shapes of the parts of the memory of this module, with the m components of the largest own block."""
    n, m = layout.dimension, max(layout.action_dims)
    return {
        "timed_rows": (m, n + 1),
        "timed_covariance": (n + 1, n + 1),
        "first_dt": (1,),
        "fastest": (1,),
        "pull": (m,),
        "loudest_pull": (1,),
        "drift_steps": (1,),
        "velocity": (n,),
        "acceleration": (n,),
    }


def initial_timed_covariance(layout: ObservationLayout) -> FloatArray:
    """The covariance of the model with time before any displacement, shape (n+1, n+1)."""
    return np.asarray(_SPREAD**2 * np.eye(layout.dimension + 1))


class Drifting(NamedTuple):
    """The motion of the game as R players see it.

    Attributes:
        own: the own side, with the model that responses use: that with time where the game drifts.
        pull: the expected own change of the own gradient in the coming step, 0 where the game rests, shape (R, m).
        is_drifting: whether the game drifts, shape (R, 1).
    """

    own: Own
    pull: FloatArray
    is_drifting: BoolArray


def is_surprised(own: Own, memory: Mapping[str, FloatArray]) -> BoolArray:
    """Whether the own gradient changed otherwise than predicted, now or before, (R, 1): else nothing drifts."""
    return np.asarray((own.error > _AUDIBLE * own.deviation) | (memory["drift_steps"] > 0))


def drifting(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    own: Own,
) -> tuple[Drifting, dict[str, FloatArray]]:
    """Recursive least squares with time as a regressor, and whether it predicts the own gradient better.

    Args:
        observation: of R players.
        memory: the parts of :func:`drift_parts` and of :class:`~ptne_env.field.laws.relay.Relay`, and ``dt`` of the last
            step, shape (R, 1).
        own: the own side with whole rows.

    Returns:
        The motion, and the changed parts of the memory.
    """
    step, n = memory["steps"], observation.own_estimate.shape[1]
    first_dt = np.where(step == 0, observation.dt, memory["first_dt"])
    has_moved = step > 0
    tick = np.where(has_moved, memory["dt"] / np.maximum(first_dt, 1e-12), 0.0)
    regressors = np.concatenate([own.moved, tick], axis=1)
    rows, covariance = memory["timed_rows"], memory["timed_covariance"].copy()
    fastest = np.maximum(memory["fastest"], np.where(step > _SETTLED, largest(rows[:, :, -1]), 0.0))
    covariance[:, -1, -1] += (_WALK * fastest[:, 0]) ** 2
    change = own.gradient - memory["gradient"]
    error = change - np.einsum("rmq,rq->rm", rows, regressors)
    spread = np.einsum("rpq,rq->rp", covariance, regressors)
    gain = spread / (np.einsum("rq,rq->r", regressors, spread)[:, None] + own.deviation**2 + 1e-30)
    gain = np.where(has_moved, gain, 0.0)
    rows = rows + error[:, :, None] * gain[:, None, :]
    covariance -= spread[:, :, None] * gain[:, None, :]

    pull = np.where(has_moved, change - np.einsum("rmq,rq->rm", rows[:, :, :-1], own.moved), 0.0)
    size, is_late = largest(pull), step > n + 3
    loudest = np.where(is_late, np.maximum(_FADE * memory["loudest_pull"], size), 0.0)
    mine, theirs = largest(error), own.error
    is_better = (mine < _BETTER * theirs) & (np.minimum(size, theirs) > _AUDIBLE * own.deviation) & is_late
    is_better &= (largest(pull - memory["pull"]) < _STEADY * size) & (size > _LOUD * loudest)
    steps = memory["drift_steps"]
    steps = np.where(steps >= _CONFIRMED, steps, np.maximum(np.where(is_better, steps + 1, steps - 1), 0.0))
    is_drifting = steps >= _CONFIRMED

    last_gradient, estimate = memory["gradient"], observation.own_estimate
    calm = (mine, np.zeros_like(own.failed))
    radius = trust_radius(memory["radius"], own_entries(own.moved, own.blocks), calm, last_gradient, estimate)
    acting = own._replace(
        model=own.model._replace(rows=np.where(is_drifting[:, :, None], rows[:, :, :-1], own.model.rows)),
        radius=np.where(is_drifting, radius, own.radius),
        error=np.where(is_drifting, mine, own.error),
        failed=own.failed & ~is_drifting,
    )
    ahead = (2 * pull - memory["pull"]) * observation.dt / np.where(memory["dt"] > 0, memory["dt"], np.inf)
    return Drifting(acting, np.where(is_drifting, ahead, 0.0), is_drifting), {
        "timed_rows": rows,
        "timed_covariance": covariance,
        "first_dt": first_dt,
        "fastest": fastest,
        "pull": pull,
        "loudest_pull": loudest,
        "drift_steps": steps,
    }


def tracked(
    observation: Observation, memory: Mapping[str, FloatArray], copies: FloatArray, is_drifting: BoolArray
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Displacements of others' estimates by a tracking filter, (R, n), 0 where the game rests, and its memory.

    Args:
        observation: of R players.
        memory: ``velocity`` and ``acceleration``, shape (R, n), and ``dt`` of the last step, shape (R, 1).
        copies: x^j_c − x^i_c of the sources, 0 for own components, shape (R, n).
        is_drifting: whether the game drifts, shape (R, 1).
    """
    last, dt = np.where(memory["dt"] > 0, memory["dt"], np.inf), observation.dt
    velocity = memory["velocity"] + memory["acceleration"] * memory["dt"] + _VELOCITY * copies / last
    velocity = np.where(is_drifting, velocity, 0.0)
    acceleration = np.where(is_drifting, memory["acceleration"] + _ACCELERATION * copies / last**2, 0.0)
    moves = np.where(is_drifting, _POSITION * copies + velocity * dt + acceleration * dt**2 / 2, 0.0)
    return moves, {"velocity": velocity, "acceleration": acceleration}
