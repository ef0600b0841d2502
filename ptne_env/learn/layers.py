"""Networks of layers, feed-forward or with a gated recurrent unit, for numpy and JAX; numpy plays them.

PPO trains them, on JAX (:mod:`ptne_env.training.jax_ppo`), or PPO and SAC of Stable-Baselines3
(:mod:`ptne_env.training.sb3`). The first axis of an array holds F features, the last one M players, those of all
environments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from ptne_env.perception.observation import Interface
from ptne_env.perception.policy import RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array, array_namespace, is_numpy, require_count, require_flag
from ptne_env.shared.names import require_name

Weights = dict[str, Any]
"""The weights of a network by name; float32 arrays of numpy or JAX."""

LAYERS = tuple(f"layer_{number}" for number in range(8))
"""The names of hidden layers, in their order; a network has the first of them. Each has a bias, ``layer_0_bias``."""

ACTIVATIONS = "relu", "tanh"
"""The functions that hidden layers may end with."""


@dataclass(frozen=True)
class Metadata:
    """The description of a network of layers in a policy file.

    Attributes:
        interface: the interface of the policy.
        action_dims: n_i of each player with which it was trained.
        slots: D, the number of neighbour slots per player.
        training: how it was trained, such as scenario, agent-steps, seed and versions; nothing depends on it.
        activation: the function of its hidden layers, one of :data:`ACTIVATIONS`.
        is_squashed: whether the outputs become actions by the hyperbolic tangent, as SAC's do; they are clipped if not.

    Raises:
        ValueError, TypeError: when a value has a wrong type or is out of range.
    """

    interface: Interface
    action_dims: tuple[int, ...]
    slots: int
    training: Mapping[str, Any]
    activation: str = "relu"
    is_squashed: bool = False

    def __post_init__(self) -> None:
        require_count("slots", self.slots, 0)
        for dim in self.action_dims:
            require_count("action_dims", dim, 1)
        require_name("activation", self.activation, ACTIVATIONS)
        require_flag("is_squashed", self.is_squashed)

    def to_dict(self) -> dict[str, Any]:
        """Return the description as a JSON object."""
        interface = self.interface.to_dict()
        return asdict(self) | {"interface": interface["kind"] if interface.keys() == {"kind"} else interface}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Metadata:
        """Read what :meth:`to_dict` returned."""
        interface = data["interface"]
        interface = Interface.from_dict(interface) if isinstance(interface, dict) else Interface(interface)
        return cls(**{**data, "interface": interface, "action_dims": tuple(data["action_dims"])})


def weight_shapes(size: int, hidden: tuple[int, ...], outputs: int, *, recurrent: bool) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the weights of a network by name; if it is recurrent, its last layer is the recurrent one.

    Args:
        size: the length of an observation.
        hidden: the number of units of each layer.
        outputs: the length of an action.
        recurrent: whether the last layer is a gated recurrent unit.
    """
    *sizes, last = size, *hidden
    shapes: dict[str, tuple[int, ...]] = {}
    feed_forward = zip(LAYERS, sizes, [*sizes[1:], *([] if recurrent else [last])], strict=False)
    for name, before, after in feed_forward:
        shapes |= {name: (after, before), f"{name}_bias": (after, 1)}
    if recurrent:
        shapes |= {"in": (3, last, sizes[-1]), "in_bias": (3, last, 1), "again": (3, last, last)}
    return shapes | {"out": (outputs, last), "out_bias": (outputs, 1)}


def is_recurrent(weights: Weights) -> bool:
    """Return whether a network has a memory."""
    return "again" in weights


def read_in(weights: Weights, array: Any, activation: str = "relu") -> Any:
    """Apply what comes before the memory: (F, M) to (units, M), or to the inputs (3, units, M) of a recurrent unit."""
    xp = array_namespace(array)
    for name in takewhile(weights.__contains__, LAYERS):
        array = apply_weights(weights[name], array) + weights[f"{name}_bias"]
        array = xp.tanh(array) if activation == "tanh" else xp.maximum(array, 0)
    return apply_weights(weights["in"], array) + weights["in_bias"] if is_recurrent(weights) else array


