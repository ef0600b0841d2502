"""Faults of the players' own devices: pushes of their strategies, and errors of their measured gradients."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ptne_env.shared import counter_random
from ptne_env.shared.arrays import FloatArray, IntArray, require_count, require_non_negative, require_positive
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import Part


class Disturbance(Part, ABC):
    """A bounded velocity w added to that of the real strategies: dx_i/dt = g(t) u^i_i + w_i, constant over a step.

    Estimates of other players are memory and are not disturbed.

    Attributes:
        is_random: whether two episodes differ.
        after_deadline_only: whether w = 0 before the deadline.
    """

    is_random: bool = True
    after_deadline_only: bool = False

    @abstractmethod
    def velocity(self, keys: CounterArray, step: IntArray, dimension: int) -> FloatArray:
        """The velocity w in units of the strategies per second, shape (n, B).

        Args:
            keys: keys of the random numbers (:mod:`ptne_env.shared.counter_random`), one per environment, shape (B,).
            step: index of the step, shape (B,).
            dimension: n.
        """


class UniformDisturbance(Disturbance):
    """The velocity w ~ U(−bound, bound) per component, redrawn every ``dwell`` steps.

    Args:
        bound: > 0, in units of the strategies per second.
        dwell: steps per draw; the number of steps of the episode makes it a constant bias.
        after_deadline_only: whether it starts with the hold phase.

    Raises:
        ValueError: when the bound is not positive, or the dwell is not a whole number of at least 1.
    """

    def __init__(self, bound: float, dwell: int = 1, after_deadline_only: bool = False) -> None:  # noqa: FBT001, FBT002 - parts call with keywords
        self.bound = require_positive("bound", bound)
        self.dwell = require_count("dwell", dwell, 1)
        self.after_deadline_only = bool(after_deadline_only)

    def velocity(self, keys: CounterArray, step: IntArray, dimension: int) -> FloatArray:
        """The draw for each environment's step, shape (n, B)."""
        draws = (step // self.dwell).astype(np.uint64) * np.uint64(dimension)
        numbers = counter_random.uniforms(keys, draws + np.arange(dimension, dtype=np.uint64)[:, None])
        numbers -= 0.5
        numbers *= 2 * self.bound
        return numbers


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
            keys: keys of the random numbers, one per environment, shape (B,).
            step: index of the step, shape (B,).
        """


class GradientNoise(Sensor):
    """Normal noise and rounding of each component: y = q(g + σ ξ), ξ ~ N(0, 1), q(z) = Δ round(z/Δ).

    ξ is independent over episodes, steps and components.

    Args:
        std: σ ≥ 0, in the units of the gradient.
        width: Δ ≥ 0, in the units of the gradient; 0 rounds nothing.

    Raises:
        ValueError: when a number is negative or not finite.
    """

    def __init__(self, std: float = 0.0, width: float = 0.0) -> None:
        self.std = require_non_negative("std", std)
        self.width = require_non_negative("width", width)
        self.is_random = self.std > 0

    def read(self, gradients: FloatArray, keys: CounterArray, step: IntArray) -> FloatArray:
        """Gradients plus noise, rounded, shape (n, B)."""
        measured = gradients
        if self.is_random:
            components = np.arange(len(gradients), dtype=np.uint64)[:, None]
            counters = step.astype(np.uint64) * np.uint64(len(gradients)) + components
            measured = gradients + self.std * counter_random.normals(keys, counters)
        return measured if self.width == 0 else np.rint(measured / self.width) * self.width
