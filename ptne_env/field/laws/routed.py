"""Routed laws: each component of the estimates travels from its owner to all other players, one link per step.

They move estimates to their next value within a step, so they count steps and not time. They differ in the neighbours
from which a player copies a component, and so in the knowledge that they need: hop counts on the union graph
(:class:`Routed`), own links (:class:`RoutedUnknown`), or the links of every step (:class:`Freshest`).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from ptne_env.field.laws.best_response import within_reach
from ptne_env.field.laws.contacts import contact_parts, contacts
from ptne_env.laws.base import Law, per_step
from ptne_env.laws.memory import Parts
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, fold, ordered_sum, require_positive


def nearness(layout: ObservationLayout) -> FloatArray:
    """By how many links the neighbour in slot d of player i is nearer to the owner of component c than i, (N, D, n).

    Raises:
        LayoutError: when the layout does not hold hop counts.
    """
    hops = layout.hops[:, _owners(layout)].astype(np.float64)
    return np.asarray(hops[:, None] - hops[np.array(layout.neighbours)])


def nearer_slots(layout: ObservationLayout) -> BoolArray:
    """Whether the neighbour in slot d of player i is nearer than i to the owner of component c, shape (N, D, n).

    Raises:
        LayoutError: when the layout does not hold hop counts.
    """
    return np.asarray(nearness(layout) > 0)


def totals(observation: Observation, sources: BoolArray) -> tuple[FloatArray, IntArray]:
    """Σ_j x^j_c − x^i_c over the live sources j of component c, and their number: shapes (R, n)."""
    live = sources & (observation.weights > 0)[:, :, None]
    total = ordered_sum(np.where(live, observation.relative_estimates, 0.0), axis=1)
    return total, fold(np.add, live.astype(np.int32), axis=1).astype(np.int64)


def copies(observation: Observation, sources: BoolArray) -> FloatArray:
    """Mean of x^j_c − x^i_c over the live sources j of component c, 0 without one; arguments of :func:`routed_inputs`.

    Returns:
        Displacements, shape (R, n).
    """
    total, count = totals(observation, sources)
    return total / np.maximum(count, 1)


def routed_inputs(observation: Observation, sources: BoolArray, step: float | FloatArray) -> FloatArray:
    """x^i_c ← mean of x^j_c over the live sources j of c, else x^i_c; and x^i_i ← x^i_i − η ∂J_i/∂x_i(x^i).

    The whole law, with η = ``step``. A player has no source of its own components. Where the sources are the neighbours
    that are nearer to the owner of c on a fixed graph, x^i_c is the owner's strategy d_ic steps ago, d_ic being the hop
    count: gradient play with delays, x_i(k+1) = x_i(k) − η ∂J_i/∂x_i(x_1(k − d_i1), …, x_N(k − d_iN)).

    Args:
        observation: of R players.
        sources: from which neighbours each component is copied where they are live, shape (R, D, n).
        step: η, one number for all or one per player, shape (R, 1).

    Returns:
        Inputs, shape (R, n).
    """
    return per_step(copies(observation, sources) - step * observation.gradient, observation)


def stamps(live_links: BoolArray) -> IntArray:
    """The instant of the freshest copy of each player's strategy that a player can have.

    Copies travel one live link per instant, t^i_o(k+1) = max over i and its live neighbours j of t^j_o(k), with
    t^o_o(k) = k.

    Args:
        live_links: whether two players are linked at each instant, shape (K+H+1, N, N).

    Returns:
        The instant by holder and owner, −1 where no news has arrived, shape (K+H+1, N, N).
    """
    instants, players = len(live_links), np.arange(live_links.shape[1])
    result = np.full(live_links.shape, -1, dtype=np.int64)
    result[0, players, players] = 0
    for k in range(1, instants):
        before, (holders, neighbours) = result[k - 1], np.nonzero(live_links[k - 1])
        result[k] = before
        if holders.size:  # they are sorted
            linked, first = np.unique(holders, return_index=True)
            heard = np.maximum.reduceat(before[neighbours], first)
            result[k, linked] = np.maximum(before[linked], heard)
        result[k, players, players] = k
    return result


class RoutedLaw(Law):
    """The base class of the routed laws: :func:`routed_inputs` with the sources that a subclass chooses.

    Args:
        layout: of the environment, with the knowledge of the law's interface.
        step: η > 0.

    Raises:
        LayoutError: for a layout without that knowledge.
        ValueError: for a step that is not positive.
    """

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
        super().__init__(layout)
        self.step = require_positive("step", step)

    @abstractmethod
    def sources(self, observation: Observation, memory: Any) -> tuple[BoolArray, Any]:
        """From which neighbours each component is copied where they are live, shape (R, D, n), and the memory."""

    def inputs(self, observation: Observation, memory: Any) -> tuple[FloatArray, Any]:
        sources, memory = self.sources(observation, memory)
        return routed_inputs(observation, sources, self.step), memory


class Routed(RoutedLaw):
    """Copies along shortest paths and a gradient step: the sources are the nearer neighbours, :func:`nearer_slots`."""

    interface: ClassVar[Interface] = Interface("physical", "union")

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
        super().__init__(layout, step)
        self._nearer = nearer_slots(layout)

    def sources(self, observation: Observation, memory: None) -> tuple[BoolArray, None]:
        return self._nearer[observation.player], memory


class RoutedUnknown(RoutedLaw):
    """:class:`Routed` without hop counts: own links show the sources, :func:`~ptne_env.field.laws.contacts.contacts`."""

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
        super().__init__(layout, step)
        links = dict.fromkeys(("live", "heard"), (layout.slots,))
        self._parts = Parts(contact_parts(layout) | links | {"drift": (layout.dimension,), "steps": (1,)})

    def initial_memory(self, rows: int) -> FloatArray:
        """No contact and no step done, shape (R, size)."""
        parts = self._parts.zeros(rows)
        parts["seen"] += np.inf
        return self._parts.join(parts)

    def sources(self, observation: Observation, memory: FloatArray) -> tuple[BoolArray, FloatArray]:
        player, parts = observation.player, self._parts.split(memory)
        leaders, live = self.layout.neighbour_components[player], observation.weights > 0
        sources, fresh = contacts(observation, parts, parts["drift"], leaders)
        sources &= ~self.layout.own_mask[player][:, None]
        fresh["drift"] = within_reach(copies(observation, sources), observation, self.layout)
        fresh |= {"live": live.astype(np.float64), "heard": np.maximum(parts["heard"], live)}
        return sources, self._parts.join(fresh | {"steps": parts["steps"] + 1})


class Freshest(RoutedLaw):
    """Copies of the freshest estimates along time-respecting paths, and a gradient step; the schedule is known.

    The sources of a component are the live neighbours with the copy of the latest instant, :func:`stamps`, if that is
    later than the instant of the own copy. On no schedule can copies along links be fresher. The memory is the number
    of steps done, shape (R, 1). :class:`RoutedUnknown` has the same idea without the schedule.
    """

    interface: ClassVar[Interface] = Interface("physical", "schedule")

    def __init__(self, layout: ObservationLayout, step: float = 0.32) -> None:
        super().__init__(layout, step)
        self._stamps = stamps(layout.live_links)
        self._neighbours, self._owners = np.array(layout.neighbours), _owners(layout)

    def initial_memory(self, rows: int) -> FloatArray:
        """Number of steps done: 0, shape (R, 1)."""
        return np.zeros((rows, 1))

    def sources(self, observation: Observation, memory: FloatArray) -> tuple[BoolArray, FloatArray]:
        player, instant = observation.player, memory[:, 0].astype(np.int64)
        own = self._stamps[instant, player][:, None, self._owners]
        theirs = self._stamps[instant[:, None], self._neighbours[player]][:, :, self._owners]
        theirs = np.where((observation.weights > 0)[:, :, None], theirs, -1)
        return (theirs > own) & (theirs == fold(np.maximum, theirs, axis=1)[:, None]), memory + 1


def _owners(layout: ObservationLayout) -> IntArray:
    """The player that owns each component, shape (n,)."""
    return np.repeat(np.arange(layout.num_players), layout.action_dims)
