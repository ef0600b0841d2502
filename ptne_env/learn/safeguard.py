"""A safeguard: a player whose residual does not shrink follows a law from then on.

The residual of a player is the largest displacement that its estimators propose: to the copies of its sources, or to
its best response. At the equilibrium it is 0 for all players, and the player observes it without help. A player hands
over, for good, in the step in which

- its residual is above 100 times the largest residual or own estimate of its first steps, or not finite;
- or it is 60 steps late. A player gets late by a step in every step, and makes up for ten with every halving of its
  smallest residual. Steps do not count in which the residual is below 1e-9 of the largest own estimate, or in which the
  player observes a reason: noise that explains the residual, rounded messages, a link that broke, a game that drifts,
  or an input limit that binds;
- or one of its gates is not finite.

So without these reasons a player that has not handed over k steps after its first steps has had a residual of at most
2^(−(k − 60)/10) times the largest residual or own estimate of its first steps, or of 1e-9 of its estimates.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.field.laws.best_response import largest, within_reach
from ptne_env.field.laws.gated import CellEvidence, CellGates, Estimates, SlotGates
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray

PATIENCE = 60.0
"""Steps by which a player may be late."""

_STEPS_PER_HALVING = 10.0
"""Steps that a halving of the smallest residual makes up for."""

_ESCAPED = 100.0
"""A residual above this multiple of the largest one of the first steps has left the region of the start."""

_RESOLVED = 1e-9
"""A residual below this share of the largest own estimate need not shrink further."""

_AUDIBLE = 20.0
"""Noise explains residuals up to this multiple of σ_i: moves that shrink slowly look like noise, too."""

_TINY = 1e-300

PARTS = dict.fromkeys(("start", "least_residual", "late"), (1,))
"""Shapes of the parts of the memory of :func:`handing_over`, 0 at first: the largest residual or own estimate of the
first steps, the smallest residual since then, and the steps by which the player is late, at least :data:`PATIENCE`
where it handed over."""


def residual(observation: Observation, found: Estimates) -> FloatArray:
    """The largest displacement that estimators propose, in natural units, shape (R, 1).

    Args:
        observation: of R players.
        found: estimates of this step.
    """
    copies = np.where(found.sources, observation.relative_estimates, 0.0).reshape(len(found.response), -1)
    return np.maximum(largest(copies), largest(found.response))


def handing_over(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    found: Estimates,
    cells: CellEvidence,
    layout: ObservationLayout,
) -> tuple[BoolArray, dict[str, FloatArray]]:
    """Which players have handed over, shape (R, 1), and the changed parts of the memory; row by row.

    Args:
        observation: of R players.
        memory: :data:`PARTS`, and the number of ``steps``.
        found: estimates of this step.
        cells: evidence on components.
        layout: of the observations.
    """
    size, before = residual(observation, found), memory["least_residual"]
    starts = (cells.probing > 0) | (memory["steps"] < 2)
    start = np.maximum(memory["start"], np.maximum(cells.scale, size))
    start = np.where(starts, start, memory["start"])
    least = np.where(starts, start, np.fmin(before, size))
    halvings = np.where(starts, 0.0, np.log2(np.maximum(before, _TINY) / np.maximum(least, _TINY)))
    proposed = found.drift + found.response
    is_limited = largest(within_reach(proposed, observation, layout) - proposed) > _RESOLVED * cells.scale
    is_noise = (cells.noisy > 0) & (size <= _AUDIBLE * cells.noise)
    is_excused = is_limited | is_noise | (cells.rounded > 0) | (cells.broke > 0) | (cells.drifting > 0)
    counts = ~(starts | is_excused | (size <= _RESOLVED * cells.scale))
    late = np.maximum(memory["late"] + counts - _STEPS_PER_HALVING * halvings, 0.0)
    late = np.where(starts | (size <= _ESCAPED * start), late, PATIENCE)
    late = np.where(memory["late"] >= PATIENCE, PATIENCE, late)
    return late >= PATIENCE, {"start": start, "least_residual": least, "late": late}


def are_finite(gates: CellGates, slot_gates: SlotGates) -> BoolArray:
    """Whether all gates of a player are finite numbers, shape (R, 1).

    Args:
        gates: of components, shapes (R, n).
        slot_gates: of slots, shapes (R, D, n).
    """
    rows = len(gates.copies)
    parts = (np.isfinite(part).reshape(rows, -1).all(axis=1, keepdims=True) for part in (*gates, *slot_gates))
    return np.logical_and.reduce(list(parts))
