"""The network of :class:`~ptne_env.learn.size_free.SizeFreePolicy` in torch, with laws among its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import nn

from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES
from ptne_env.shared.arrays import Float32Array

ALWAYS = "1"
"""The name of the constant among the features of a linear map."""

Linear = Mapping[str, Mapping[str, float]]
"""A linear map by gate and feature: the weight of each feature, or the constant, in a gate; others are 0."""

POINTS: Mapping[str, tuple[Linear, Linear]] = {
    "static": ({"flow": {ALWAYS: 1.0}}, {"diffusion": {ALWAYS: 2.0}}),
    "grounded": ({"flow": {ALWAYS: 1.0}}, {"diffusion": {ALWAYS: 2.0, "own": -2.0, "owner": 2.0}}),
    "routed": ({"copies": {ALWAYS: 1.0}, "step": {ALWAYS: 0.3}}, {"copy": {"nearer": 1.0}}),
    "relay": ({"copies": {"weight": 1.0}, "response": {"turn": 1.0}}, {"copy": {"nearer": 1.0}}),
    "observer-relay": (
        {
            "copies": {"observed_weight": 1.0, "broke": 0.07},
            "track": {"drifting": 1.0, "broke": -1.0},
            "belief": {"rounded": 2.0, "noisy": 1.0, "closing": 1.0, "drifting": -3.0, ALWAYS: -1.0},
            "stated": {"rounded": 1.0, "noisy": 1.0, "closing": 1.0, "settled": 1.0, "drifting": -3.0, ALWAYS: -2.0},
            "step": {"failed": 0.1, "noisy": -0.1, "rounded": -0.1, "broke": -0.1},
            "response": {"turn": 1.0},
            "joint": {"trusted": 1.0},
            "push": {"own": 1.0},
            "dither": {"rounded": 1.0, "closing": -1.0},
        },
        {"copy": {"source": 1.0}, "mean": {"source": 1.0, "mature": 0.5}},
    ),
    "contact-relay": ({"copies": {"weight": 1.0}, "response": {"turn": 1.0}}, {"copy": {"source": 1.0}}),
}
"""Laws whose gates are linear in the features, and clipped: maps of the gates of cells and of messages by name.

They are those of :data:`~ptne_env.evaluation.policy_specs.POLICIES`, with the same parameters. ``routed`` and
``relay`` need the interface that declares hop counts.
"""


class GateNetwork(nn.Module):
    """Gates from features: a linear map, and beside it layers of tanh units that cells and messages share.

    Each message about a cell is encoded, and the mean and the maximum of the encodings over live links go to the two
    layers of the cell; a layer of each message then sees its features and the last layer of the cell. So the network
    has no size but the numbers of features and gates.

    Args:
        cell_units: units in each of the two layers of a cell.
        slot_units: units in each of the two layers of a message.
    """

    def __init__(self, cell_units: int = 32, slot_units: int = 16) -> None:
        super().__init__()
        cell, slot = len(CELL_FEATURES), len(SLOT_FEATURES)
        cell_gates, slot_gates = len(CellGates._fields), len(SlotGates._fields)
        self.encoder = nn.Linear(slot, slot_units)
        self.first = nn.Linear(cell + 2 * slot_units, cell_units)
        self.second = nn.Linear(cell_units, cell_units)
        self.cell_head = nn.Linear(cell_units, cell_gates, bias=False)
        self.cell_skip = nn.Linear(cell, cell_gates)
        self.slot_layer = nn.Linear(slot, slot_units)
        self.slot_context = nn.Linear(cell_units, slot_units, bias=False)
        self.slot_head = nn.Linear(slot_units, slot_gates, bias=False)
        self.slot_skip = nn.Linear(slot, slot_gates)
        nn.init.zeros_(self.cell_head.weight)
        nn.init.zeros_(self.slot_head.weight)

    @classmethod
    def of_law(cls, name: str, cell_units: int = 32, slot_units: int = 16) -> GateNetwork:
        """The network that decides as a law of :data:`POINTS`; its layers have random weights and no effect.

        Raises:
            ValueError: for a name that is not there.
        """
        if name not in POINTS:
            raise ValueError(f"no law {name!r} is a point of the network: choose from {', '.join(POINTS)}")
        return cls.linear_point(*POINTS[name], cell_units=cell_units, slot_units=slot_units)

    @classmethod
    def linear_point(cls, cell: Linear, slot: Linear, cell_units: int = 32, slot_units: int = 16) -> GateNetwork:
        """The network with these linear maps, whose layers have random weights and no effect.

        Args:
            cell: of the gates of cells, from :data:`~ptne_env.learn.size_free.CELL_FEATURES` and :data:`ALWAYS`.
            slot: of the gates of messages, from :data:`~ptne_env.learn.size_free.SLOT_FEATURES` and :data:`ALWAYS`.
            cell_units: as for the class.
            slot_units: as for the class.

        Raises:
            ValueError: for a name that is no gate or no feature.
        """
        network = cls(cell_units, slot_units)
        _write(network.cell_skip, cell, CellGates._fields, CELL_FEATURES)
        _write(network.slot_skip, slot, SlotGates._fields, SLOT_FEATURES)
        return network

    def forward(self, cell: torch.Tensor, slot: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Gates that are not clipped: features (C, F) and (C, D, S) to gates (C, 10) and (C, D, 3)."""
        live = slot[:, :, SLOT_FEATURES.index("live"), None]
        heard = torch.tanh(self.encoder(slot)) * live
        mean = heard.sum(dim=1) / live.sum(dim=1).clamp(min=1.0)
        largest = (heard + live).amax(dim=1)  # 0, the least, where no link is live
        hidden = torch.tanh(self.first(torch.cat([cell, mean, largest], dim=1)))
        hidden = torch.tanh(self.second(hidden))
        joined = torch.tanh(self.slot_layer(slot) + self.slot_context(hidden)[:, None])
        return self.cell_skip(cell) + self.cell_head(hidden), self.slot_skip(slot) + self.slot_head(joined)

    def decide(self, cell: Float32Array, slot: Float32Array) -> tuple[Float32Array, Float32Array]:
        """:meth:`forward` of arrays without gradients: a network for ``SizeFreePolicy(layout, network.decide)``."""
        with torch.inference_mode():
            mine, theirs = self(torch.from_numpy(cell), torch.from_numpy(slot))
        return mine.numpy(), theirs.numpy()


def _write(layer: nn.Linear, linear: Linear, gates: Sequence[str], features: Sequence[str]) -> None:
    weights, constants = torch.zeros_like(layer.weight), torch.zeros_like(layer.bias)
    for gate, row in linear.items():
        for feature, weight in row.items():
            if gate not in gates or feature not in (*features, ALWAYS):
                raise ValueError(
                    f"no weight of {feature!r} in {gate!r}: gates are {', '.join(gates)}, features "
                    f"{', '.join(features)} and {ALWAYS!r}"
                )
            place = gates.index(gate)
            if feature == ALWAYS:
                constants[place] = weight
            else:
                weights[place, features.index(feature)] = weight
    with torch.no_grad():
        layer.weight.copy_(weights)
        layer.bias.copy_(constants)
