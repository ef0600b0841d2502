"""Reference policies for the lower end of every table: no input, and random actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, Float32Array, FloatArray, require_count
from ptne_env.laws.base import Law
from ptne_env.observation import Observation, ObservationLayout


class ZeroInput(Law):
    """u = 0: estimates and strategies stay at the start."""

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return np.zeros_like(observation.gradient), memory


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
