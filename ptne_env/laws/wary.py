"""Wary relay: a relay of players that tell moves from noise, and do not copy from a neighbour that misquotes them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray
from ptne_env.laws.relay import LinkRelay
from ptne_env.observation import Observation

_RESOLUTION = 1e-5
"""Relative change of a float32 message above which it has moved, and is not only rounded otherwise."""

_MOVED = 6.0
"""A change of a message above this many times the largest change of messages at rest is a move."""

_MISQUOTED = 4.0
"""An error in a quotation of the own strategy above this many times the largest change of messages at rest is a lie."""

_RECENT = 0.95
"""What remains of an own move after each step, in the sum of recent own moves."""


class WaryRelay(LinkRelay):
    """:class:`~ptne_env.laws.relay.Relay` of players that know their own links alone, among noisy and false messages.

    *Sources.* In the first step, all estimates of others rest, so the change of messages is noise; σ_i is the largest
    one that player i sees. Then the news of each owner spread by one link per step. The first neighbours of which the
    message about component c changes by more than 3 σ_i are nearer to the owner of c, and stay the sources of c. An
    owner is the only source as soon as the player has met it.

    *Trust.* A neighbour j that copies the strategy of player i quotes it one step late: x^j_i(k) = x_i(k − 1). While

        ‖x^j_i(k) − x_i(k − 1)‖_∞ > 4 σ_i + r_i(k),   r_i(k) = 0.95 r_i(k − 1) + ‖x_i(k) − x_i(k − 1)‖_∞,

    player i copies nothing from j but the components that j owns; r_i allows for quotations that are older. All
    neighbours of a lying player find it out in this way, so lies spread only behind a player without which the graph
    falls apart.

    Suited to graphs that stay as they are for an episode: a source whose link goes down is waited for.
    """

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        own = {
            "source": (self.layout.slots, self.layout.dimension),
            "noise": (1,),  # σ_i
            "recent": (1,),  # r_i
        }
        return super()._shapes() | own

    def sources(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[BoolArray, dict[str, FloatArray]]:
        player, step = observation.player, memory["steps"][:, :, None]
        owners, own = self.layout.neighbour_components[player], self.layout.own_mask[player]
        live = (observation.weights > 0)[:, :, None]
        messages = observation.own_estimate[:, None] + observation.relative_estimates
        rounding = _RESOLUTION * np.abs(messages)
        change = np.where(live & (memory["live"] > 0)[:, :, None], np.abs(messages - memory["messages"]), 0.0)

        at_rest = np.where(live, np.where(owners, 0.0, change).max(axis=2, keepdims=True), np.inf)
        noise = np.where(step == 1, at_rest.min(axis=1, keepdims=True), memory["noise"][:, :, None])
        source = memory["source"] > 0
        is_first = ~(source.any(axis=1) | own)[:, None] & (step > 1)
        moved = change > _MOVED * noise + rounding
        source = source | (is_first & moved)
        met = owners & (source | live)
        source = np.where(met.any(axis=1, keepdims=True), met, source)

        last = memory["estimate"]
        move = np.where(own & (step[:, :, 0] > 0), np.abs(observation.own_estimate - last), 0.0)
        recent = _RECENT * memory["recent"] + move.max(axis=1, keepdims=True)
        error = np.where(own[:, None], np.abs(messages - last[:, None]) - rounding, 0.0).max(axis=2, keepdims=True)
        approaches = (moved & own[:, None]).any(axis=2, keepdims=True)
        is_trusted = approaches | (error <= _MISQUOTED * noise + recent[:, :, None])
        return source & (owners | is_trusted), {
            "source": source.astype(np.float64),
            "noise": noise[:, :, 0],
            "recent": recent,
        }
