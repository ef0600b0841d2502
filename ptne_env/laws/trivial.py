"""Anchors of every comparison: doing nothing, acting at random, and full information."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, Float32Array, FloatArray, require_count, require_positive
from ptne_env.laws.base import Law
from ptne_env.observation import Interface, Observation, ObservationLayout


class ZeroInput(Law):
    """u = 0: what the start alone is worth."""

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        return np.zeros_like(reading.gradient), memory


class RandomPolicy:
    """Actions drawn uniformly from the action box.

    Args:
        layout: of the environment; any interface and action mode.
        seed: of the policy's own generator.

    Raises:
        ValueError: for a negative seed.
    """

    def __init__(self, layout: ObservationLayout, seed: int = 0) -> None:
        self.layout = layout
        self._generator = np.random.default_rng(require_count("seed", seed, 0))

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,  # noqa: ARG002 - Stable-Baselines3's signature
        deterministic: bool = False,  # noqa: ARG002, FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[Float32Array, Any]:
        """Random actions; see :meth:`ptne_env.policy.Policy.predict`."""
        bound, shape = self.layout.action_bound, (*np.shape(observation)[:-1], self.layout.action_size)
        return self._generator.uniform(-bound, bound, shape).astype(np.float32), state


class CentralisedOracle(Law):
    """Pseudo-gradient play with full information, dx/dτ = −g F(x), under the same input limit as every policy.

    Every player knows the real strategies, moves its estimates onto them within the step and follows F. An oracle: it
    needs the interface ``full``, which ``parallel_env`` refuses, and stands in tables as the upper anchor only.

    Args:
        layout: with the interface ``full``.
        gradient_gain: g > 0.

    Raises:
        ValueError: for another interface, or a gain that is not positive.
    """

    needs_full_information = True
    interface = Interface("full")

    def __init__(self, layout: ObservationLayout, gradient_gain: float = 1.0) -> None:
        super().__init__(layout)
        self.gradient_gain = require_positive("gradient_gain", gradient_gain)

    def _inputs(self, reading: Observation, memory: None) -> tuple[FloatArray, None]:
        over = reading.theta == 0  # the terminal observation, from which nobody acts
        inputs = reading.relative_strategies / np.where(over, np.inf, reading.theta)
        inputs -= self.gradient_gain * reading.pseudo_gradient
        return inputs, memory
