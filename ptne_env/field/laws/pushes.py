"""The observer of pushes: velocities that move the own strategy beside the own inputs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.field.laws.best_response import largest
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray

_SEEN = 1e-6
"""Smallest displacement by a push that is seen, relative to the largest own estimate: above the resolution."""

_LONGEST = 25.0
"""Steps over which a constant push is averaged at most."""


def push_parts(layout: ObservationLayout) -> dict[str, tuple[int, ...]]:
    """Shapes of the parts of the memory of :func:`observed_push`; all 0 at the start."""
    return {"push": (layout.dimension,), "sent": (layout.dimension,), "push_steps": (1,), "dt": (1,)}


def observed_push(
    observation: Observation, memory: Mapping[str, FloatArray], residual: FloatArray
) -> dict[str, FloatArray]:
    """The velocity of the push, (R, n), as the mean of ``residual``/Δt over the steps since it last changed.

    Args:
        observation: of R players.
        memory: the parts of :func:`push_parts`.
        residual: the last displacement of own components beside the displacement that was asked for, 0 for the others
            and for components that a bound holds; natural units, shape (R, n).

    Returns:
        The parts of :func:`push_parts`: the push, the number of steps since it last changed, and Δt of the coming step.
    """
    last, resolution = memory["dt"], _SEEN * largest(observation.own_estimate)
    velocity = residual / np.where(last > 0, last, np.inf)
    changes = largest(velocity - memory["push"]) * last > 2 * resolution
    steps = np.where(changes, 1.0, memory["push_steps"] + 1)
    is_pushed = (np.abs(residual) > resolution) | (memory["push"] != 0)
    mean = memory["push"] + (velocity - memory["push"]) / np.minimum(steps, _LONGEST)
    return {"push": np.where(is_pushed, mean, 0.0), "push_steps": steps, "dt": observation.dt}