def read_out(weights: Weights, hidden: Any) -> Any:
    """Apply the last layer, (units, M) to (outputs, M)."""
    return apply_weights(weights["out"], hidden) + weights["out_bias"]


def run_layers(weights: Weights, observations: Any, memory: Any, activation: str = "relu") -> tuple[Any, Any]:
    """Compute the outputs (outputs, M) from observations (size, M), and the memory (units, M).

    A network without a memory returns ``memory`` as it is.
    """
    hidden = read_in(weights, observations, activation)
    if is_recurrent(weights):
        hidden = memory = update_hidden(hidden, weights["again"], memory)
    return read_out(weights, hidden), memory


def apply_weights(weight: Any, array: Any) -> Any:
    """Multiply a matrix, or several that are stacked, with the features of an array (F, ..., M)."""
    matrix = weight.reshape(-1, weight.shape[-1])
    if is_numpy(array):
        # Each player has a product of its own: in a larger one, libraries of linear algebra take other code for the
        # last columns, so that the bits of a player's result would depend on its place.
        of_players = np.ascontiguousarray(np.moveaxis(array, -1, 0)).reshape(array.shape[-1], len(array), -1)
        product = np.ascontiguousarray(np.moveaxis(matrix @ of_players, 0, -1))
    else:
        product = matrix @ array.reshape(len(array), -1)
    return product.reshape(*weight.shape[:-1], *array.shape[1:])


def update_hidden(inputs: Any, weights: Any, hidden: Any) -> Any:
    """Return the next hidden state of a gated recurrent unit, from its inputs and its weights (3, F, F)."""
    xp = array_namespace(hidden)
    keep, use = 0.5 * (1 + xp.tanh((inputs[:2] + apply_weights(weights[:2], hidden)) / 2))
    return keep * hidden + (1 - keep) * xp.tanh(inputs[2] + apply_weights(weights[2], use * hidden))


class LayeredPolicy(RowPolicy):
    """A network of layers that numpy runs, in environments of the layout in which it was trained.

    Attributes:
        name: the name of the file, without its ending.
        interface: that of the training, in whose units the action box is ±1.
        weights: the weights of the network.
        metadata: the description in the file.

    Raises:
        ValueError: when the weights are not those of a network for this layout.
    """

    def __init__(self, name: str, weights: Weights, metadata: Metadata) -> None:
        self.name, self.weights, self.metadata, self.interface = name, weights, metadata, metadata.interface
        hidden = [len(weights[layer]) for layer in takewhile(weights.__contains__, LAYERS)]
        size = weights["layer_0" if hidden else "in" if is_recurrent(weights) else "out"].shape[-1]
        if is_recurrent(weights):
            hidden.append(weights["again"].shape[-1])
        outputs = sum(metadata.action_dims)
        expected = weight_shapes(size, tuple(hidden), outputs, recurrent=is_recurrent(weights))
        if expected != {name: each.shape for name, each in weights.items()}:
            raise ValueError("its weights have other shapes")
        made_for: Mapping[str, Any] = {name: getattr(metadata, name) for name in ("interface", "action_dims", "slots")}
        self.made_for = {**made_for, "size": size}

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:  # noqa: ARG002 - it is deterministic
        """Return the actions (R, n) and the memory, (R, units); a network without one returns ``memory`` as it is."""
        hidden = None
        if is_recurrent(self.weights):
            if memory is None:
                memory = np.zeros((len(rows), self.weights["again"].shape[-1]), dtype=np.float32)
            hidden = np.ascontiguousarray(np.where(starts[:, None], np.float32(0), memory).T)
        actions, hidden = run_layers(self.weights, np.ascontiguousarray(rows.T), hidden, self.metadata.activation)
        actions = np.tanh(actions) if self.metadata.is_squashed else np.clip(actions, -1, 1)
        return actions.T, memory if hidden is None else np.ascontiguousarray(hidden.T)
