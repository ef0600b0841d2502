"""The relay: best responses from an identified model of the own gradient, and copies of estimates, one link per step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import (
    LARGEST_ROW,
    UNLIMITED,
    best_response,
    largest,
    own_entries,
    own_places,
    trust_radius,
    with_own,
    within_reach,
)
from ptne_env.field.laws.contacts import contact_parts, contacts, noise_level
from ptne_env.field.laws.identification import RESOLUTION, Model, blank, identify
from ptne_env.field.laws.routed import copies
from ptne_env.laws.base import Law, per_step
from ptne_env.laws.memory import Parts
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_positive, row_maxima

SPREAD = 10.0
"""Standard deviation of the entries of dF before anything is identified, in units of gradient per strategy.

1/(3 ``SPREAD``) is the step of the first gradient steps. A tenth and ten times as much give the same digits.
"""

_SIGNAL = 8.0
"""A difference to the neighbours above this many times their smallest change is no noise."""

_HELD = 0.1
"""A component that moved less than this share of the displacement that it was asked for is held by a bound."""

_RESOLVED = 1e-6
"""Smallest displacement, relative to the largest own estimates, at which that is judged."""

_ABOVE_NOISE = 20.0
"""A change of messages above this many times σ_i is no noise: σ_i is the smallest of many changes."""

_LOUDEST = 0.03
"""A change of messages above this share of the largest own estimate is no noise."""


class Averaging(NamedTuple):
    """When and how relays average noisy messages; see :class:`ContactRelay`."""

    patience: float
    forgetting: float


class Own(NamedTuple):
    """The own side of a player: its model of its own gradient, and the limits of its own displacement.

    Attributes:
        model: the identified rows of dF.
        gradient: ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m).
        blocks: own components, padded with n, shape (R, m).
        moved: the last displacement of the estimates, shape (R, n).
        held: own components that a bound holds, shape (R, m).
        radius: of the trust region, shape (R, 1).
        deviation: standard deviation of observed changes of the own gradient, shape (R, 1).
        error: of the last prediction of the own gradient, shape (R, 1).
        failed: whether it failed, shape (R, 1).
        is_probe: whether the own components move one after the other, in the first m steps, shape (R, 1).
        turn: the own components that move in this step, shape (R, m).
    """

    model: Model
    gradient: FloatArray
    blocks: IntArray
    moved: FloatArray
    held: BoolArray
    radius: FloatArray
    deviation: FloatArray
    error: FloatArray
    failed: BoolArray
    is_probe: BoolArray
    turn: BoolArray

    def response(self, drift: FloatArray) -> FloatArray:
        """The best response Δx_i to the own estimates after a displacement ``drift`` (R, n) of the others, (R, m)."""
        outputs, is_whole = self.blocks.shape[1], self.model.rows.shape[2] == drift.shape[1]
        places = own_places(self.blocks, self.model, drift.shape[1])
        shift = drift if is_whole else np.zeros((len(drift), outputs))
        radius = np.where(self.is_probe, UNLIMITED, self.radius)
        step = best_response(self.model, self.gradient, shift, places, self.held, radius)
        return np.where(self.turn, step, 0.0)


def own_side(observation: Observation, memory: Mapping[str, FloatArray], layout: ObservationLayout) -> Own:
    """The own side of R players, from the last displacement and the parts of the memory of :class:`ContactRelay`."""
    model = Model(memory["rows"], memory["covariance"])
    estimate, step = observation.own_estimate, memory["steps"]
    blocks, is_own = layout.own_components[observation.player], layout.own_mask[observation.player]
    outputs, is_whole = blocks.shape[1], model.rows.shape[2] == layout.dimension
    gradient, last_gradient = own_entries(observation.gradient, blocks), memory["gradient"]
    moved = np.where(step == 0, 0.0, estimate - memory["estimate"])
    own_moved = own_entries(moved, blocks)

    scale = largest(estimate) + largest(memory["estimate"])
    deviation = RESOLUTION * (largest(gradient) + largest(last_gradient) + SPREAD * scale)
    if not is_whole:
        deviation = deviation + SPREAD * largest(np.where(is_own, 0.0, moved))
    shift = moved if is_whole else own_moved
    model, error, failed = identify(model, shift, gradient - last_gradient, deviation**2)

    radius = trust_radius(memory["radius"], own_moved, (error, failed), last_gradient, estimate)
    asked = np.abs(own_entries(memory["asked"], blocks))
    held = (np.abs(own_moved) < _HELD * asked) & (asked > _RESOLVED * scale)
    is_probe = step < outputs
    return Own(
        model=model,
        gradient=gradient,
        blocks=blocks,
        moved=moved,
        held=held,
        radius=radius,
        deviation=deviation,
        error=error,
        failed=failed,
        is_probe=is_probe,
        turn=~is_probe | (np.arange(outputs) == step),
    )


def copy_weight(
    observation: Observation, memory: Mapping[str, FloatArray], mean: FloatArray, averaging: Averaging
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The weight w_k of a copy, (R, 1), and the memory: 1 until messages show noise, which never comes to rest.

    Where the smallest change of messages from step to step, σ, has not halved for ``averaging.patience`` steps,
    w_k = p/(p + k) averages over the k steps since, where p is ``averaging.forgetting``. A difference above 8 σ is no
    noise, and starts the count again; so does an eighth of the σ at which it began.

    Args:
        observation: of R players.
        memory: the parts ``heard`` to ``restless`` of :class:`ContactRelay`.
        mean: of the differences to the sources, shape (R, n).
        averaging: of noisy messages.
    """
    live = observation.weights > 0
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    lasts = live & (memory["live"] > 0)
    change = messages - memory["messages"]
    change = np.where(lasts, row_maxima(np.abs(change, out=change)), 0.0)
    change = np.where(lasts.any(axis=1, keepdims=True), largest(change), np.inf)
    least, mark, restless = np.minimum(memory["least"], change), memory["mark"], memory["restless"]
    calmer = least <= mark / np.where(restless > averaging.patience, _SIGNAL, 2.0)
    restless = np.where(calmer | (largest(mean) > _SIGNAL * least), 0.0, restless + 1)
    share = averaging.forgetting / (averaging.forgetting + restless)
    return np.where(restless > averaging.patience, share, 1.0), {
        "heard": np.maximum(memory["heard"], live),
        "live": live.astype(np.float64),
        "messages": messages,
        "least": least,
        "mark": np.where(calmer, least, mark),
        "restless": restless,
    }


