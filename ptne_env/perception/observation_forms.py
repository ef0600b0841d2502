"""Forms in which environments show observations: the flat vector, or the same numbers as a graph of messages.

A form depends on the layout alone, so a policy that was trained on graphs can make them from flat observations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from gymnasium import spaces

from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import Float32Array

FormName: TypeAlias = Literal["flat", "graph", "padded-graph"]
Shown: TypeAlias = Any
"""A shown observation: an array, a ``GraphInstance`` or a dictionary of arrays."""

_ON_EDGES = ("relative_estimates", "weights")


class ObservationForm(ABC):
    """A form of observations. Make one with :func:`make_form`.

    Args:
        layout: of the flat observations.
        joint: whether an observation holds those of all N players one after the other, else that of one player.

    Attributes:
        layout: as given.
        joint: as given.
        observers: players whose observations stand in one, 1 or N.
    """

    def __init__(self, layout: ObservationLayout, *, joint: bool = False) -> None:
        self.layout, self.joint = layout, joint
        self.observers = layout.num_players if joint else 1

    @abstractmethod
    def space(self) -> spaces.Space[Any]:
        """A new space of shown observations."""

    @abstractmethod
    def show(self, observation: Float32Array) -> Shown:
        """The observation in this form, from a flat one of shape (observers · size,), float32."""


class FlatForm(ObservationForm):
    """The form ``flat``: a vector, one player after the other."""

    def space(self) -> spaces.Box:
        """A Box of shape (observers · size,), float32."""
        box = self.layout.observation_space()
        return spaces.Box(np.tile(box.low, self.observers), np.tile(box.high, self.observers), dtype=np.float32)

    def show(self, observation: Float32Array) -> Float32Array:
        """The observation itself."""
        return observation


class PaddedGraphForm(ObservationForm):
    """The form ``padded-graph``: the graph of messages in arrays of constant shape.

    A node is a player, with those slices of its observation that no edge holds, F numbers. An edge is a message that
    arrived: x^j − x^i and a_ij, n + 1 numbers, from the sender to the receiver. A joint graph has N nodes and the edges
    of all players. The graph of one player has that player as node 0 and the sender in slot d as node d + 1, of which
    it knows the one-hot alone; the other entries are 0.

    Padded edges (a link that is down, a lost message, a player with fewer neighbours) have the mask 0, and their
    entries are 0, as are the nodes of their senders in the graph of one player.

    Attributes:
        nodes: M, nodes of a graph: N if it is joint, else D + 1.
        edges: E, edges of a graph: N·D if it is joint, else D.
        node_size: F.
    """

    def __init__(self, layout: ObservationLayout, *, joint: bool = False) -> None:
        super().__init__(layout, joint=joint)
        players, slots = layout.num_players, layout.slots
        on_edges = np.concatenate([np.arange(layout.size)[layout.slices[name]] for name in _ON_EDGES])
        self._columns = np.setdiff1d(np.arange(layout.size), on_edges)
        self.node_size = len(self._columns)
        self.nodes, self.edges = (players, players * slots) if joint else (slots + 1, slots)
        if joint:
            senders, receivers = np.ravel(layout.neighbours), np.repeat(np.arange(players), slots)
        else:
            senders, receivers = np.arange(1, slots + 1), np.zeros(slots, dtype=np.int64)
        self._links = np.stack([senders, receivers], axis=1)
        # The node of each player's senders, as far as it knows them, (N, D, F).
        one_hot = np.zeros((players, layout.size), dtype=np.float32)
        one_hot[:, layout.slices["player"]] = np.eye(players)
        self._senders = one_hot[:, self._columns][np.array(layout.neighbours)]

    def space(self) -> spaces.Dict:
        """A Dict of the arrays of :meth:`show`."""
        nodes, edges = self.part_spaces()

        def repeated(box: spaces.Box, count: int) -> spaces.Box:
            return spaces.Box(np.tile(box.low, (count, 1)), np.tile(box.high, (count, 1)), dtype=np.float32)

        return spaces.Dict(
            nodes=repeated(nodes, self.nodes),
            edges=repeated(edges, self.edges),
            edge_links=spaces.Box(0, self.nodes - 1, (self.edges, 2), dtype=np.int64),
            edge_mask=spaces.MultiBinary(self.edges),
        )

    def part_spaces(self) -> tuple[spaces.Box, spaces.Box]:
        """New Boxes of one node, shape (F,), and of one edge, shape (n + 1,), float32."""
        layout, box = self.layout, self.layout.observation_space()
        relative, weights = (layout.slices[name].start for name in _ON_EDGES)
        edge = np.append(np.arange(relative, relative + layout.dimension), weights)
        low, high = np.minimum(box.low, 0), np.maximum(box.high, 0)  # padded entries are 0
        node = self._columns
        return (
            spaces.Box(low[node], high[node], dtype=np.float32),
            spaces.Box(low[edge], high[edge], dtype=np.float32),
        )

    def show(self, observation: Float32Array) -> dict[str, Any]:
        """The graphs of flat observations, shape (..., observers · size).

        Returns:
            New arrays: ``nodes`` (..., M, F) and ``edges`` (..., E, n + 1), float32; ``edge_links`` (..., E, 2), int64,
            the nodes of sender and receiver; and ``edge_mask`` (..., E), int8, 1 for a message that arrived.
        """
        layout, batch = self.layout, observation.shape[:-1]
        rows = observation.reshape(*batch, self.observers, layout.size)
        nodes = rows[..., self._columns]
        relative, weights = (layout.select(rows, name).reshape(*batch, self.edges, -1) for name in _ON_EDGES)
        arrived = weights[..., 0] > 0
        if not self.joint:
            player = layout.select(observation, "player").argmax(axis=-1)
            nodes = np.concatenate([nodes, self._senders[player] * arrived[..., None]], axis=-2)
        return {
            "nodes": nodes,
            "edges": np.concatenate([relative, weights], axis=-1),
            "edge_links": np.broadcast_to(self._links, (*batch, *self._links.shape)).copy(),
            "edge_mask": arrived.astype(np.int8),
        }


class GraphForm(ObservationForm):
    """The form ``graph``: Gymnasium's ``GraphInstance``, which is :class:`PaddedGraphForm` without its padding.

    The nodes of one player's graph are the player and the senders whose messages arrived, in the order of the slots.
    """

    def __init__(self, layout: ObservationLayout, *, joint: bool = False) -> None:
        super().__init__(layout, joint=joint)
        self._padded = PaddedGraphForm(layout, joint=joint)

    def space(self) -> spaces.Graph:
        """Gymnasium's ``Graph``."""
        return spaces.Graph(*self._padded.part_spaces())

    def show(self, observation: Float32Array) -> spaces.GraphInstance:
        """The graph of one flat observation, shape (observers · size,): new arrays, ``edge_links`` in int64."""
        padded = self._padded.show(observation)
        arrived = padded["edge_mask"].astype(np.bool_)
        nodes, links = padded["nodes"], padded["edge_links"][arrived]
        if not self.joint:
            nodes = nodes[np.append(True, arrived)]
            links[:, 0] = np.arange(1, len(links) + 1)
        return spaces.GraphInstance(nodes, padded["edges"][arrived], links)


_FORMS: Mapping[str, type[ObservationForm]] = {
    "flat": FlatForm,
    "graph": GraphForm,
    "padded-graph": PaddedGraphForm,
}


def make_form(name: FormName, layout: ObservationLayout, *, joint: bool = False) -> ObservationForm:
    """The form of that name; see :class:`ObservationForm`.

    Raises:
        ValueError: for an unknown name.
    """
    if name not in _FORMS:
        raise ValueError(f"unknown observation {name!r}; choose from {', '.join(get_args(FormName))}")
    return _FORMS[name](layout, joint=joint)
