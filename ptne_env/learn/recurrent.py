"""A recurrent policy: a small network that messages pass through, in numpy and in JAX, its player and its file.

The network is written once, for numpy, which plays, and for JAX, which trains it
(:mod:`ptne_env.training.through_world`). Players, components and neighbours share all weights, and neighbours are
pooled, so one file plays any number of each. It has observations in units of σ_i, memory and generic layers; nothing in
it estimates, identifies or imitates.

The last axis of arrays are M players, of all environments. Before it are n components and D neighbour slots, and before
those the features: (F, D, n, M).
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile

import numpy as np
import numpy.typing as npt

from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import PolicyFileError, RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array, array_namespace, is_numpy, ordered_sum, without_gradient

Weights = dict[str, Any]
"""The weights of a network by name, float32, of numpy or of JAX."""

Memory = dict[str, Any]
"""What players remember: hidden states, and the observation and displacement of the step before; zeros at a start."""

SLOT_FEATURES, MESSAGE_FEATURES, COMPONENT_FEATURES, PLAYER_FEATURES, OUTPUTS, HEADS = 9, 4, 8, 13, 3, 4

_FACTORS = {"out": 0.1, "out_bias": 0, "query": 0, "message": 0}
"""Factors of random weights at the start. With the full "out", some networks push inputs to their limits, where they
learn nothing for long. With another factor of "message", one training seed in five fell behind by 2 digits."""

GIVEN = "knows_costs", "action_repeat"
"""The entries that are not learned."""

MOST_REPEATS = 100
"""Steps for which an action may be held."""


class Seen(NamedTuple):
    """What players observe, in natural units.

    Attributes:
        gradient: of the own cost, 0 outside of the own block, shape (n, M).
        relative: x^j − x^i per neighbour slot, (D, n, M).
        live: whether the slot has a message, (D, M).
        own: whether the component is the player's, (n, M).
        leads: whether it is the neighbour's, (D, n, M).
        strategy: the own one, 0 outside of the own block, (n, M).
        clock: t/T, s, Θ_k and Δt_k/T, (4, M).
        age: time since the last switch over the mean dwell, (M,).
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
    """The content of observations (size, M) of some players (M,), under ``physical``."""
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


def initial_weights(
    generator: np.random.Generator,
    hidden: int = 32,
    slot_hidden: int = 16,
    knows_costs: bool = True,  # noqa: FBT001, FBT002 - by name
    action_repeat: int = 1,
) -> Weights:
    """Random weights of a network with some hidden units per component, and per component of each neighbour.

    A network that knows costs has learned their unit from its worlds. Actions of another do not depend on that unit:
    it counts the largest gradient so far as the largest difference so far. Players decide in every step, or hold each
    action for several.
    """
    weights = {
        name: (generator.normal(size=shape) / math.sqrt(shape[-1]) * _FACTORS.get(name, 1)).astype(np.float32)
        for name, shape in _shapes(hidden, slot_hidden).items()
        if name not in GIVEN
    }
    given = zip(GIVEN, (knows_costs, action_repeat), strict=True)
    return weights | {name: np.full(1, value, dtype=np.float32) for name, value in given}


def _shapes(hidden: int, slot_hidden: int) -> dict[str, tuple[int, ...]]:
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
        **dict.fromkeys(GIVEN, (1,)),
    }


def initial_memory(weights: Weights, layout: ObservationLayout, players: int, xp: Any = np) -> Memory:
    """The memory of players at the start of an episode."""
    n, slots = layout.dimension, layout.slots
    hidden, slot_hidden = weights["again"].shape[-1], weights["slot_again"].shape[-1]
    sizes: dict[str, tuple[int, ...]] = {"hidden": (hidden, n), "slot_hidden": (slot_hidden, slots, n)}
    sizes |= {
        "gradient": (n,),
        "relative": (slots, n),
        "heard": (slots,),
        "moved": (n,),
        "strategy": (n,),
        "held": (n,),
        "largest": (2,),
        "log_scale": (),
        "started": (),
    }
    return {name: xp.zeros((*size, players), dtype=np.float32) for name, size in sizes.items()}


