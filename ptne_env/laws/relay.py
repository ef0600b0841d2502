"""Relay: best response from an identified model of the own gradient, and copies of estimates hop by hop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray, IntArray, require_positive
from ptne_env.laws.base import Law, per_step
from ptne_env.laws.identification import RESOLUTION, Model, blank, identify
from ptne_env.laws.memory import Parts
from ptne_env.laws.routed import nearer_slots
from ptne_env.observation import Interface, Observation, ObservationLayout

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

LARGEST_ROW = 32
"""Largest n for which whole rows of dF are identified, which takes n² numbers per player; else own blocks alone."""


def own_entries(array: FloatArray, places: IntArray) -> FloatArray:
    """The entries of own components, (R, q) to (R, m), 0 where ``places`` (R, m) is padded with q."""
    return np.where(places == array.shape[1], 0.0, np.take_along_axis(array, _inside(places, array), axis=1))


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


def _largest(array: FloatArray) -> FloatArray:
    """The largest |entry| of each row, (R, k) to (R, 1)."""
    return np.abs(array).max(axis=1, keepdims=True)


def copies(
    observation: Observation, memory: Mapping[str, FloatArray], sources: BoolArray, *, mixes: bool = True
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """w_k × mean of (x^j_c − x^i_c) over the live sources j of component c: the displacements (R, n), and the memory.

    A component of which no source was ever heard moves to the mean of all live neighbours and the player itself, if
    ``mixes``; else it rests.

    The weight w_k is 1 until messages show noise, which never comes to rest. Where the smallest change of messages
    from step to step, σ, has not halved for 30 steps, w_k = p/(p + k) averages over the k steps since. A difference
    above 8 σ is no noise, and starts the count again; so does an eighth of the σ at which it began.

    Args:
        observation: of R players.
        memory: the parts ``heard`` to ``restless`` of :class:`Relay`.
        sources: from which neighbours each component is copied where they are live, shape (R, D, n).
        mixes: whether a component without sources moves.
    """
    live = observation.weights > 0
    heard = np.maximum(memory["heard"], live)
    lost = mixes & ~np.logical_or.reduce(sources & (heard > 0)[:, :, None], axis=1)
    used = (sources | lost[:, None]) & live[:, :, None]
    total = np.add.reduce(np.where(used, observation.relative_estimates, 0.0), axis=1)
    mean = total / np.maximum(np.add.reduce(used, axis=1) + lost, 1)

    messages = observation.own_estimate[:, None] + observation.relative_estimates
    lasts = live & (memory["live"] > 0)
    change = np.where(lasts[:, :, None], np.abs(messages - memory["messages"]), 0.0).max(axis=2)
    change = np.where(lasts.any(axis=1, keepdims=True), _largest(change), np.inf)
    least, mark, restless = np.minimum(memory["least"], change), memory["mark"], memory["restless"]
    calmer = least <= mark / np.where(restless > _RESTLESS, _SIGNAL, 2.0)
    restless = np.where(calmer | (_largest(mean) > _SIGNAL * least), 0.0, restless + 1)
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
    model: Model, gradient: FloatArray, drift: FloatArray, places: IntArray, held: BoolArray, radius: FloatArray
) -> FloatArray:
    """Δx_i = −D⁻¹ (∂J_i/∂x_i + G_{i,−i} Δx_{−i}) with the identified rows G, shape (R, m).

    D has the eigenvectors of the own block G_ii, and its eigenvalues or the largest row sum of |G_{i,−i}|, whichever is
    larger. In a game that is diagonally dominant this is the best response to the estimates of the next step; in others
    it is damped, because best responses of all players at once need not converge there. Where a curvature is not
    certainly positive, it counts as the sum of its size and three standard deviations, at least 1: a gradient step.

    Args:
        model: the identified rows, with q regressors.
        gradient: ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m).
        drift: Δx_{−i} of the regressors, 0 for own components, shape (R, q).
        places: of own components among the regressors, padded with q, shape (R, m).
        held: whether a bound holds an own component; the others then move as if it stayed, shape (R, m).
        radius: largest |Δx_i|, shape (R, 1).
    """
    rows, covariance = model
    wanted = gradient + np.einsum("rmq,rq->rm", rows, drift)
    own = own_block(rows, places)
    beside = with_own(np.abs(rows).swapaxes(1, 2), np.zeros_like(own), places)
    own = np.where(held[:, :, None] | held[:, None, :], own * np.eye(own.shape[1]), (own + own.swapaxes(1, 2)) / 2)
    curvature, vectors = np.linalg.eigh(own)
    directions = with_own(np.zeros_like(rows).swapaxes(1, 2), vectors, places)
    doubt = _MARGIN * np.sqrt(np.maximum(np.einsum("rpa,rpq,rqa->ra", directions, covariance, directions), 0.0))
    gradient_step = np.maximum(np.abs(curvature) + doubt, 1.0)
    curvature = np.where(curvature > doubt, curvature, gradient_step)
    curvature = np.maximum(curvature, np.add.reduce(beside, axis=1).max(axis=1, keepdims=True))
    step = -np.einsum("rab,rb->ra", vectors, np.einsum("rba,rb->ra", vectors, wanted) / curvature)
    return step * (radius / np.maximum(_largest(step), radius))


def relay_displacement(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    layout: ObservationLayout,
    sources: BoolArray,
    spread: float,
    *,
    mixes: bool = True,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Copies of the others' estimates, :func:`copies`, and the best response to them, :func:`best_response`.

    In the first m steps the others' estimates rest, and one own component after the other moves, so that the own block
    of dF is known at once; the rest of the rows follows from the displacements that the copies cause,
    :func:`~ptne_env.laws.identification.identify`.

    The trust region: the largest own displacement is twice the largest one so far, until a prediction of the own
    gradient fails by more than half of the gradient before; then it is half of the last one.

    Args:
        observation: of R players.
        memory: the parts of :class:`Relay` by name.
        layout: of the observations.
        sources: from which neighbours each component is copied where they are live, shape (R, D, n).
        spread: standard deviation of the rows before anything is identified, in units of gradient per strategy.
        mixes: as for :func:`copies`.

    Returns:
        The displacements Δx^i, shape (R, n), and the memory for the next step.
    """
    model = Model(memory["rows"], memory["covariance"])
    estimate, step = observation.own_estimate, memory["steps"]
    blocks, is_own = layout.own_components[observation.player], layout.own_mask[observation.player]
    outputs, is_whole = blocks.shape[1], model.rows.shape[2] == layout.dimension
    gradient, last_gradient = own_entries(observation.gradient, blocks), memory["gradient"]
    moved = np.where(step == 0, 0.0, estimate - memory["estimate"])
    own_moved = own_entries(moved, blocks)

    scale = _largest(estimate) + _largest(memory["estimate"])
    deviation = RESOLUTION * (_largest(gradient) + _largest(last_gradient) + spread * scale)
    if not is_whole:
        deviation = deviation + spread * _largest(np.where(is_own, 0.0, moved))
    shift = moved if is_whole else own_moved
    model, error, failed = identify(model, shift, gradient - last_gradient, deviation**2)

    length = _largest(own_moved)
    is_bad = failed & (error > _ACCURACY * _largest(last_gradient))
    radius = np.where(is_bad, length / 2, np.maximum(memory["radius"], 2 * length))
    radius = np.maximum(radius, _SHORTEST * _largest(estimate))
    asked = np.abs(memory["asked"])
    held = (np.abs(own_moved) < _HELD * asked) & (asked > _RESOLVED * scale)

    is_probe = step < outputs
    drift, heard = copies(observation, memory, sources, mixes=mixes)
    drift = np.where(is_probe | is_own, 0.0, drift)
    places = blocks if is_whole else np.where(blocks == layout.dimension, outputs, np.arange(outputs))
    shift = drift if is_whole else np.zeros_like(own_moved)
    own_step = best_response(model, gradient, shift, places, held, np.where(is_probe, UNLIMITED, radius))
    own_step = np.where(is_probe & (np.arange(outputs) != step), 0.0, own_step)
    return with_own(drift, own_step, blocks), {
        "rows": model.rows,
        "covariance": model.covariance,
        "estimate": estimate,
        "gradient": gradient,
        "asked": within_reach(own_step, observation, layout),
        "radius": radius,
        "failed": failed.astype(np.float64),
        "steps": step + 1,
        **heard,
    }


def within_reach(displacement: FloatArray, observation: Observation, layout: ObservationLayout) -> FloatArray:
    """Displacements (R, k), clipped to those that the input limit allows in the coming step."""
    reach = layout.action_bound * observation.theta
    return np.clip(displacement, -reach, reach)


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
    interface: ClassVar[Interface] = Interface(graph_knowledge="union")

    def __init__(self, layout: ObservationLayout, spread: float = 10.0) -> None:
        super().__init__(layout)
        self.spread = require_positive("spread", spread)
        self._nearer = self._sources()
        self._parts = Parts(self._shapes())

    def _sources(self) -> BoolArray:
        """From which neighbours each component is copied where they are live, shape (N, D, n)."""
        return nearer_slots(self.layout)

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
        parts = self._parts.zeros(rows)
        _, outputs, regressors = parts["rows"].shape
        parts |= blank(rows, outputs, regressors, self.spread)._asdict()
        parts["least"] += UNLIMITED
        parts["mark"] += UNLIMITED
        return self._parts.join(parts)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = self._parts.split(memory)
        sources = self._nearer[observation.player]
        displacement, parts = relay_displacement(observation, parts, self.layout, sources, self.spread)
        return per_step(displacement, observation), self._parts.join(parts)
