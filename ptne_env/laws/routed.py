"""Routed laws: each component of the estimates travels from its owner to all other players, one link per step.

They move estimates to their next value within a step, so they count steps and not time. They differ in the neighbours
from which a player copies a component, and so in what players must know: hop counts on the union graph
(:class:`Routed`), their own links (:class:`RoutedUnknown`), or the links of every step (:class:`Freshest`).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray, IntArray, require_count, require_positive
from ptne_env.laws.base import Law, per_step
from ptne_env.laws.memory import Parts
from ptne_env.observation import Interface, Observation, ObservationLayout

_RESOLUTION = 1e-5
"""Relative change of a float32 message above which it has moved, and is not only rounded otherwise."""


def nearer_slots(layout: ObservationLayout) -> BoolArray:
    """Whether the neighbour in slot d of player i is nearer than i to the owner of component c, shape (N, D, n).

    Raises:
        LayoutError: when the layout does not hold hop counts.
    """
    hops = layout.hops[:, _owners(layout)]
    return np.asarray(hops[np.array(layout.neighbours)] < hops[:, None])


def routed_inputs(observation: Observation, sources: BoolArray, step: float | FloatArray) -> FloatArray:
    """x^i_c ← mean of x^j_c over the live sources j of c, else x^i_c; and x^i_i ← x^i_i − η ∂J_i/∂x_i(x^i).

    The whole law, with η = ``step``. A player has no source of its own components. Where the sources are the neighbours
    that are nearer to the owner of c on a fixed graph, x^i_c is what the owner had d_ic steps ago, d_ic being the hop
    count: gradient play with delays, x_i(k+1) = x_i(k) − η ∂J_i/∂x_i(x_1(k − d_i1), …, x_N(k − d_iN)).

    Args:
        observation: of R players.
        sources: from which neighbours each component is copied where they are live, shape (R, D, n).
        step: η, one number for all or one per player, shape (R, 1).

    Returns:
        Inputs, shape (R, n).
    """
    live = sources & (observation.weights > 0)[:, :, None]
    total = np.add.reduce(np.where(live, observation.relative_estimates, 0.0), axis=1)
    copies = total / np.maximum(np.add.reduce(live, axis=1), 1)
    return per_step(copies - step * observation.gradient, observation)


def waves(
    observation: Observation, memory: FloatArray, leaders: BoolArray, own: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """The sources that players learn from their own links: the owner of a component, or where it moved first.

    A player holds an estimate until it has met its owner, or sees the component move in a message. So x^j_c moves for
    the first time after news of the owner of c have reached j, and the neighbours where this is seen first are the
    sources of c. They heard of c earlier than the player itself, so copies never go round in circles. As soon as the
    player meets the owner of c, the owner is the only source. On a fixed graph with perfect messages the sources are
    all neighbours that are nearer to the owner of c.

    Args:
        observation: of R players.
        memory: x^j − x^i at the last meeting with j, infinite before the first, and whether j is a source; shape
            (R, 2, D, n).
        leaders: whether j owns c, shape (R, D, n).
        own: whether i owns c, shape (R, n).

    Returns:
        The sources, shape (R, D, n), and the memory.
    """
    seen, known = memory[:, 0], memory[:, 1] > 0
    now = observation.relative_estimates * observation.unit[:, :, None]
    live = (observation.weights > 0)[:, :, None]
    # Estimates that are not copied yet are at rest, so a difference moves as its sender does.
    moved = live & (np.abs(now - seen) > _RESOLUTION * (np.abs(now) + np.abs(seen)))
    unknown = ~(known.any(axis=1) | own)[:, None]
    met = leaders & (known | live)
    sources = np.where(met.any(axis=1, keepdims=True), met, known | (unknown & moved))
    return sources, np.stack([np.where(live, now, seen), sources], axis=1)


def stamps(live_links: BoolArray) -> IntArray:
    """The instant from which the freshest copy of each player's strategy stems that a player can have.

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
        before = result[k - 1]
        heard = np.where(live_links[k - 1][:, :, None], before, -1).max(axis=1)
        result[k] = np.maximum(before, heard)
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

    interface: ClassVar[Interface] = Interface(graph_knowledge="union")

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
        super().__init__(layout, step)
        self._nearer = nearer_slots(layout)

    def sources(self, observation: Observation, memory: None) -> tuple[BoolArray, None]:
        return self._nearer[observation.player], memory


class RoutedUnknown(RoutedLaw):
    """:class:`Routed` without hop counts: players learn their sources from their own links, :func:`waves`.

    A strategy that comes to rest before its news have reached a player never moves again, so the player waits in vain.
    After ``patience`` steps, all players stop learning, and copy each component without a source from all neighbours.

    Args:
        layout: of the environment.
        step: η > 0.
        patience: number of steps, at least 1.

    Raises:
        ValueError: for a step that is not positive, or no patience.
    """

    def __init__(self, layout: ObservationLayout, step: float = 0.3, patience: int = 150) -> None:
        super().__init__(layout, step)
        self.patience = require_count("patience", patience, 1)
        self._parts = Parts({"waves": (2, layout.slots, layout.dimension), "steps": (1,)})

    def initial_memory(self, rows: int) -> FloatArray:
        """No meeting, no source and no step done, shape (R, size)."""
        parts = self._parts.zeros(rows)
        parts["waves"][:, 0] = np.inf
        return self._parts.join(parts)

    def sources(self, observation: Observation, memory: FloatArray) -> tuple[BoolArray, FloatArray]:
        player, parts = observation.player, self._parts.split(memory)
        own = self.layout.own_mask[player]
        sources, learnt = waves(observation, parts["waves"], self.layout.neighbour_components[player], own)
        steps, before = parts["steps"], parts["waves"][:, 1] > 0
        gives_up = (steps >= self.patience)[:, :, None]
        sources = np.where(gives_up, before, sources)
        learnt[:, 1] = sources
        lost = gives_up & ~(sources.any(axis=1) | own)[:, None]
        return sources | lost, self._parts.join({"waves": learnt, "steps": steps + 1})


class Freshest(RoutedLaw):
    """Copies of the freshest estimates along time-respecting paths, and a gradient step; the schedule is known.

    The sources of a component are the live neighbours whose copy stems from the latest instant, :func:`stamps`, if that
    is later than the own copy. No copies along links can be fresher, whatever the schedule. The memory is the number of
    steps done, shape (R, 1). Where the schedule is unknown, the same idea is :class:`RoutedUnknown`.
    """

    interface: ClassVar[Interface] = Interface(graph_knowledge="schedule")

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
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
        return (theirs > own) & (theirs == theirs.max(axis=1, keepdims=True)), memory + 1


def _owners(layout: ObservationLayout) -> IntArray:
    """The player that owns each component, shape (n,)."""
    return np.repeat(np.arange(layout.num_players), layout.action_dims)
