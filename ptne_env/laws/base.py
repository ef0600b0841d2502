"""The base classes of all laws, and the terms that their equations share."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ptne_env.perception.observation import Interface, LayoutError, Observation, ObservationLayout
from ptne_env.perception.policy import RowPolicy, pair
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, is_numpy


class Law(RowPolicy):
    """A policy that is built from a layout, and acts on observations and its own memory alone.

    A subclass implements :meth:`inputs`, and :meth:`initial_memory` if it has memory.

    Args:
        layout: the layout of the environment's observations, ``env.layout``.

    Raises:
        LayoutError: when the law cannot act through the layout's interface, or reads a slice that the layout lacks.
    """

    needs: ClassVar[tuple[str, ...]] = ()
    """Slices that the law reads and only some layouts have."""

    has_gains: ClassVar[bool] = False
    """Whether its memory holds adaptive gains alone; with these frozen, the law is one without memory."""

    interface: ClassVar[Interface] = Interface("physical")
    """The interface that the law uses in comparisons."""

    def __init__(self, layout: ObservationLayout) -> None:
        name = type(self).__name__
        if not isinstance(layout, ObservationLayout):
            raise TypeError(f"{name} is built from a layout, such as env.layout, got a {type(layout).__name__}")
        missing = [need for need in self.needs if need not in layout.slices]
        if missing:
            raise LayoutError(
                f"{name} reads {', '.join(missing)}, which the layout of {layout.interface} lacks; build the "
                f"environment with {self.interface}"
            )
        self.layout, self.made_for = layout, {"size": layout.size}

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:  # noqa: ARG002 - laws are deterministic
        observation = self.layout.read(rows)
        answer = self.inputs(observation, self._restart(memory, starts))
        inputs, memory = pair(answer, f"{type(self).__name__}.inputs returns (inputs, memory)")
        return self.layout.write(inputs, observation), memory

    def _restart(self, memory: Any, starts: BoolArray) -> Any:
        """Return the memory with a fresh row wherever an episode starts."""
        rows = len(starts)
        if memory is None or self._row_shape is None:
            return self.initial_memory(rows)
        needed = (rows, *self._row_shape)
        if np.shape(memory) != needed:
            raise ValueError(
                f"the memory has the shape {np.shape(memory)} and these observations need {needed}; pass "
                "state=None to start afresh"
            )
        if not starts.any():
            return np.asarray(memory)
        return self.select_rows(starts, self.initial_memory(rows), np.asarray(memory))

    @cached_property
    def _row_shape(self) -> tuple[int, ...] | None:
        """The shape of a player's row of the memory; ``None`` for a law without memory."""
        memory = self.initial_memory(1)
        return None if memory is None else memory.shape[1:]

    @abstractmethod
    def inputs(self, observation: Observation, memory: Any) -> tuple[FloatArray, Any]:
        """Return the inputs of the law, in float64 and before the action box clips them.

        Args:
            observation: the observation of R players, parsed.
            memory: what the previous call or :meth:`initial_memory` returned, one row per player.

        Returns:
            The inputs u^i in the unit of the observation, shape (R, n), and the memory for the next step.
        """

    def initial_memory(self, rows: int) -> Any:  # noqa: ARG002 - laws with memory use it
        """Return the memory of R players at the start of an episode, one row each; ``None`` without memory."""
        return None

    @property
    def has_memory(self) -> bool:
        """Whether the law keeps numbers from step to step."""
        return self._row_shape is not None


class RecordLaw(Law):
    """A law whose memory is a record of named arrays, which travels as one flat row per player.

    A subclass sets ``start`` in its constructor.

    Attributes:
        start: the record of one player at the start of an episode: a named tuple of arrays (1, ...) and of such tuples.
    """

    start: tuple[Any, ...]

    def initial_memory(self, rows: int) -> FloatArray:
        """Return the record of the start in every row, shape (R, size)."""
        return np.repeat(self.pack(self.start), rows, axis=0)

    def pack(self, record: tuple[Any, ...]) -> FloatArray:
        """Return the memory (R, size) that holds a record of R players; a new array."""
        parts = [np.asarray(part, dtype=np.float64) for part in _arrays(record)]
        return np.concatenate([part.reshape(len(part), part[:1].size) for part in parts], axis=1)

    def unpack(self, memory: FloatArray) -> Any:
        """Return the record that a memory holds, the inverse of :meth:`pack`; its arrays are views."""
        first = 0

        def take(like: Any) -> Any:
            nonlocal first
            if isinstance(like, tuple):
                return like._make(map(take, like))  # type: ignore[attr-defined]  # a record is a named tuple
            part = memory[:, first : first + like.size].reshape(len(memory), *like.shape[1:])
            first += like.size
            return part

        return take(self.start)


def _arrays(record: tuple[Any, ...]) -> list[Any]:
    """Return the arrays of a record in order."""
    return [array for part in record for array in (_arrays(part) if isinstance(part, tuple) else [part])]


def consensus(weights: FloatArray, relative_estimates: FloatArray) -> FloatArray:
    """Return Σ_j a_ij (x^j − x^i) over neighbour slots: (..., D) and (..., D, n) to (..., n)."""
    if is_numpy(weights):
        return np.einsum("...d,...dn->...n", weights, relative_estimates)
    return (weights[..., None] * relative_estimates).sum(-2)


def step_length(observation: Observation) -> FloatArray:
    """Return Θ_k of the coming step as a divisor, shape (R, 1): infinite at the end, which no action follows."""
    return np.where(observation.theta == 0, np.inf, observation.theta)


def per_step(displacements: FloatArray, observation: Observation) -> FloatArray:
    """Return the inputs Δx/Θ that move estimates by Δx = ``displacements`` (R, n) in the step; 0 at the end."""
    return displacements / step_length(observation)
