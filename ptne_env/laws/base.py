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

    A subclass implements :meth:`inputs`, and :meth:`initial_memory` if it has memory: an array with a row per player,
    or a tuple of such arrays and tuples, perhaps a named one.

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
        if memory is None or not self.has_memory:
            return self.initial_memory(rows)
        if (found := _shape(memory)) != (needed := _shape(self._memory_of_one, rows)):
            raise ValueError(
                f"the memory has the shape {found} and these observations need {needed}; pass state=None to start "
                "afresh"
            )
        return self.select_rows(starts, self.initial_memory(rows), memory) if starts.any() else memory

    @cached_property
    def _memory_of_one(self) -> Any:
        return self.initial_memory(1)

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
        return self._memory_of_one is not None


def _shape(memory: Any, rows: int | None = None) -> Any:
    """Return the shapes of the arrays of a memory, or those that they have for so many rows."""
    if isinstance(memory, tuple):
        return tuple(_shape(part, rows) for part in memory)
    shape = np.shape(memory)
    return shape if rows is None else (rows, *shape[1:])


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
