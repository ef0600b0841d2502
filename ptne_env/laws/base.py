"""What every law shares: reading observations, writing actions, and memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, Float32Array, FloatArray
from ptne_env.interface import Layout, Reading


class Law(ABC):
    """A policy built from a layout, acting from observations and its own memory alone.

    Args:
        layout: of the environment's observations, ``env.layout``; either interface.

    Raises:
        ValueError: when the layout's action mode or interface is one through which the law cannot act.
    """

    needs_full_information = False
    """Whether the law is an oracle that reads what no player can see."""

    def __init__(self, layout: Layout) -> None:
        name = type(self).__name__
        if layout.interface.action_mode != "input" and not self._acts_through_gains():
            raise ValueError(f"{name} needs action_mode='input', this layout has {layout.interface.action_mode!r}")
        if self.needs_full_information and layout.interface.kind != "full":
            raise ValueError(f"{name} is an oracle and needs the interface 'full', got {layout.interface.kind!r}")
        self.layout = layout

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: ARG002, FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[Float32Array, Any]:
        """Actions for observations; see :meth:`ptne_env.policy.Policy.predict`. Laws are deterministic.

        Raises:
            ValueError: when observations or memory are not of this law's shape.
        """
        observation = np.asarray(observation)
        single = observation.ndim == 1
        rows = observation[None] if single else observation
        reading = self.layout.read(rows)
        fresh = self._initial_memory(len(rows))
        memory = fresh if state is None or fresh is None else _restart(state, fresh, episode_start)
        inputs, memory = self._inputs(reading, memory)
        actions = self._actions(inputs, reading)
        return (actions[0] if single else actions), memory

    def inputs(self, reading: Reading, memory: Any = None) -> tuple[FloatArray, Any]:
        """What :meth:`predict` decides, in float64 and before the action box; it is what theory computes with.

        Args:
            reading: of R players.
            memory: the law's, as it returned it; a fresh one if left out.

        Returns:
            The inputs u^i in the reading's unit, shape (R, n), and the memory for the next step.
        """
        return self._inputs(reading, self._initial_memory(len(reading.player)) if memory is None else memory)

    @property
    def has_memory(self) -> bool:
        """Whether the law remembers something from step to step, such as gains that adapt."""
        return self._initial_memory(1) is not None

    def initial_memory(self, rows: int) -> Any:
        """A fresh memory for R players, one row each; ``None`` for a law without memory."""
        return self._initial_memory(rows)

    @abstractmethod
    def _inputs(self, reading: Reading, memory: Any) -> tuple[FloatArray, Any]:
        """Inputs u^i in the reading's unit, shape (R, n), and the memory for the next step."""

    def _actions(self, inputs: FloatArray, reading: Reading) -> Float32Array:
        return self.layout.write(inputs, reading)

    def _acts_through_gains(self) -> bool:
        return False

    def _initial_memory(self, rows: int) -> Any:  # noqa: ARG002 - laws with memory use it
        return None


def _restart(memory: Any, fresh: FloatArray, episode_start: BoolArray | None) -> FloatArray:
    """``memory`` with a fresh row wherever an episode starts."""
    if np.shape(memory) != fresh.shape:
        raise ValueError(
            f"the memory has the shape {np.shape(memory)} and these observations need {fresh.shape}; pass "
            "state=None to start afresh"
        )
    if episode_start is None:
        return np.asarray(memory)
    return np.where(np.reshape(episode_start, (len(fresh), *(1,) * (fresh.ndim - 1))), fresh, memory)


def consensus(weights: FloatArray, relative_estimates: FloatArray) -> FloatArray:
    """Σ_j a_ij (x^j − x^i) over neighbour slots: (R, D) and (R, D, n) to (R, n)."""
    return np.einsum("rd,rdn->rn", weights, relative_estimates)