def decide(weights: Weights, layout: ObservationLayout, seen: Seen, memory: Memory) -> tuple[Any, Memory, Any]:
    """Inputs of players, their memory, and the copy gates.

    Args:
        weights: of the network.
        layout: of observations; its limits are known to players.
        seen: the observations.
        memory: of the players.

    Returns:
        Inputs u in natural units, shape (n, M); the memory for the next step; and the share of the difference to
        each neighbour that a player copies, (D, n, M).
    """
    xp = array_namespace(seen.gradient)
    watched = Seen(*map(without_gradient, seen))
    held, largest = _held(watched, memory), _largest(watched, memory)
    is_given = (without_gradient(weights["knows_costs"]) > 0) | (largest.min(0) == 0)
    unit = xp.where(is_given, 1, largest[0] / xp.where(largest[1] > 0, largest[1], 1)).astype(np.float32)
    scale, nearest, slots, messages, components, players = _features(layout, watched, memory, held, unit)
    hidden, slot_hidden, live = memory["hidden"], memory["slot_hidden"], seen.live[:, None]
    # A neighbour is known by all its messages: on average, and those about the player itself.
    own = seen.own / seen.own.sum(0)
    of_neighbour = [ordered_sum(slot_hidden, 2) / len(own), ordered_sum(slot_hidden * own, 2)]
    slot_inputs = (
        _linear(weights["slot_in"], slots)
        + _linear(weights["slot_component"], hidden)[:, :, None]
        + _linear(weights["slot_player"], players)[:, :, None, None]
        + _linear(weights["neighbour"], xp.concatenate(of_neighbour))[:, :, :, None]
        + _linear(weights["message"], messages)[:, :, :, None]
    )
    slot_hidden = _gated(slot_inputs, weights["slot_again"], slot_hidden)
    logits = xp.where(live, 4 * _linear(weights["gate"], slot_hidden)[0], -1e3)
    chances = xp.exp(logits - without_gradient(logits.max(0))) * live
    attention = chances / xp.maximum(ordered_sum(chances, 0), 1.0)  # the sum is at least 1 if any is live
    count = xp.maximum(live.sum(0), 1).astype(np.float32)
    pooled, chosen = ordered_sum(slot_hidden * live, 1) / count, ordered_sum(slot_hidden * attention, 1)
    context = [ordered_sum(hidden, 1) / len(own), ordered_sum(hidden * own, 1)]
    inputs = (
        _linear(weights["in"], components)
        + _linear(weights["pooled"], pooled)
        + _linear(weights["chosen"], chosen)
        + _linear(weights["player"], xp.concatenate([players, *context]))[:, :, None]
    )
    hidden = _gated(inputs, weights["again"], hidden)
    amplitude, rate, free = _linear(weights["out"], hidden) + weights["out_bias"][:, :, None]
    gates = (1 + xp.tanh(amplitude)) * attention
    step = 0.3 * xp.exp(xp.clip(rate, -7, 3)) * unit * seen.gradient
    wanted = ordered_sum(gates * seen.relative, 0) - step + 0.1 * free * nearest
    # Linear attention: a component follows moves of the others by learned shares of their mean. A factor of 4 lets
    # the shares, 0 at the start, grow as fast as other layers: without it, some training seeds do not get there.
    moves = xp.clip(wanted * (1 - held * seen.own), -3 * scale, 3 * scale)
    news = ordered_sum(xp.tanh(_linear(weights["key"], hidden)) * moves, 1) / len(own)
    wanted = wanted + ordered_sum(4 * _linear(weights["query"], hidden) * news[:, None], 0)
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


def _held(seen: Seen, memory: Memory) -> Any:
    """Where a wall of the box held the own strategy (1, else 0): less than half of the last move came about."""
    xp = array_namespace(seen.gradient)
    moved, came = memory["moved"] * seen.own, seen.strategy - memory["strategy"]
    is_visible = xp.abs(moved) > 1e-6 * (xp.abs(seen.strategy) + 1e-6)  # in float32; else as before
    held = (came - 0.5 * moved) * xp.sign(moved) < 0
    return xp.where(is_visible, held, memory["held"]).astype(np.float32) * memory["started"]