def relay_displacement(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    layout: ObservationLayout,
    sources: BoolArray,
    averaging: Averaging,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """w_k × mean of (x^j_c − x^i_c) over the live sources j of c, and the best response to it, :meth:`Own.response`.

    The weight w_k is that of :func:`copy_weight`; a component without a source rests. In the first m steps the others'
    estimates rest, and one own component after the other moves, so that the own block of dF is known at once; the rest
    of the rows follows from the displacements that the copies cause,
    :func:`~ptne_env.field.laws.identification.identify`. After the first m steps, no own displacement is longer than
    :func:`~ptne_env.field.laws.best_response.trust_radius`.

    Args:
        observation: of R players.
        memory: the parts of :class:`ContactRelay` by name.
        layout: of the observations.
        sources: from which neighbours each component is copied where they are live, shape (R, D, n).
        averaging: of noisy messages.

    Returns:
        The displacements Δx^i, shape (R, n), and the memory for the next step.
    """
    own, is_own = own_side(observation, memory, layout), layout.own_mask[observation.player]
    mean = copies(observation, sources)
    weight, heard = copy_weight(observation, memory, mean, averaging)
    drift = np.where(own.is_probe | is_own, 0.0, weight * mean)
    displacement = with_own(drift, own.response(drift), own.blocks)
    return displacement, own_memory(own, observation, memory, displacement, layout) | heard


def own_memory(
    own: Own,
    observation: Observation,
    memory: Mapping[str, FloatArray],
    displacement: FloatArray,
    layout: ObservationLayout,
) -> dict[str, FloatArray]:
    """The parts of the memory of :class:`ContactRelay` that :func:`own_side` reads, after ``displacement`` (R, n)."""
    return {
        "rows": own.model.rows,
        "covariance": own.model.covariance,
        "estimate": observation.own_estimate,
        "gradient": own.gradient,
        "asked": within_reach(displacement, observation, layout),
        "radius": own.radius,
        "failed": own.failed.astype(np.float64),
        "steps": memory["steps"] + 1,
    }


class ContactRelay(Law):
    """Best response from an identified model of the own gradient, and copies hop by hop, :func:`relay_displacement`.

    Players remember their own links, which shows the sources, :func:`~ptne_env.field.laws.contacts.contacts`.

    Args:
        layout: of the environment, interface ``physical``.
        patience: steps in which the smallest change of messages does not halve, > 0, after which it is taken for noise.
        forgetting: p of the weights p/(p + k) of an average over k steps of noisy messages, > 0: larger numbers forget
            the first messages faster. 1 is the mean of all.

    Raises:
        ValueError: for a patience or forgetting that is not positive, or another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout, patience: float = 30.0, forgetting: float = 2.0) -> None:
        super().__init__(layout)
        self.averaging = Averaging(require_positive("patience", patience), require_positive("forgetting", forgetting))
        self._parts = Parts(self._shapes())

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of the memory."""
        outputs, dimension, slots = max(self.layout.action_dims), self.layout.dimension, self.layout.slots
        regressors = dimension if dimension <= LARGEST_ROW else outputs
        return {
            "rows": (outputs, regressors),
            "covariance": (regressors, regressors),
            "estimate": (dimension,),
            "gradient": (outputs,),
            "asked": (dimension,),
            "radius": (1,),
            "failed": (1,),
            "steps": (1,),
            "heard": (slots,),
            "live": (slots,),
            "messages": (slots, dimension),
            "least": (1,),
            "mark": (1,),
            "restless": (1,),
            "noise": (1,),
        } | contact_parts(self.layout)

    def initial_memory(self, rows: int) -> FloatArray:
        """A model of zeros with the standard deviation :data:`SPREAD`, nothing heard, no contact; shape (R, size)."""
        parts = self._parts.zeros(rows)
        _, outputs, regressors = parts["rows"].shape
        parts |= blank(rows, outputs, regressors, SPREAD)._asdict()
        parts["least"] += UNLIMITED
        parts["mark"] += UNLIMITED
        parts["seen"] += np.inf
        return self._parts.join(parts)

    def sources(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[BoolArray, dict[str, FloatArray]]:
        """From which neighbours each component is copied where they are live, and the changed parts of the memory.

        Args:
            observation: of R players.
            memory: the parts of the law's memory by name.

        Returns:
            The sources, shape (R, D, n), and changed parts of the memory that :func:`relay_displacement` leaves alone.
        """
        is_own = self.layout.own_mask[observation.player]
        leaders = self.layout.neighbour_components[observation.player]
        noise = noise_level(observation, memory, leaders | is_own[:, None])
        loudest = np.minimum(_ABOVE_NOISE * noise, _LOUDEST * largest(observation.own_estimate))
        drift = np.where(is_own, 0.0, memory["asked"])
        sources, news = contacts(observation, memory, drift, leaders, loudest[:, :, None])
        return sources, news | {"noise": noise}

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = self._parts.split(memory)
        sources, news = self.sources(observation, parts)
        displacement, fresh = relay_displacement(observation, parts, self.layout, sources, self.averaging)
        return per_step(displacement, observation), self._parts.join(fresh | news)
