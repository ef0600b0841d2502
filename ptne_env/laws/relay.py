"""Relay: best response from an identified model of the own gradient, and copies of estimates hop by hop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from scipy.sparse.csgraph import shortest_path

from ptne_env.arrays import BoolArray, FloatArray, IntArray, require_positive
from ptne_env.laws.base import Law, per_step
from ptne_env.laws.identification import RESOLUTION, Model, blank, identify
from ptne_env.laws.memory import Parts
from ptne_env.observation import Observation, ObservationLayout

_MARGIN = 3.0
"""Standard deviations by which a curvature exceeds 0 where it is certain."""

_ACCURACY = 0.5
"""Largest error of a good prediction, relative to the gradient before."""

_RESTLESS = 30
"""Steps in which the smallest change of messages does not halve, after which it is taken for noise."""

_SIGNAL = 8.0
"""A difference to the neighbours above this many times their smallest change is no noise."""

_FORGETTING = 2.0
"""p ≥ 1 of the weights p/(p + k) of an average over k steps: larger numbers forget the first ones faster."""

_SHORTEST = 1e-3
"""Smallest radius of the trust region, relative to the largest own estimate."""

_HELD = 0.1
"""A component that moved less than this share of the displacement that it was asked for is held by a bound."""

_RESOLVED = 1e-6
"""Smallest displacement, relative to the largest own estimates, at which that is judged."""

UNLIMITED = 1e6
"""A distance beyond all estimates."""

LARGEST_ROW = 64
"""Largest n for which whole rows of dF are identified, which takes n² numbers per player; else own blocks alone."""


def nearer_slots(layout: ObservationLayout) -> BoolArray:
    """Whether the neighbour in slot d of player i is nearer than i to the owner of component c, shape (N, D, n).

    Distances are hop counts on the graph of all neighbours that the layout names.
    """
    neighbours, players = np.array(layout.neighbours), np.arange(layout.num_players)
    adjacency = np.zeros((len(players), len(players)))
    adjacency[players[:, None], neighbours] = 1.0
    hops = shortest_path(adjacency * (1 - np.eye(len(players))), unweighted=True)
    owners = np.repeat(players, layout.action_dims)
    return hops[neighbours][:, :, owners] < hops[:, None, owners]


def copies(
    observation: Observation, memory: Mapping[str, FloatArray], nearer: BoolArray
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """w_k × mean over the live nearer neighbours j of (x^j_c − x^i_c): the displacements (R, n), and memory.

    A component of whose nearer neighbours none was ever heard of takes the mean over all live neighbours.

    The weight w_k is 1 until messages show noise: they never come to rest. Where the smallest change of messages from
    step to step, σ, has not halved for 30 steps, w_k = p/(p + k) averages over the k steps since, until a difference
    of more than 8 σ starts it again.
    """
    live = observation.weights > 0
    heard = np.maximum(memory["heard"], live)
    towards = nearer[observation.player]
    lost = ~(towards & (heard > 0)[:, :, None]).any(axis=1, keepdims=True)
    used = (towards | lost) & live[:, :, None]
    relative = np.where(used, observation.relative_estimates, 0.0)
    mean = np.add.reduce(relative, axis=1) / np.maximum(used.sum(axis=1), 1)

    messages = observation.own_estimate[:, None] + observation.relative_estimates
    both = live & (memory["live"] > 0)
    change = np.abs(np.where(both[:, :, None], messages - memory["messages"], 0.0)).max(axis=(1, 2))[:, None]
    change = np.where(both.any(axis=1, keepdims=True), change, np.inf)
    least, mark, restless = np.minimum(memory["least"], change), memory["mark"], memory["restless"]
    is_noise = restless > _RESTLESS
    calmer = least <= mark / np.where(is_noise, _SIGNAL, 2.0)
    is_signal = np.abs(mean).max(axis=1, keepdims=True) > _SIGNAL * least
    restless = np.where(calmer | is_signal, 0.0, restless + 1)
    weight = np.where(restless > _RESTLESS, _FORGETTING / (_FORGETTING + restless), 1.0)
    return weight * mean, {
        "heard": heard,
        "live": live.astype(np.float64),
        "messages": messages,
        "least": least,
        "mark": np.where(calmer, least, mark),
        "restless": restless,
    }


def best_response(
    model: Model, gradient: FloatArray, drift: FloatArray, blocks: IntArray, held: BoolArray, radius: FloatArray
) -> FloatArray:
    """Δx_i = −D⁻¹ (∂J_i/∂x_i + G_{i,−i} Δx_{−i}) from the identified row G, shape (R, m).

    D has the eigenvectors of the own block G_ii, and as eigenvalues those of G_ii, but at least the largest row sum
    of |G_{i,−i}|: where the game is diagonally dominant, this is the best response to the estimates of the next
    step, and elsewhere it is damped as far as needed for best responses of all players at once to converge. Where a
    curvature is not certainly positive, D is at least 1 and three standard deviations: a gradient step.

    Args:
        model: of whole rows (q = n), or own blocks (q = m).
        gradient: ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m).
        drift: Δx_{−i}, 0 for own components, shape (R, n).
        blocks: own components, padded with n, shape (R, m).
        held: whether a bound holds an own component, which then moves alone, shape (R, m).
        radius: largest |Δx_i|, shape (R, 1).
    """
    rows, outputs, regressors = model.rows.shape
    padded = blocks == drift.shape[1]
    wanted = gradient
    if regressors == outputs:
        own, covariance, coupling = model.rows, model.covariance, np.zeros((rows, outputs))
    else:
        safe = np.minimum(blocks, regressors - 1)
        own = np.take_along_axis(model.rows, safe[:, None, :], axis=2)
        covariance = np.take_along_axis(model.covariance, safe[:, :, None], axis=1)
        covariance = np.take_along_axis(covariance, safe[:, None, :], axis=2)
        wanted = gradient + np.einsum("rmq,rq->rm", model.rows, drift)
        beside = np.abs(model.rows)
        coupling = np.add.reduce(beside, axis=2) - np.add.reduce(np.abs(own) * ~padded[:, None, :], axis=2)
    own = np.where(padded[:, :, None] | padded[:, None, :], np.eye(outputs), (own + own.swapaxes(1, 2)) / 2)
    curvature, vectors = np.linalg.eigh(np.where(held[:, :, None] | held[:, None, :], own * np.eye(outputs), own))
    doubt = _MARGIN * np.sqrt(np.maximum(np.einsum("rba,rbc,rca->ra", vectors, covariance, vectors), 0.0))
    curvature = np.maximum(curvature, np.where(curvature > doubt, 0.0, np.maximum(np.abs(curvature) + doubt, 1.0)))
    curvature = np.maximum(curvature, coupling.max(axis=1, keepdims=True))
    step = -np.einsum("rab,rb->ra", vectors, np.einsum("rba,rb->ra", vectors, wanted) / curvature)
    return _within(step, radius)


def _within(step: FloatArray, radius: FloatArray) -> FloatArray:
    """Steps (R, m), shortened to ``radius`` (R, 1) in their largest component."""
    size = np.abs(step).max(axis=1, keepdims=True)
    return step * (radius / np.maximum(size, radius))


def relay_displacement(
    observation: Observation, memory: Mapping[str, FloatArray], layout: ObservationLayout, nearer: BoolArray, spread: float
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Copies of the others' estimates, :func:`copies`, and the best response to them, :func:`best_response`.

    In the first m steps the others' estimates rest, and one own component after the other moves, so that the own block
    of dF is known at once; the rest of the rows follows from the displacements that the copies cause,
    :func:`~ptne_env.laws.identification.identify`.

    The trust region: after a good prediction of the own gradient the largest own displacement is at least twice the
    last one, and half of the last one after a bad one. A prediction is bad where it contradicts the model and its
    error is above half of the gradient before.

    Args:
        observation: of R players.
        memory: parts by name, of :meth:`Relay.parts`.
        layout: of the observations.
        nearer: of :func:`nearer_slots`.

    Returns:
        The displacements Δx^i, shape (R, n), and the memory for the next step.
    """
    dimension, blocks = layout.dimension, layout.own_components[observation.player]
    padded, safe = blocks == dimension, np.minimum(blocks, dimension - 1)
    estimate, before = observation.own_estimate, memory["estimate"]
    gradient = np.where(padded, 0.0, np.take_along_axis(observation.gradient, safe, axis=1))
    moved = np.where(memory["steps"] == 0, 0.0, estimate - before)
    own_moved = np.where(padded, 0.0, np.take_along_axis(moved, safe, axis=1))
    is_own = layout.own_mask[observation.player]

    model = Model(memory["rows"], memory["covariance"])
    scale = _largest(estimate) + _largest(before)
    deviation = RESOLUTION * (_largest(gradient) + _largest(memory["gradient"]) + spread * scale)
    displacement = moved
    if model.rows.shape[2] != dimension:
        displacement, deviation = own_moved, deviation + spread * _largest(np.where(is_own, 0.0, moved))
    change = gradient - memory["gradient"]
    model, error, failed = identify(model, displacement, change, deviation**2)
    is_bad = failed & (error > _ACCURACY * _largest(memory["gradient"]))
    length = _largest(own_moved)
    radius = np.where(is_bad, length / 2, np.maximum(memory["radius"], 2 * length))
    radius = np.maximum(radius, _SHORTEST * _largest(estimate))

    asked = memory["asked"]
    held = (np.abs(own_moved) < _HELD * np.abs(asked)) & (np.abs(asked) > _RESOLVED * scale)

    step, outputs = memory["steps"], blocks.shape[1]
    is_probe = step < outputs
    drift, heard = copies(observation, memory, nearer)
    drift = np.where(is_probe | is_own, 0.0, drift)
    own_step = best_response(model, gradient, drift, blocks, held, np.where(is_probe, UNLIMITED, radius))
    own_step = np.where(is_probe & (np.arange(outputs) != step), 0.0, own_step)
    reach = layout.action_bound * observation.theta
    targets = np.concatenate([drift, np.zeros((len(drift), 1))], axis=1)  # one column more, into which padding falls
    np.put_along_axis(targets, blocks, own_step, axis=1)
    return targets[:, :-1], {
        "rows": model.rows,
        "covariance": model.covariance,
        "estimate": estimate,
        "gradient": gradient,
        "asked": np.clip(own_step, -reach, reach),
        "radius": radius,
        "failed": failed.astype(np.float64),
        "steps": step + 1,
        **heard,
    }


