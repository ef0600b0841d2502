"""The contact relay: best responses from an identified model of the own gradient, and copies, one link per step."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.laws.base import RecordLaw, per_step
from ptne_env.laws.building_blocks.messages import (
    Contacts,
    NeighbourMessages,
    find_sources,
    initial_contacts,
    mean_difference,
    noise_level,
    read_messages,
)
from ptne_env.laws.building_blocks.own_gradient import (
    UNLIMITED,
    OwnMemory,
    initial_own_memory,
    largest,
    observe_own_side,
    with_own,
)
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive, row_maxima

_SIGNAL = 8.0
"""A difference to the neighbours above this many times their smallest change is no noise."""

_ABOVE_NOISE = 20.0
"""A change of messages above this many times σ_i is no noise: σ_i is the smallest of many changes."""

_LOUDEST = 0.03
"""A change of messages above this share of the largest own estimate is no noise."""


class Unrest(NamedTuple):
    """Whether messages come to rest, shapes (R, 1)."""

    least: FloatArray  # the smallest change of messages from step to step
    mark: FloatArray  # the smallest change when the count of steps last began
    steps: FloatArray  # in which messages have not come to rest


def copy_weight(
    messages: NeighbourMessages, was: Unrest, mean: FloatArray, patience: float, forgetting: float
) -> tuple[FloatArray, Unrest]:
    """Return the weight w_k of a copy, (R, 1), and the memory: 1 until messages show noise, which never comes to rest.

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


class ContactRelayMemory(NamedTuple):
    """What R relays remember."""

    steps: FloatArray  # number of steps so far, shape (R, 1)
    own: OwnMemory
    contacts: Contacts
    messages: FloatArray  # of the step before, shape (R, D, n)
    noise: FloatArray  # σ_i, shape (R, 1)
    unrest: Unrest


class ContactRelay(RecordLaw):
    """A law that copies estimates hop by hop, and takes best responses by an identified model of the own gradient.

    A component of another player moves by w_k × mean of (x^j_c − x^i_c) over the live sources j, which
    :func:`~ptne_env.laws.building_blocks.messages.find_sources` finds from own links, with the weight of
    :func:`copy_weight`; without a source it rests. The own strategy answers with the best response to these copies,
    :func:`~ptne_env.laws.building_blocks.own_gradient.best_response`. In the first m steps the others' estimates
    rest, and one own component after the other moves, so that the own block of dF is known at once; the rest of the
    rows follows from the displacements that the copies cause. After the first m steps, no own displacement is longer
    than :func:`~ptne_env.laws.building_blocks.own_gradient.trust_radius`.

    Args:
        layout: the layout of the environment, with the interface ``physical``.
        patience: the number of steps, > 0, after which the smallest change of messages counts as noise if it has not
            halved.
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
        own, contacts = initial_own_memory(layout), initial_contacts(layout)
        self.start = ContactRelayMemory(none, own, contacts, messages, none, unrest)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        layout, was = self.layout, self.unpack(memory)
        is_own, leaders = layout.own_mask[observation.player], layout.neighbour_components[observation.player]
        # The neighbours with fresher copies, for which noise is no news.
        messages = read_messages(observation, was.contacts.live, was.messages)
        noise = noise_level(messages, was.noise, was.steps, leaders | is_own[:, None])
        loudest = np.minimum(_ABOVE_NOISE * noise, _LOUDEST * largest(observation.own_estimate))
        drift = np.where(is_own, 0.0, was.own.asked)
        sources, contacts = find_sources(observation, was.contacts, was.steps > 0, drift, leaders, loudest[:, :, None])
        mean = mean_difference(observation, sources)
        weight, unrest = copy_weight(messages, was.unrest, mean, self.patience, self.forgetting)
        broken = ((was.contacts.heard > 0) & ~messages.live).any(axis=1, keepdims=True)
        own = observe_own_side(observation, was.own, was.steps, layout, broken)
        drift = np.where(own.is_probe | is_own, 0.0, weight * mean)
        displacement = with_own(drift, own.respond(drift), own.blocks)
        last = own.remember(observation, displacement, layout)
        fresh = ContactRelayMemory(was.steps + 1, last, contacts, messages.content, noise, unrest)
        return per_step(displacement, observation), self.pack(fresh)
