"""Sensors: the measurement of their own gradients that players observe."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ptne_env.shared import counter_random
from ptne_env.shared.arrays import FloatArray, IntArray, require_non_negative
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import Part


class Sensor(Part, ABC):
    """A map from the own gradients ∂J_i/∂x_i(x^i) to the values that players observe and laws use.

    Equilibrium, costs, regrets and distances, and what oracles observe beside the own gradient, are the true ones.

    Attributes:
        is_random: whether two episodes differ.
    """

    is_random: bool = True

    @abstractmethod
    def read(self, gradients: FloatArray, keys: CounterArray, step: IntArray) -> FloatArray:
        """The measured own gradients, shape (n, B), float64.

        Args:
            gradients: the true own gradients, shape (n, B); never changed in place.
            keys: keys of the random numbers (:mod:`ptne_env.shared.counter_random`), one per environment, shape (B,).
            step: index of the step, shape (B,).
        """


class GradientNoise(Sensor):
    """Normal noise and rounding of each component: y = q(g + (σ + ρ|g|) ξ), ξ ~ N(0, 1), q(z) = Δ round(z/Δ).

    ξ is independent over episodes, steps and components.

    Args:
        std: σ ≥ 0, in the units of the gradient.
        relative: ρ ≥ 0, without a unit.
        width: Δ ≥ 0, in the units of the gradient; 0 rounds nothing.

    Raises:
        ValueError: when a number is negative or not finite.
    """

    def __init__(self, std: float = 0.0, relative: float = 0.0, width: float = 0.0) -> None:
        self.std = require_non_negative("std", std)
        self.relative = require_non_negative("relative", relative)
        self.width = require_non_negative("width", width)
        self.is_random = self.std > 0 or self.relative > 0

    def read(self, gradients: FloatArray, keys: CounterArray, step: IntArray) -> FloatArray:
        """Gradients plus noise, rounded, shape (n, B)."""
        measured = gradients
        if self.is_random:
            components = np.arange(len(gradients), dtype=np.uint64)[:, None]
            counters = step.astype(np.uint64) * np.uint64(len(gradients)) + components
            noise = counter_random.normals(keys, counters)
            measured = gradients + (self.std + self.relative * np.abs(gradients)) * noise
        return measured if self.width == 0 else np.rint(measured / self.width) * self.width