def _largest(array: FloatArray) -> FloatArray:
    """The largest |entry| of each row, (R, k) to (R, 1)."""
    return np.abs(array).max(axis=1, keepdims=True)


class Relay(Law):
    """Best response from an identified model of the own gradient, and copies hop by hop, :func:`relay_displacement`.

    Args:
        layout: of the environment, interface ``physical``.
        spread: standard deviation of the entries of dF before anything is identified, > 0, in units of gradient per
            strategy; 1/(3 ``spread``) is the step of the first gradient steps.

    Raises:
        ValueError: for a spread that is not positive, or another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout, spread: float = 10.0) -> None:
        super().__init__(layout)
        self.spread = require_positive("spread", spread)
        self.nearer = nearer_slots(layout)
        self.parts = Parts(self._shapes())

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of the memory."""
        outputs, dimension, slots = max(self.layout.action_dims), self.layout.dimension, self.layout.slots
        regressors = dimension if dimension <= LARGEST_ROW else outputs
        return {
            "rows": (outputs, regressors),
            "covariance": (regressors, regressors),
            "estimate": (dimension,),
            "gradient": (outputs,),
            "asked": (outputs,),
            "radius": (1,),
            "failed": (1,),
            "steps": (1,),
            "heard": (slots,),
            "live": (slots,),
            "messages": (slots, dimension),
            "least": (1,),
            "mark": (1,),
            "restless": (1,),
        }

    def initial_memory(self, rows: int) -> FloatArray:
        """A model of zeros with the standard deviation ``spread``, and nothing heard; shape (R, size)."""
        parts = self.parts.zeros(rows)
        parts["covariance"] += self.spread**2 * np.eye(parts["covariance"].shape[1])
        parts["least"] += UNLIMITED
        parts["mark"] += UNLIMITED
        return self.parts.join(parts)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = self.parts.split(memory)
        displacement, parts = relay_displacement(observation, parts, self.layout, self.nearer, self.spread)
        return per_step(displacement, observation), self.parts.join(parts)
