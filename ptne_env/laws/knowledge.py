"""Relay with less knowledge and with more: the same best response, and copies from sources that are chosen otherwise.

What players know of the communication graphs decides from whom they copy: hop counts on the union graph in
:class:`~ptne_env.laws.relay.Relay`, their own links without memory in :class:`LinkRelay`, their own links and all that
they saw on them in :class:`ContactRelay`, the links of every step in :class:`FreshestRelay`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray
from ptne_env.laws.base import per_step
from ptne_env.laws.broadcast import IdentifyAndBroadcast
from ptne_env.laws.relay import Relay, relay_displacement
from ptne_env.laws.routed import Freshest
from ptne_env.observation import Interface, Observation, ObservationLayout

_RESOLUTION = 1e-5
"""Relative change of a float32 message above which it has moved, and is not only rounded otherwise."""


def mean_over(chosen: BoolArray, relative: FloatArray) -> FloatArray:
    """The mean of x^j_c − x^i_c over the chosen slots, 0 where there is none: (R, D, n) to (R, n)."""
    return np.add.reduce(np.where(chosen, relative, 0.0), axis=1) / np.maximum(np.add.reduce(chosen, axis=1), 1)


def contacts(
    observation: Observation, memory: Mapping[str, FloatArray], leaders: BoolArray
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The moves of estimates of others to the fresher copies, as far as own links and memory show which they are.

    A *contact* is a time in which a link is live without a break. At its start, player i compares how far its own copy
    of component c and the neighbour's copy have moved since the last contact, at the end of which they knew each other.
    If one of them has moved alone, it is the fresher one, and the neighbour gets a vote for or against it. If both have
    moved, the votes decide; with equal votes, the copy that has moved further. If no contact was before and the player
    has no news of c, it takes the neighbour's copy. During a contact, the neighbour becomes the source when its copy
    moves while the own copy rests. An owner is the only source as soon as the player has met it.

    On a fixed graph with perfect messages the sources are the neighbours that are nearer to the owner, as in
    :class:`~ptne_env.laws.relay.Relay`.

    Args:
        observation: of R players.
        memory: the parts of :class:`ContactRelay` by name.
        leaders: whether j owns c, shape (R, D, n).

    Returns:
        The moves, shape (R, n), and the changed parts of the memory.
    """
    live, before = (observation.weights > 0)[:, :, None], memory["live"][:, :, None] > 0
    relative, drift = observation.relative_estimates * observation.unit[:, :, None], memory["drift"][:, None]
    mine, met = memory["moved"] + drift, np.isfinite(memory["seen"])
    seen = np.where(met, memory["seen"], relative)
    theirs = np.where(met, relative + mine - seen, 0.0)
    floor = _RESOLUTION * (np.abs(relative) + np.abs(mine) + np.abs(seen))
    i_moved, j_moved = np.abs(mine) > floor, np.abs(theirs) > floor
    starts, votes = live & ~before, memory["votes"]
    votes = votes + np.where(starts & met, j_moved.astype(np.int64) - i_moved, 0)
    both = np.where(votes == 0, np.abs(theirs) > np.abs(mine), votes > 0)
    is_newcomer = (memory["steps"][:, :, None] > 0) & (memory["news"] == 0)[:, None]
    fresher = np.where(met, np.where(i_moved & j_moved, both, j_moved & ~i_moved), is_newcomer)
    wakes = live & np.where(starts, fresher, j_moved & (np.abs(drift) <= floor))
    source = np.where(wakes.any(axis=1, keepdims=True), wakes, live & (memory["source"] > 0))
    owners = leaders & (live | (memory["heard"][:, :, None] > 0))
    source = np.where(owners.any(axis=1, keepdims=True), owners & live, source)
    return mean_over(source, observation.relative_estimates), {
        "moved": np.where(live, 0.0, mine),
        "seen": np.where(live, relative, memory["seen"]),
        "source": source.astype(np.float64),
        "votes": votes,
        "news": np.maximum(memory["news"], source.any(axis=1)),
    }


class LinkRelay(Relay):
    """:class:`~ptne_env.laws.relay.Relay` of players that know their own links alone.

    A component is copied from its owner, where this is a neighbour; else it moves to the mean of the own estimate and
    the estimates of all live neighbours.
    """

    interface: ClassVar[Interface] = Interface()

    def _sources(self) -> BoolArray:
        return self.layout.neighbour_components


class LinkBroadcast(IdentifyAndBroadcast):
    """:class:`~ptne_env.laws.broadcast.IdentifyAndBroadcast` of players that know their own links alone."""

    interface: ClassVar[Interface] = Interface(estimates="coded")

    def _sources(self) -> BoolArray:
        return self.layout.neighbour_components


class ChoosingRelay(LinkRelay):
    """The base class of relays that choose the sources anew in every step."""

    @abstractmethod
    def moves(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Δx^i_c of the estimates of others, shape (R, n), and the changed parts of the memory."""

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = self._parts.split(memory)
        moves, fresh = self.moves(observation, parts)
        live = (observation.weights > 0)[:, :, None]
        # To move by Δ is to copy from live neighbours that all send x^i + Δ.
        heard = observation._replace(relative_estimates=np.where(live, moves[:, None], 0.0))
        everyone = np.ones(heard.relative_estimates.shape, dtype=np.bool_)
        displacement, parts = relay_displacement(heard, parts, self.layout, everyone, self.spread)
        parts["drift"] = np.where(self.layout.own_mask[observation.player], 0.0, displacement)
        return per_step(displacement, observation), self._parts.join(parts | fresh)

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        return super()._shapes() | {"drift": (self.layout.dimension,)}  # the last moves of the estimates of others


class ContactRelay(ChoosingRelay):
    """:class:`~ptne_env.laws.relay.Relay` of players that know their own links, and remember them, :func:`contacts`."""

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        n, slots = self.layout.dimension, self.layout.slots
        own = {
            "moved": (slots, n),  # own moves since the last contact
            "seen": (slots, n),  # relative estimates at its end, infinite before the first
            "source": (slots, n),
            "votes": (slots, n),
            "news": (n,),  # of which components
        }
        return super()._shapes() | own

    def initial_memory(self, rows: int) -> FloatArray:
        parts = self._parts.split(super().initial_memory(rows))
        parts["seen"] = np.full_like(parts["seen"], np.inf)
        return self._parts.join(parts)

    def moves(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        return contacts(observation, memory, self.layout.neighbour_components[observation.player])


class FreshestRelay(ChoosingRelay):
    """:class:`~ptne_env.laws.relay.Relay` of players that know the schedule: copies as in :class:`Freshest`.

    Raises:
        LayoutError: for a layout without the schedule.
    """

    interface: ClassVar[Interface] = Interface(graph_knowledge="schedule")

    def __init__(self, layout: ObservationLayout, spread: float = 10.0) -> None:
        super().__init__(layout, spread)
        self._freshest = Freshest(layout)

    def moves(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        sources, _ = self._freshest.sources(observation, memory["steps"])
        return mean_over(sources, observation.relative_estimates), {}
