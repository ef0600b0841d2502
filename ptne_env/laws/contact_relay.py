"""The relay: best responses from an identified model of the own gradient, and copies, one link per step."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.laws import contacts
from ptne_env.laws.base import per_step
from ptne_env.laws.best_response import (
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
from ptne_env.laws.identification import RESOLUTION, Model, blank, identify
from ptne_env.laws.memory import RecordLaw
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_positive, row_maxima

SPREAD = 3.0
"""Standard deviation of the entries of dF before anything is identified, in units of the first gradient per largest
estimate: the first step is about a ninth of the largest estimate."""

_BENT = 5.0
"""Multiple of the largest known entry of dF that rounded estimates may meet."""

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


class LastMove(NamedTuple):
    """What R players remember of their own side."""

    model: Model  # the identified rows of dF
    estimate: FloatArray  # own estimates, shape (R, n)
    gradient: FloatArray  # own gradient, shape (R, m)
    asked: FloatArray  # the displacement that was asked for, shape (R, n)
    radius: FloatArray  # of the trust region, shape (R, 1)


def no_move(layout: ObservationLayout) -> LastMove:
    """The own side of one player at the start of an episode: its model is 0, with the deviation 1."""
    outputs, n, none = max(layout.action_dims), layout.dimension, np.zeros((1, 1))
    model = blank(1, outputs, n if n <= LARGEST_ROW else outputs, 1.0)
    return LastMove(model, np.zeros((1, n)), np.zeros((1, outputs)), np.zeros((1, n)), none)


class Own(NamedTuple):
    """The own side of R players: their models of their own gradients, and the limits of their own displacements."""

    model: Model  # the identified rows of dF
    gradient: FloatArray  # ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m)
    blocks: IntArray  # own components, padded with n, shape (R, m)
    moved: FloatArray  # the last displacement of the estimates, shape (R, n)
    held: BoolArray  # own components that a bound holds, shape (R, m)
    radius: FloatArray  # of the trust region, shape (R, 1)
    error: FloatArray  # of the last prediction of the own gradient, shape (R, 1)
    is_probe: BoolArray  # whether the own components move one after the other, in the first m steps, shape (R, 1)
    turn: BoolArray  # the own components that move in this step, shape (R, m)
    is_fixed: BoolArray  # whether no link of the player ever broke, shape (R, 1)

    def response(self, drift: FloatArray) -> FloatArray:
        """The best response Δx_i to the own estimates after a displacement ``drift`` (R, n) of the others, (R, m)."""
        outputs, is_whole = self.blocks.shape[1], self.model.rows.shape[2] == drift.shape[1]
        places = own_places(self.blocks, self.model, drift.shape[1])
        shift = drift if is_whole else np.zeros((len(drift), outputs))
        radius = np.where(self.is_probe, UNLIMITED, self.radius)
        step = best_response(self.model, self.gradient, shift, places, self.held, radius, self.is_fixed)
        return np.where(self.turn, step, 0.0)

    def remembered(self, observation: Observation, displacement: FloatArray, layout: ObservationLayout) -> LastMove:
        """What the next step needs, after ``displacement`` (R, n)."""
        asked = within_reach(displacement, observation, layout)
        return LastMove(self.model, observation.own_estimate, self.gradient, asked, self.radius)


def own_side(
    observation: Observation, was: LastMove, steps: FloatArray, layout: ObservationLayout, broke: FloatArray
) -> Own:
    """The own side of R players, from the last displacement and the number of ``steps`` so far, shape (R, 1)."""
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
    model = Model(
        was.model.rows, was.model.covariance * np.where(steps == 0, _first_spread(gradient, scale), 1.0)[:, :, None]
    )
    model, error, failed = identify(model, shift, gradient - was.gradient, deviation**2)

    radius = trust_radius(was.radius, own_moved, (error, failed), was.gradient, estimate)
    asked = np.abs(own_entries(was.asked, blocks))
    held = (np.abs(own_moved) < _HELD * asked) & (asked > _RESOLVED * scale)
    is_probe = steps < outputs
    turn = ~is_probe | (np.arange(outputs) == steps)
    return Own(model, gradient, blocks, moved, held, radius, error, is_probe, turn, broke == 0)


def _first_spread(gradient: FloatArray, scale: FloatArray) -> FloatArray:
    """The variance of the entries of dF before the first step, from the first gradient (R, m) and estimates, (R, 1)."""
    is_known = (scale > 0) & (gradient != 0).any(axis=1, keepdims=True)
    return (SPREAD * np.where(is_known, largest(gradient) / np.where(scale > 0, scale, 1.0), 1.0)) ** 2


class Unrest(NamedTuple):
    """Whether messages come to rest, shapes (R, 1)."""

    least: FloatArray  # the smallest change of messages from step to step
    mark: FloatArray  # the smallest change when the count of steps last began
    steps: FloatArray  # in which messages have not come to rest


def copy_weight(
    messages: contacts.Messages, was: Unrest, mean: FloatArray, patience: float, forgetting: float
) -> tuple[FloatArray, Unrest]:
    """The weight w_k of a copy, (R, 1), and the memory: 1 until messages show noise, which never comes to rest.

    Where the smallest change of messages from step to step, σ, has not halved for ``patience`` steps, w_k = p/(p + k)
    averages over the k steps since, where p is ``forgetting``. A difference above 8 σ is no noise, and starts the count
    again; so does an eighth of the σ at which it began. ``mean`` (R, n) is that of the differences to the sources.
    """
    change = np.where(messages.lasted, row_maxima(messages.change), 0.0)
    change = np.where(messages.lasted.any(axis=1, keepdims=True), largest(change), np.inf)
    least = np.minimum(was.least, change)
    calmer = least <= was.mark / np.where(was.steps > patience, _SIGNAL, 2.0)
    steps = np.where(calmer | (largest(mean) > _SIGNAL * least), 0.0, was.steps + 1)
    weight = np.where(steps > patience, forgetting / (forgetting + steps), 1.0)
    return weight, Unrest(least, np.where(calmer, least, was.mark), steps)


class Relayed(NamedTuple):
    """What R relays remember."""

    steps: FloatArray  # number of steps so far, shape (R, 1)
    own: LastMove
    contacts: contacts.Contacts
    messages: FloatArray  # of the step before, shape (R, D, n)
    noise: FloatArray  # σ_i, shape (R, 1)
    unrest: Unrest


class ContactRelay(RecordLaw):
    """Best response from an identified model of the own gradient, and copies hop by hop.

    A component of another player moves by w_k × mean of (x^j_c − x^i_c) over the live sources j, which
    :func:`~ptne_env.laws.contacts.contacts` finds from own links, with the weight of :func:`copy_weight`; without
    a source it rests. The own strategy answers with :meth:`Own.response`. In the first m steps the others' estimates
    rest, and one own component after the other moves, so that the own block of dF is known at once; the rest of the
    rows follows from the displacements that the copies cause, :func:`~ptne_env.laws.identification.identify`.
    After the first m steps, no own displacement is longer than
    :func:`~ptne_env.laws.best_response.trust_radius`.

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
        self.patience = require_positive("patience", patience)
        self.forgetting = require_positive("forgetting", forgetting)
        none, messages = np.zeros((1, 1)), np.zeros((1, layout.slots, layout.dimension))
        unrest = Unrest(none + UNLIMITED, none + UNLIMITED, none)
        self.start = Relayed(none, no_move(layout), contacts.no_contacts(layout), messages, none, unrest)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        layout, was = self.layout, self.unpack(memory)
        is_own, leaders = layout.own_mask[observation.player], layout.neighbour_components[observation.player]
        # The neighbours with fresher copies, for which noise is no news.
        messages = contacts.heard_messages(observation, was.contacts.live, was.messages)
        noise = contacts.noise_level(messages, was.noise, was.steps, leaders | is_own[:, None])
        loudest = np.minimum(_ABOVE_NOISE * noise, _LOUDEST * largest(observation.own_estimate))
        drift = np.where(is_own, 0.0, was.own.asked)
        sources, met = contacts.contacts(observation, was.contacts, was.steps > 0, drift, leaders, loudest[:, :, None])
        mean = contacts.copies(observation, sources)
        weight, unrest = copy_weight(messages, was.unrest, mean, self.patience, self.forgetting)
        broken = ((was.contacts.heard > 0) & ~messages.live).any(axis=1, keepdims=True)
        own = own_side(observation, was.own, was.steps, layout, broken.astype(np.float64))
        drift = np.where(own.is_probe | is_own, 0.0, weight * mean)
        displacement = with_own(drift, own.response(drift), own.blocks)
        last = own.remembered(observation, displacement, layout)
        fresh = Relayed(was.steps + 1, last, met, messages.content, noise, unrest)
        return per_step(displacement, observation), self.pack(fresh)