def _largest(seen: Seen, memory: Memory) -> Any:
    """The largest difference to a neighbour, or own strategy before there is any, and the largest gradient; (2, M)."""
    xp = array_namespace(seen.gradient)
    far, gradient = xp.abs(seen.relative).max((0, 1)), xp.abs(seen.gradient).max(0)
    far = xp.where((far > 0) | (memory["started"] > 0), far, xp.abs(seen.strategy).max(0))
    return xp.maximum(memory["largest"], xp.stack([far, gradient]))


def _features(layout: ObservationLayout, seen: Seen, memory: Memory, held: Any, of_cost: Any) -> tuple[Any, ...]:
    """Features per slot, (F, D, n, M), message, (F, D, M), component, (F, n, M), and player, after two units, (M,).

    The units are σ_i, the largest difference to a neighbour or gradient, and that to the nearest neighbour. A neighbour
    that lies is far away for ever: in σ_i alone, all else would vanish beside it.
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
    slots = [relative, _magnitude(relative), _soft(change), _magnitude(change) * known]
    slots += [live[:, None], known, seen.leads, seen.own, _soft(seen.relative / nearest)]
    # The mean change of all components of a message, and of the sender's own.
    shares = 1 / change.shape[1], seen.leads / xp.maximum(seen.leads.sum(1), 1)[:, None]
    changes = [ordered_sum(change * share, 1) for share in shares]
    messages = [*map(_soft, changes), *(_magnitude(each) * known[:, 0] for each in changes)]
    components = [gradient, _magnitude(gradient) * own, _soft(turn), _magnitude(turn) * own]
    components += [_soft(moved), _magnitude(moved), own, _soft(memory["moved"] / nearest)]
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


def _magnitude(array: Any) -> Any:
    """The logarithm of |x| in 1e-8 to 1e8, of order one; without gradient."""
    xp = array_namespace(array)
    return without_gradient(xp.log10(xp.clip(xp.abs(array), 1e-8, 1e8)) / 4 + 1)


def _soft(array: Any) -> Any:
    """Numbers within ±2, nearly as they are where they are small."""
    xp = array_namespace(array)
    return 2 * xp.tanh(xp.clip(array, -20, 20) / 2)


def _linear(weight: Any, array: Any) -> Any:
    """The product of a matrix, or of several side by side, with the features of an array (F, ..., M)."""
    matrix = weight.reshape(-1, weight.shape[-1])
    if is_numpy(array):
        # Each player has a product of its own: in a larger one, libraries of linear algebra take other code for the
        # last columns, so that the bits of a player's result would depend on its place.
        of_players = np.ascontiguousarray(np.moveaxis(array, -1, 0)).reshape(array.shape[-1], len(array), -1)
        product = np.ascontiguousarray(np.moveaxis(matrix @ of_players, 0, -1))
    else:
        product = matrix @ array.reshape(len(array), -1)
    return product.reshape(*weight.shape[:-1], *array.shape[1:])


def _gated(inputs: Any, weights: Any, hidden: Any) -> Any:
    """The next hidden state of a gated recurrent unit: what it keeps, what it uses of it, and the new content."""
    xp = array_namespace(hidden)
    keep, use = 0.5 * (1 + xp.tanh((inputs[:2] + _linear(weights[:2], hidden)) / 2))
    return keep * hidden + (1 - keep) * xp.tanh(inputs[2] + _linear(weights[2], use * hidden))


# The player, and its file.

LARGEST_UNPACKED = 16 << 20
"""Bytes of the weights in the largest file that is read; the shipped ones have 80 to 290 kB."""

_METADATA, _VERSION = "metadata", 6


class RecurrentPolicy(RowPolicy):
    """A network that plays, in numpy; see :class:`ptne_env.perception.policy.Policy`.

    Attributes:
        name: of the file, without its ending.
        interface: ``physical``.
        weights: of the network.
        training: how it was trained; nothing depends on it.
    """

    interface = Interface("physical")

    def __init__(
        self, name: str, weights: Weights, layout: ObservationLayout | None, training: Mapping[str, Any]
    ) -> None:
        self.name, self.weights, self.training = name, weights, dict(training)
        self._layout = layout

    @property
    def made_for(self) -> Mapping[str, Any]:
        """The interface, and the length of the observations once the policy has a layout."""
        size = {} if self._layout is None else {"size": self._layout.size}
        return {"interface": self.interface, **size}

    def with_layout(self, layout: ObservationLayout) -> RecurrentPolicy:
        """Return the same policy for an environment of this layout.

        Raises:
            LayoutError: when the layout has another interface.
        """
        other = RecurrentPolicy(self.name, self.weights, layout, self.training)
        return super(RecurrentPolicy, other).with_layout(layout)

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:  # noqa: ARG002 - it is deterministic
        """Return the actions (R, n) and the memory, whose ``gates`` are the shares that players copied, (D, n, R).

        Raises:
            LayoutError: when the policy was given no layout.
        """
        layout = self._layout
        if layout is None:
            raise LayoutError(f"policy {self.name!r} was loaded without a layout: use load(path, env.layout)")
        columns = np.ascontiguousarray(rows.T)
        player = columns[layout.slices["player"]].argmax(0)
        if memory is None:
            memory = initial_memory(self.weights, layout, len(rows))
            shapes = {"waits": (), "inputs": (layout.dimension,), "gates": (layout.slots, layout.dimension)}
            memory |= {name: np.zeros((*shape, len(rows)), dtype=np.float32) for name, shape in shapes.items()}
        elif starts.any():
            memory = {name: np.where(starts, np.float32(0), value) for name, value in memory.items()}
        repeat, waits = float(self.weights["action_repeat"][0]), memory["waits"]
        if not waits.all():
            # Θ_k and Δt_k/T of the steps for which the action is held.
            seen = read(layout, columns, player)
            seen = seen._replace(clock=seen.clock * np.array([[1], [1], [repeat], [repeat]], dtype=np.float32))
            inputs, after, gates = decide(self.weights, layout, seen, memory)
            after |= {"waits": np.full_like(waits, repeat), "inputs": inputs, "gates": gates}
            if waits.any():  # players whose episodes began at other times
                after = {name: np.where(waits > 0, memory[name], value) for name, value in after.items()}
            memory = after
        memory = memory | {"waits": memory["waits"] - 1}
        return memory["inputs"].T.copy(), memory


def seal(weights: Weights, training: Mapping[str, Any]) -> bytes:
    """The content of a policy file: the weights, and a description with their SHA-256."""
    arrays = {name: np.asarray(weights[name], dtype=np.float32) for name in sorted(weights)}
    description = {"version": _VERSION, "sha256": _digest(arrays, training), "training": dict(training)}
    arrays[_METADATA] = np.frombuffer(json.dumps(description).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # its stubs want allow_pickle among them
    return buffer.getvalue()


def open_policy(path: Path, content: bytes) -> RecurrentPolicy:
    """The policy in an ``.npz`` file. Its size is checked before anything is unpacked, and no file executes code.

    Raises:
        PolicyFileError: when the content is damaged, foreign, too large or of another version.
    """
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        _require(size <= LARGEST_UNPACKED, f"it unpacks to more than {LARGEST_UNPACKED >> 20} MiB")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            weights = {name: file[name] for name in file.files}
        description = json.loads(weights.pop(_METADATA).tobytes())
        _require(description["version"] == _VERSION, "it is of another version")
        shapes = _shapes(weights["again"].shape[-1], weights["slot_again"].shape[-1])
        same = shapes == {name: each.shape for name, each in weights.items()}
        _require(same and all(each.dtype == np.float32 for each in weights.values()), "its weights have other shapes")
        _require(_digest(weights, description["training"]) == description["sha256"], "it has another SHA-256")
        _require(all(np.isfinite(each).all() for each in weights.values()), "a weight is not finite")
        is_possible = weights["action_repeat"][0] in range(1, MOST_REPEATS + 1)
        _require(is_possible, f"it holds actions for no number of steps from 1 to {MOST_REPEATS}")
    except Exception as error:  # zip files raise many classes
        raise PolicyFileError(f"{path} is damaged, or no recurrent policy of this library: {error}") from error
    return RecurrentPolicy(path.stem, weights, None, description["training"])


def _require(holds: bool, otherwise: str) -> None:  # noqa: FBT001 - private
    if not holds:
        raise ValueError(otherwise)


def _digest(weights: Weights, training: Any) -> str:
    described = json.dumps(training, sort_keys=True).encode()
    return sha256(b"".join([described, *(weights[name].tobytes() for name in sorted(weights))])).hexdigest()
