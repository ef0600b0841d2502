"""The base class of all laws, and the terms that their equations share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ptne_env.perception.observation import Interface, LayoutError, Observation, ObservationLayout
from ptne_env.perception.policy import RowPolicy, pair
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, is_numpy


class Law(RowPolicy):
    """A policy that is built from a layout and acts on observations and its own memory alone.

    A subclass implements :meth:`inputs`, and :meth:`initial_memory` if it has memory.

    Args:
        layout: of the environment's observations, ``env.layout``.

    Raises:
        LayoutError: when the law cannot act through the layout's interface, or reads a slice that the layout lacks.
    """

    needs: ClassVar[tuple[str, ...]] = ()
    """Slices that the law reads and only some layouts have."""

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
        self.layout = layout

    @property
    def made_for(self) -> Mapping[str, Any]:
        return {"size": self.layout.size}

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
        return np.where(starts.reshape(rows, *(1,) * len(self._row_shape)), self.initial_memory(rows), memory)

    @cached_property
    def _row_shape(self) -> tuple[int, ...] | None:
        """The shape of a player's row of the memory; ``None`` for a law without memory."""
        memory = self.initial_memory(1)
        return None if memory is None else memory.shape[1:]

    @abstractmethod
    def inputs(self, observation: Observation, memory: Any) -> tuple[FloatArray, Any]:
        """The law itself, in float64 and before the action box clips.

        Args:
            observation: parsed, of R players.
            memory: as returned by the previous call, or by :meth:`initial_memory`; one row per player.

        Returns:
            The inputs u^i in the observation's unit, shape (R, n), and the memory for the next step.
        """

    def initial_memory(self, rows: int) -> Any:  # noqa: ARG002 - laws with memory use it
        """The memory at the start of an episode for R players, one row each; ``None`` for a law without memory."""
        return None

    @property
    def has_memory(self) -> bool:
        """Whether the law keeps numbers from step to step."""
        return self._row_shape is not None

    def gains(self, memory: Any) -> FloatArray | None:  # noqa: ARG002 - laws whose gains adapt use it
        """The gains that act, from a memory with one row per player; ``None`` for a law without adaptive gains.

        With these gains frozen, the law is one without memory.
        """
        return None


def consensus(weights: FloatArray, relative_estimates: FloatArray) -> FloatArray:
    """Σ_j a_ij (x^j − x^i) over neighbour slots: (..., D) and (..., D, n) to (..., n)."""
    if is_numpy(weights):
        return np.einsum("...d,...dn->...n", weights, relative_estimates)
    return (weights[..., None] * relative_estimates).sum(-2)


def step_length(observation: Observation) -> FloatArray:
    """Θ_k of the coming step as a divisor, shape (R, 1); infinite at the terminal step, which no action follows."""
    return np.where(observation.theta == 0, np.inf, observation.theta)


def per_step(displacements: FloatArray, observation: Observation) -> FloatArray:
    """The inputs Δx/Θ that move estimates by Δx = ``displacements`` (R, n) within the step; 0 at the terminal step."""
    return displacements / step_length(observation)
