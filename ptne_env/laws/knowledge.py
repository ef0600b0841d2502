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


def contacts(
    observation: Observation, memory: Mapping[str, FloatArray], leaders: BoolArray, nearer: FloatArray
) -> tuple[BoolArray, dict[str, FloatArray]]:
    """The neighbours that have fresher copies, as far as own links and memory show which they are.

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
        nearer: by how many links j is nearer to the owner of c than i, NaN where that is unknown, shape (R, D, n). Once
            a nearer neighbour was heard, this counts more than all votes, and during a contact only nearer neighbours
            become sources.

    Returns:
        The sources, shape (R, D, n), and the changed parts of the memory.
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
    heard = memory["heard"][:, :, None] > 0
    nearer = np.where((heard & (nearer > 0)).any(axis=1, keepdims=True), nearer, np.nan)
    judgement = np.where(np.isnan(nearer) | (nearer == 0), votes, nearer)
    both = np.where(judgement == 0, np.abs(theirs) > np.abs(mine), judgement > 0)
    is_newcomer = (memory["steps"][:, :, None] > 0) & (memory["news"] == 0)[:, None]
    fresher = np.where(met, np.where(i_moved & j_moved, both, j_moved & ~i_moved), is_newcomer)
    wakes = live & np.where(starts, fresher, j_moved & (np.abs(drift) <= floor) & ~(nearer <= 0))
    source = np.where(wakes.any(axis=1, keepdims=True), wakes, live & (memory["source"] > 0))
    owners = leaders & (live | heard)
    source = np.where(owners.any(axis=1, keepdims=True), owners & live, source)
    return source, {
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
    def chosen(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[BoolArray, dict[str, FloatArray]]:
        """The sources of each component, shape (R, D, n), and the changed parts of the memory."""

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = self._parts.split(memory)
        sources, fresh = self.chosen(observation, parts)
        displacement, parts = relay_displacement(observation, parts, self.layout, sources, self.spread, mixes=False)
        parts["drift"] = np.where(self.layout.own_mask[observation.player], 0.0, displacement)
        return per_step(displacement, observation), self._parts.join(parts | fresh)

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        return super()._shapes() | {"drift": (self.layout.dimension,)}  # the last moves of the estimates of others


class ContactRelay(ChoosingRelay):
    """:class:`~ptne_env.laws.relay.Relay` of players that know their own links, and remember them, :func:`contacts`."""

    def __init__(self, layout: ObservationLayout, spread: float = 10.0) -> None:
        super().__init__(layout, spread)
        self._nearness = self._distances()

    def _distances(self) -> FloatArray:
        """By how many links the neighbour in slot d of player i is nearer to the owner of c than i, shape (N, D, n)."""
        return np.full((self.layout.num_players, self.layout.slots, self.layout.dimension), np.nan)

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

    def chosen(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[BoolArray, dict[str, FloatArray]]:
        player = observation.player
        return contacts(observation, memory, self.layout.neighbour_components[player], self._nearness[player])


class RouteRelay(ContactRelay):
    """:class:`ContactRelay` of players that know hop counts on the union graph too.

    Raises:
        LayoutError: for a layout without hop counts.
    """

    interface: ClassVar[Interface] = Interface(graph_knowledge="union")

    def _distances(self) -> FloatArray:
        hops = np.repeat(self.layout.hops, self.layout.action_dims, axis=1).astype(np.float64)
        return np.asarray(hops[:, None] - hops[np.array(self.layout.neighbours)])


class FreshestRelay(ChoosingRelay):
    """:class:`~ptne_env.laws.relay.Relay` of players that know the schedule: copies as in :class:`Freshest`.

    Raises:
        LayoutError: for a layout without the schedule.
    """

    interface: ClassVar[Interface] = Interface(graph_knowledge="schedule")

    def __init__(self, layout: ObservationLayout, spread: float = 10.0) -> None:
        super().__init__(layout, spread)
        self._freshest = Freshest(layout)

    def chosen(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[BoolArray, dict[str, FloatArray]]:
        sources, _ = self._freshest.sources(observation, memory["steps"])
        return sources, {}
