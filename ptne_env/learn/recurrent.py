"""Recurrent policies: a small network for numpy and JAX, and the policy that plays it.

One function computes the network, for numpy, which plays, and for JAX, which trains
(:mod:`ptne_env.training.through_world`). All players, components and neighbours share the weights, and neighbours are
pooled, so one file plays games of any size. The network sees observations in units of σ_i, has a memory, and consists
of generic layers, none of which estimates, identifies or imitates. Two features are computed by hand.

The last axis of an array holds M players, those of all environments. The axes before it are D neighbour slots and n
components, and the first axis holds F features: (F, D, n, M).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptne_env.learn.layers import Weights, apply_weights, update_hidden
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array, array_namespace, ordered_sum, without_gradient

PlayerMemory = dict[str, Any]
"""What players remember: hidden states, and the observation and move of the step before; zeros at a start."""

SLOT_FEATURES, MESSAGE_FEATURES, COMPONENT_FEATURES, PLAYER_FEATURES, OUTPUTS, HEADS = 9, 4, 8, 13, 3, 4

_FACTORS = {"out": 0.1, "out_bias": 0, "query": 0, "message": 0}
"""Factors that scale initial weights. With an unscaled "out", some networks push inputs to their limits, where they
learn nothing for long. With another factor of "message", one training seed in five fell behind by 2 digits."""


class Seen(NamedTuple):
    """What players observe, in natural units.

    Attributes:
        gradient: the own gradient, 0 outside of the own block; shape (n, M).
        relative: the relative estimates x^j − x^i by neighbour slot, (D, n, M).
        live: whether a slot holds a message, (D, M).
        own: whether a component belongs to the player, (n, M).
        leads: whether a component belongs to the neighbour in the slot, (D, n, M).
        strategy: the own strategy, 0 outside of the own block, (n, M).
        clock: t/T, s, Θ_k and Δt_k/T, (4, M).
        age: the time since the last switch, over the mean dwell, (M,).
    """

    gradient: Any
    relative: Any
    live: Any
    own: Any
    leads: Any
    strategy: Any
    clock: Any
    age: Any


def read(layout: ObservationLayout, observations: Any, player: npt.NDArray[np.int64]) -> Seen:
    """Read observations (size, M) of the interface ``physical``; ``player`` holds the index of each player, (M,)."""
    parts = {name: observations[part] for name, part in layout.slices.items()}
    tables = layout.own_mask, layout.neighbour_components, layout.own_places
    own, leads, places = (np.moveaxis(table[player], 0, -1).astype(np.float32, order="C") for table in tables)
    return Seen(
        gradient=ordered_sum(parts["own_gradient"][:, None] * places, 0),
        relative=parts["relative_estimates"].reshape(layout.slots, layout.dimension, -1),
        live=parts["weights"] > 0,
        own=own,
        leads=leads,
        strategy=parts["own_estimate"] * own,
        clock=parts["clock"],
        age=parts["time_since_switch"][0],
    )


def initial_weights(generator: np.random.Generator, hidden: int = 32, slot_hidden: int = 16) -> Weights:
    """Draw the weights of a network.

    Args:
        generator: draws the weights.
        hidden: the number of hidden units per component.
        slot_hidden: the number of hidden units per component of each neighbour.
    """
    return {
        name: (generator.normal(size=shape) / math.sqrt(shape[-1]) * _FACTORS.get(name, 1)).astype(np.float32)
        for name, shape in _weight_shapes(hidden, slot_hidden).items()
    }


def _weight_shapes(hidden: int, slot_hidden: int) -> dict[str, tuple[int, ...]]:
    return {
        "slot_in": (3, slot_hidden, SLOT_FEATURES),
        "neighbour": (3, slot_hidden, 2 * slot_hidden),
        "slot_player": (3, slot_hidden, PLAYER_FEATURES),
        "slot_component": (3, slot_hidden, hidden),
        "slot_again": (3, slot_hidden, slot_hidden),
        "in": (3, hidden, COMPONENT_FEATURES),
        "pooled": (3, hidden, slot_hidden),
        "chosen": (3, hidden, slot_hidden),
        "player": (3, hidden, PLAYER_FEATURES + 2 * hidden),
        "again": (3, hidden, hidden),
        "gate": (1, slot_hidden),
        "out": (OUTPUTS, hidden),
        "key": (HEADS, hidden),
        "query": (HEADS, hidden),
        "out_bias": (OUTPUTS, 1),
        "message": (3, slot_hidden, MESSAGE_FEATURES),
    }


def initial_memory(weights: Weights, slots: int, n: int, players: int, xp: Any = np) -> PlayerMemory:
    """Return the memory of players with so many slots at the start of an episode, in arrays of the library ``xp``."""
    hidden, slot_hidden = weights["again"].shape[-1], weights["slot_again"].shape[-1]
    sizes: dict[str, tuple[int, ...]] = {"hidden": (hidden, n), "slot_hidden": (slot_hidden, slots, n)}
    sizes |= {"relative": (slots, n), "heard": (slots,), "largest": (2,), "log_scale": (), "started": ()}
    sizes |= dict.fromkeys(("gradient", "moved", "strategy", "held"), (n,))
    return {name: xp.zeros((*size, players), dtype=np.float32) for name, size in sizes.items()}


def run_network(
    weights: Weights, layout: ObservationLayout, seen: Seen, memory: PlayerMemory
) -> tuple[Any, PlayerMemory, Any]:
    """Decide for players, from what they have ``seen``, their ``memory`` and the limits of the ``layout``.

    Returns:
        The inputs u in natural units, shape (n, M); the memory for the next step; and the copy gates, the share of the
        difference to each neighbour that a player copies, (D, n, M).
    """
    xp = array_namespace(seen.gradient)
    watched = Seen(*map(without_gradient, seen))
    held, largest = _estimate_walls(watched, memory), _estimate_magnitudes(watched, memory)
    # The unit of costs is no part of what is learned: the largest gradient counts as the largest difference. It is not
    # known from a gradient that is 0 but for rounding, whose quotient is beyond float32.
    is_known = (largest[0] > 0) & (largest[1] > 1e-30 * largest[0])
    unit = xp.where(is_known, largest[0] / xp.where(is_known, largest[1], 1), 1).astype(np.float32)
    scale, nearest, slots, messages, components, players = _compute_features(layout, watched, memory, held, unit)
    hidden, slot_hidden, live = memory["hidden"], memory["slot_hidden"], seen.live[:, None]
    # A neighbour is known by all its messages: on average, and those about the player itself.
    own = seen.own / seen.own.sum(0)
    of_neighbour = [ordered_sum(slot_hidden, 2) / len(own), ordered_sum(slot_hidden * own, 2)]
    slot_inputs = (
        apply_weights(weights["slot_in"], slots)
        + apply_weights(weights["slot_component"], hidden)[:, :, None]
        + apply_weights(weights["slot_player"], players)[:, :, None, None]
        + apply_weights(weights["neighbour"], xp.concatenate(of_neighbour))[:, :, :, None]
        + apply_weights(weights["message"], messages)[:, :, :, None]
    )
    slot_hidden = update_hidden(slot_inputs, weights["slot_again"], slot_hidden)
    logits = xp.where(live, 4 * apply_weights(weights["gate"], slot_hidden)[0], -1e3)
    chances = xp.exp(logits - without_gradient(logits.max(0))) * live
    attention = chances / xp.maximum(ordered_sum(chances, 0), 1.0)  # the sum is at least 1 if any is live
    count = xp.maximum(live.sum(0), 1).astype(np.float32)
    pooled, chosen = ordered_sum(slot_hidden * live, 1) / count, ordered_sum(slot_hidden * attention, 1)
    context = [ordered_sum(hidden, 1) / len(own), ordered_sum(hidden * own, 1)]
    inputs = (
        apply_weights(weights["in"], components)
        + apply_weights(weights["pooled"], pooled)
        + apply_weights(weights["chosen"], chosen)
        + apply_weights(weights["player"], xp.concatenate([players, *context]))[:, :, None]
    )
    hidden = update_hidden(inputs, weights["again"], hidden)
    amplitude, rate, free = apply_weights(weights["out"], hidden) + weights["out_bias"][:, :, None]
    gates = (1 + xp.tanh(amplitude)) * attention
    step = 0.3 * xp.exp(xp.clip(rate, -7, 3)) * unit * seen.gradient
    wanted = ordered_sum(gates * seen.relative, 0) - step + 0.1 * free * nearest
    # Linear attention: a component follows moves of the others by learned shares of their mean. A factor of 4 lets
    # the shares, 0 at the start, grow as fast as other layers: without it, some training seeds do not get there.
    moves = xp.clip(wanted * (1 - held * seen.own), -3 * scale, 3 * scale)
    news = ordered_sum(xp.tanh(apply_weights(weights["key"], hidden)) * moves, 1) / len(own)
    wanted = wanted + ordered_sum(4 * apply_weights(weights["query"], hidden) * news[:, None], 0)
    theta = xp.maximum(seen.clock[2], 1e-9)
    inputs = xp.clip(wanted / theta, -layout.action_bound, layout.action_bound)
    moved = without_gradient(theta * inputs)
    after = {
        "hidden": hidden,
        "slot_hidden": slot_hidden,
        "gradient": without_gradient(seen.gradient),
        # The last message of each neighbour, from where the player is after this step.
        "relative": without_gradient(xp.where(live, seen.relative, memory["relative"])) - moved,
        "heard": xp.maximum(memory["heard"], seen.live),
        "moved": moved,
        "strategy": without_gradient(seen.strategy),
        "held": held,
        "largest": largest,
        "log_scale": xp.log10(scale),
        "started": xp.ones_like(scale),
    }
    return inputs, after, gates


def _estimate_walls(seen: Seen, memory: PlayerMemory) -> Any:
    """Estimate by hand where a wall of the box holds the own strategy: less than half of the last move took place."""
    xp = array_namespace(seen.gradient)
    moved, came = memory["moved"] * seen.own, seen.strategy - memory["strategy"]
    is_visible = xp.abs(moved) > 1e-6 * (xp.abs(seen.strategy) + 1e-6)  # in float32; else as before
    held = (came - 0.5 * moved) * xp.sign(moved) < 0
    return xp.where(is_visible, held, memory["held"]).astype(np.float32) * memory["started"]


def _estimate_magnitudes(seen: Seen, memory: PlayerMemory) -> Any:
    """Estimate by hand the units of the world: the largest difference to a neighbour and gradient so far, (2, M).

    Before there is any difference, the own strategy stands for it.
    """
    xp = array_namespace(seen.gradient)
    far, gradient = xp.abs(seen.relative).max((0, 1)), xp.abs(seen.gradient).max(0)
    far = xp.where((far > 0) | (memory["started"] > 0), far, xp.abs(seen.strategy).max(0))
    return xp.maximum(memory["largest"], xp.stack([far, gradient]))


def _compute_features(
    layout: ObservationLayout, seen: Seen, memory: PlayerMemory, held: Any, of_cost: Any
) -> tuple[Any, ...]:
    """Compute two units, (M,), and the features of slots, messages, components and players.

    The shapes of the features are (F, D, n, M), (F, D, M), (F, n, M) and (F, M). One unit is σ_i, the largest gradient
    or difference to a neighbour. The other has the nearest neighbour in its place: a neighbour that lies is far away
    for ever, and in units of σ_i all else would vanish beside it.
    """
    xp = array_namespace(seen.gradient)
    live, started = seen.live.astype(np.float32), memory["started"]
    known, links, own = (live * memory["heard"])[:, None], live.sum(0), seen.own
    # At a wall the gradient does not vanish, and is no measure of the distance to the equilibrium.
    free_gradient, before = (gradient * of_cost * (1 - held) for gradient in (seen.gradient, memory["gradient"]))
    steepest, far = xp.abs(free_gradient).max(0), xp.abs(seen.relative).max(1)
    scale = xp.maximum(xp.maximum(steepest, far.max(0)), 1e-30)
    unit = 1 / scale
    near = xp.where(links > 0, xp.where(seen.live, far, np.float32(np.inf)).min(0), 0)
    nearest = xp.maximum(xp.maximum(steepest, near), 1e-6 * scale)
    relative, change = seen.relative * unit, (seen.relative - memory["relative"]) * known * unit
    gradient, moved = free_gradient * unit, memory["moved"] * unit
    turn = (free_gradient - before) * (unit * started)
    log_scale, theta = xp.log10(scale), xp.maximum(seen.clock[2], 1e-9)
    farthest = xp.log10(layout.input_limit * theta) - log_scale
    message_range = np.log10(min(layout.message_range, 1e6)).astype(np.float32) - log_scale
    slots = [relative, _log_magnitude(relative), _squash(change), _log_magnitude(change) * known]
    slots += [live[:, None], known, seen.leads, seen.own, _squash(seen.relative / nearest)]
    # The mean change of all components of a message, and of the sender's own.
    shares = 1 / change.shape[1], seen.leads / xp.maximum(seen.leads.sum(1), 1)[:, None]
    changes = [ordered_sum(change * share, 1) for share in shares]
    messages = [*map(_squash, changes), *(_log_magnitude(each) * known[:, 0] for each in changes)]
    components = [gradient, _log_magnitude(gradient) * own, _squash(turn), _log_magnitude(turn) * own]
    components += [_squash(moved), _log_magnitude(moved), own, _squash(memory["moved"] / nearest)]
    players = [log_scale / 10, xp.clip(log_scale - memory["log_scale"], -1, 1) * started]
    players += [seen.clock[0], seen.clock[1] / (layout.largest_clock[1] or 1.0), xp.log10(theta), seen.age]
    players += [links / 4, xp.clip(farthest, -1, 3) / 2, xp.clip(message_range, 0, 12) / 12, started]
    # The number of players is not among them: networks fail among more players than they were trained with if it is.
    players += [1 / xp.maximum(links, 1), np.float32(1), xp.log10(nearest / scale) / 4]
    shapes = relative.shape, seen.live.shape, gradient.shape, scale.shape
    return (
        scale,
        nearest,
        *(
            xp.stack([xp.broadcast_to(each, shape).astype(np.float32) for each in features])
            for features, shape in zip((slots, messages, components, players), shapes, strict=True)
        ),
    )


def _log_magnitude(array: Any) -> Any:
    """Return log10 |x|, clipped to ±8 and scaled to order one, without its gradient."""
    xp = array_namespace(array)
    return without_gradient(xp.log10(xp.clip(xp.abs(array), 1e-8, 1e8)) / 4 + 1)


def _squash(array: Any) -> Any:
    """Map numbers into ±2, small ones nearly to themselves."""
    xp = array_namespace(array)
    return 2 * xp.tanh(xp.clip(array, -20, 20) / 2)


FEWEST_ROWS, CELLS = 32, 2500
"""The rows of a block whose arrays fit the cache: so many, or more if these have fewer components of messages."""


class RecurrentPolicy(RowPolicy):
    """A recurrent network that numpy runs.

    Attributes:
        name: the name of the file, without its ending.
        interface: ``physical``.
        weights: the weights of the network.
        training: how it was trained; nothing depends on it.

    Raises:
        ValueError: when the weights are not those of such a network.
    """

    interface = Interface("physical")

    def __init__(
        self, name: str, weights: Weights, layout: ObservationLayout | None, training: Mapping[str, Any]
    ) -> None:
        shapes = _weight_shapes(weights["again"].shape[-1], weights["slot_again"].shape[-1])
        if shapes != {name: each.shape for name, each in weights.items()}:
            raise ValueError("its weights have other shapes")
        self.name, self.weights, self.training = name, weights, dict(training)
        self._layout = layout
        self.made_for = {"interface": self.interface} | ({} if layout is None else {"size": layout.size})

    def with_layout(self, layout: ObservationLayout) -> RecurrentPolicy:
        """Return the same policy for an environment of this layout.

        Raises:
            LayoutError: when the layout has another interface.
        """
        other = RecurrentPolicy(self.name, self.weights, layout, self.training)
        return super(RecurrentPolicy, other).with_layout(layout)

    def select_rows(self, mask: BoolArray, fresh: list[PlayerMemory], old: list[PlayerMemory]) -> list[PlayerMemory]:
        """Return the memory with the rows of ``fresh`` in a mask, (R,), and those of ``old`` elsewhere."""
        return [
            {name: np.where(mask[new["rows"]], new[name], before[name]) for name in new}
            for new, before in zip(fresh, old, strict=True)
        ]

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:  # noqa: ARG002 - it is deterministic
        """Return the actions (R, n), and a memory for each block of ``rows`` (M,).

        Its ``gates`` are the shares of the difference to each neighbour that players copied, (D, n, M).

        Raises:
            LayoutError: when the policy was given no layout.
            ValueError: when the memory is that of other players.
        """
        layout = self._layout
        if layout is None:
            raise LayoutError(f"policy {self.name!r} was loaded without a layout: use load(path, env.layout)")
        player, n = rows[:, layout.slices["player"]].argmax(1), layout.dimension
        blocks = _split(np.maximum(layout.filled_slots.sum(axis=1), 1)[player], n)
        if memory is None:
            memory = [initial_memory(self.weights, slots, n, len(block)) for block, slots in blocks]
        elif [(len(each["heard"]), *each["rows"]) for each in memory] != [(slots, *block) for block, slots in blocks]:
            raise ValueError("the memory is that of other players; pass state=None to start afresh")
        actions, after = np.empty((len(rows), n), np.float32), []
        for (block, slots), before in zip(blocks, memory, strict=True):
            known, begins = before, starts[block]
            if begins.any():
                known = {name: np.where(begins, np.float32(0), each) for name, each in before.items()}
            seen = read(layout, np.ascontiguousarray(rows[block].T), player[block])
            filled = {name: getattr(seen, name)[:slots] for name in ("relative", "live", "leads")}
            inputs, known, gates = run_network(self.weights, layout, seen._replace(**filled), known)
            actions[block] = inputs.T
            after.append(known | {"gates": gates, "rows": block})
        return actions, after


def _split(slots: npt.NDArray[np.int64], n: int) -> list[tuple[npt.NDArray[np.int64], int]]:
    """Split rows into blocks of players with equally many neighbours, since empty slots would take as much time.

    Args:
        slots: the number of slots of each player that are filled, which are the first ones, (R,).
        n: the length of an estimate.
    """
    blocks = []
    for count in np.unique(slots).tolist():
        rows, size = np.flatnonzero(slots == count), max(FEWEST_ROWS, CELLS // (count * n))
        blocks += [(block, count) for block in np.split(rows, range(size, len(rows), size))]
    return blocks
