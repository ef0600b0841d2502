"""A policy without sizes: one network decides for every component of every player, in every world.

Estimation is fixed, :class:`~ptne_env.field.laws.gated.GatedLaw`; the network answers its gates. It sees one *cell* at a
time, a component of a player's estimates, and the messages about it. No feature depends on the number of players,
components or neighbours, on a player's index, or on the unit of strategies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ptne_env.field.laws.gated import (
    CellEvidence,
    CellGates,
    Estimates,
    GatedLaw,
    SlotEvidence,
    SlotGates,
    observed_weight,
    observer_gates,
)
from ptne_env.learn import safeguard
from ptne_env.learn.blocks import in_blocks
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray

Network: TypeAlias = Callable[[Float32Array, Float32Array], tuple[Float32Array, Float32Array]]
"""From features of C cells, (C, F), and of their slots, (C, D, S), to their gates, (C, 10) and (C, D, 3), not clipped.

C is a multiple of :data:`~ptne_env.learn.blocks.BLOCK`. The gates stand in the order of their named tuples.
"""

_EXACT, _ROUNDED = 1e-9, 1e-6
"""Distances relative to the largest own estimate that features tell apart from smaller ones: differences that players
observe, and differences of messages from step to step, in which their float32 shows."""

_LARGEST = 1e3
"""Such distances that features tell apart from larger ones."""

_CELL_FLAGS = (
    "own",
    "turn",
    "probing",
    "closing",
    "failed",
    "held",
    "noisy",
    "rounded",
    "broke",
    "trusted",
    "drifting",
    "settled",
)
_CELL_SHARES = ("weight", "damping", "elapsed")
_CELL_DISTANCES = {  # and the smallest of each that is more than rounding
    "gradient": _EXACT,
    "response": _EXACT,
    "noise": _ROUNDED,
    "width": _ROUNDED,
    "belief": _ROUNDED,
    "correction": _EXACT,
    "doubt": _EXACT,
    "push": _EXACT,
}
_CELL_STEPS = ("steps", "restless", "push_steps")
_CELL_NUMBERS = ("sources", "links")
_CELL_RATIOS = (("belief", "noise"), ("correction", "doubt"))

CELL_FEATURES: tuple[str, ...] = (
    *_CELL_FLAGS,
    *_CELL_SHARES,
    "observed_weight",
    *_CELL_DISTANCES,
    *_CELL_STEPS,
    *_CELL_NUMBERS,
    "theta",
    *map("/".join, _CELL_RATIOS),
)
"""Names of the features of a cell, in order, all in [0, 1]; see :func:`features`."""

_SLOT_FLAGS = ("live", "owner", "source", "mature")
_SLOT_STEPS = ("age", "contact", "samples", "lies")
_SLOT_DISTANCES = {"relative": _EXACT, "change": _ROUNDED, "deviation": _ROUNDED, "spread": _ROUNDED}
_SLOT_RATIOS = (("deviation", "spread"),)

SLOT_FEATURES: tuple[str, ...] = (
    *_SLOT_FLAGS,
    "nearer",
    "farther",
    "own",
    *_SLOT_STEPS,
    *_SLOT_DISTANCES,
    *map("/".join, _SLOT_RATIOS),
)
"""Names of the features of a message, in order, all in [0, 1]; see :func:`features`."""

LOW = 0.0
"""The lower bound of every gate."""

HIGH: Mapping[str, float] = {
    name: {"flow": 10.0, "step": 2.0, "diffusion": 10.0}.get(name, 1.0)
    for name in (*CellGates._fields, *SlotGates._fields)
}
"""The upper bound of every gate, of a cell or of a message: 1 of shares."""

_MOST_STEPS = 1e4
"""Steps that a feature tells apart from more."""

_RATIO = 1e3
"""Ratios of distances are told apart from here to its inverse."""

_SHORTEST_STEP = 1e-6
"""Θ_k that a feature tells apart from smaller ones."""


def features(cells: CellEvidence, slots: SlotEvidence) -> tuple[Float32Array, Float32Array]:
    """The features of R players' components and messages, of order one.

    - Flags, shares and ``elapsed`` as they are, and :func:`~ptne_env.field.laws.gated.observed_weight`; ``nearer`` and
      ``farther`` are the signs of the hops.
    - Distances x as (log10(x/scale + 1e-9) + 9)/12, where ``scale`` is the largest own estimate; those that are
      differences of messages from step to step as (log10(x/scale + 1e-6) + 6)/9, and Θ_k from 1e-6 to 1.
    - Numbers of steps as log10(1 + k)/4.
    - Numbers k of live ``sources`` and live ``links`` as k/(1 + k).
    - Ratios of distances as ½ + log10(ratio)/6.

    All are clipped to [0, 1].

    Args:
        cells: evidence on components, shapes (R, n) or (R, 1).
        slots: evidence on messages, shapes (R, D, n) or broadcast to it.

    Returns:
        Features of components in the order of :data:`CELL_FEATURES`, shape (R, n, F), and of messages in the order of
        :data:`SLOT_FEATURES`, shape (R, n, D, S).
    """
    per_scale = (1.0 / np.maximum(cells.scale, 1e-30)).astype(np.float32)

    logarithms = {name: _decades(getattr(cells, name), per_scale, least) for name, least in _CELL_DISTANCES.items()}
    values = {name: getattr(cells, name) for name in (*_CELL_FLAGS, *_CELL_SHARES)}
    values |= {name: _distance(logarithms[name], least) for name, least in _CELL_DISTANCES.items()}
    values |= {name: _count(getattr(cells, name)) for name in _CELL_STEPS}
    values |= {"elapsed": np.clip(cells.elapsed, 0.0, 1.0), "observed_weight": observed_weight(cells)}
    links = slots.live.sum(axis=1)
    values |= {"sources": cells.sources / (1.0 + cells.sources), "links": links / (1.0 + links)}
    values["theta"] = np.clip(1.0 + np.log10(cells.theta + _SHORTEST_STEP) / -np.log10(_SHORTEST_STEP), 0.0, 1.0)
    values |= {f"{over}/{under}": _ratio(logarithms[over], logarithms[under]) for over, under in _CELL_RATIOS}
    cell = _table(values, CELL_FEATURES, cells.own.shape)

    logarithms = {
        name: _decades(np.abs(getattr(slots, name)), per_scale[:, None], least)
        for name, least in _SLOT_DISTANCES.items()
    }
    values = {name: getattr(slots, name) for name in _SLOT_FLAGS}
    values |= {"nearer": slots.nearer > 0, "farther": slots.nearer < 0, "own": cells.own[:, None]}
    values |= {name: _count(getattr(slots, name)) for name in _SLOT_STEPS}
    values |= {name: _distance(logarithms[name], least) for name, least in _SLOT_DISTANCES.items()}
    values |= {f"{over}/{under}": _ratio(logarithms[over], logarithms[under]) for over, under in _SLOT_RATIOS}
    slot = _table(values, SLOT_FEATURES, slots.relative.shape)
    return np.ascontiguousarray(cell.transpose(1, 2, 0)), np.ascontiguousarray(slot.transpose(1, 3, 2, 0))


def _table(values: Mapping[str, npt.NDArray[Any]], names: Sequence[str], shape: tuple[int, ...]) -> Float32Array:
    """Values by name, in order, in one array; writing them one after the other is faster than side by side."""
    table = np.empty((len(names), *shape), dtype=np.float32)
    for part, name in zip(table, names, strict=True):
        part[...] = values[name]
    return table


def _decades(distances: FloatArray, per_scale: Float32Array, least: float) -> Float32Array:
    """log10 of distances relative to the scale, from ``least`` on."""
    with np.errstate(over="ignore"):
        relative = np.minimum(distances.astype(np.float32) * per_scale, np.float32(_LARGEST))
    relative += np.float32(least)
    return np.log(relative, out=relative) * np.float32(1.0 / np.log(10.0))


def _distance(logarithm: Float32Array, least: float) -> Float32Array:
    """0 at ``least``, 1 at the largest distance."""
    decades = np.log10(_LARGEST / least)
    return np.clip((logarithm - np.float32(np.log10(least))) * np.float32(1.0 / decades), 0.0, 1.0)


def _ratio(over: Float32Array, under: Float32Array) -> Float32Array:
    return np.clip(0.5 + (over - under) * np.float32(0.5 / np.log10(_RATIO)), 0.0, 1.0)


def _count(steps: FloatArray) -> Float32Array:
    return np.minimum(np.log1p(steps.astype(np.float32)) * np.float32(1.0 / np.log(_MOST_STEPS)), np.float32(1.0))


class SizeFreePolicy(GatedLaw):
    """A gated law whose gates a network answers; see :class:`ptne_env.perception.policy.Policy`.

    Decisions are row-wise: the network gets whole blocks of cells, so that a cell's gates have the same bits in every
    batch.

    Args:
        layout: of the environment, interface ``physical``.
        network: of the gates; its answers are clipped to [:data:`LOW`, :data:`HIGH`].
        guarded: whether a player whose residual does not shrink follows the gates of
            :class:`~ptne_env.field.laws.gated.ObserverRelay` from then on, see :mod:`~ptne_env.learn.safeguard`.

    Raises:
        LayoutError: for another interface or action mode.

    Attributes:
        interface: of the layout, with the knowledge of graphs that the features show.
    """

    interface: Interface  # type: ignore[misc]  # of each policy: other laws need that of their class

    def __init__(self, layout: ObservationLayout, network: Network, *, guarded: bool = False) -> None:
        self.guarded = guarded
        super().__init__(layout)
        self.interface = layout.interface
        self.network = network

    def gates(self, cells: CellEvidence, slots: SlotEvidence) -> tuple[CellGates, SlotGates]:
        """See :class:`~ptne_env.field.laws.gated.GatedLaw`."""
        cell, slot = features(cells, slots)
        count = cell.shape[0] * cell.shape[1]
        mine, theirs = self.network(
            in_blocks(cell.reshape(count, cell.shape[2])), in_blocks(slot.reshape(count, *slot.shape[2:]))
        )
        return bounded(mine[:count], theirs[:count], cell.shape[:2])

    def judged(self, observation: Observation, memory: FloatArray) -> tuple[Estimates, CellGates, SlotGates]:
        """See :class:`~ptne_env.field.laws.gated.GatedLaw`; with a safeguard, rows that handed over have the law's gates."""
        if not self.guarded:
            return super().judged(observation, memory)
        found, cells, slots = self.perceive(observation, memory)
        gates, slot_gates = self.gates(cells, slots)
        broken = ~safeguard.are_finite(gates, slot_gates)
        parts = self._parts.split(memory)
        handed, changed = safeguard.handing_over(observation, parts, found, cells, self.layout)
        handed, changed["late"] = handed | broken, np.where(broken, safeguard.PATIENCE, changed["late"])
        law, slot_law = observer_gates(cells, slots)
        handed = handed | (cells.probing > 0)  # the law's first moves identify the own block
        gates = CellGates(*(np.where(handed, hand, learned) for hand, learned in zip(law, gates, strict=True)))
        slot_gates = SlotGates(
            *(np.where(handed[:, None], hand, learned) for hand, learned in zip(slot_law, slot_gates, strict=True))
        )
        return found._replace(memory=found.memory | changed), gates, slot_gates

    def has_handed_over(self, memory: FloatArray) -> BoolArray:
        """Which of R players followed the law in the step that left this memory, shape (R,)."""
        if not self.guarded:
            return np.zeros(len(memory), dtype=bool)
        return np.asarray(self._parts.split(memory)["late"][:, 0] >= safeguard.PATIENCE)

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        return super()._shapes() | (safeguard.PARTS if self.guarded else {})


def bounded(cell: npt.NDArray[Any], slot: npt.NDArray[Any], shape: tuple[int, ...]) -> tuple[CellGates, SlotGates]:
    """Answers of any range as gates within their bounds: :data:`LOW` and :data:`HIGH`.

    Args:
        cell: answers on C cells, shape (C, 10).
        slot: answers on their D slots, shape (C, D, 3).
        shape: (R, n) with R n = C.

    Returns:
        Gates of cells, shapes (R, n), and of slots, shapes (R, D, n), float64.
    """
    per_cell = np.moveaxis(cell.reshape(*shape, -1), -1, 0)
    per_slot = slot.reshape(*shape, *slot.shape[1:]).transpose(3, 0, 2, 1)
    return (
        CellGates(*map(_clipped, per_cell, CellGates._fields)),
        SlotGates(*map(_clipped, per_slot, SlotGates._fields)),
    )


def _clipped(gate: npt.NDArray[Any], name: str) -> FloatArray:
    return np.clip(gate, LOW, HIGH[name]).astype(np.float64)
