"""Disturbances: pushes of the real strategies."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ptne_env.shared import counter_random
from ptne_env.shared.arrays import FloatArray, IntArray, require_count, require_positive
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import Part


class Disturbance(Part, ABC):
    """A bounded velocity w added to that of the real strategies: dx_i/dt = g(t) u^i_i + w_i, constant over a step.

    Estimates of other players are memory and are not disturbed.

    Attributes:
        is_random: whether two episodes differ.
    """

    is_random: bool = True

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

    Raises:
        ValueError: when the bound is not positive, or the dwell is not a whole number of at least 1.
    """

    def __init__(self, bound: float, dwell: int = 1) -> None:
        self.bound = require_positive("bound", bound)
        self.dwell = require_count("dwell", dwell, 1)

    def velocity(self, keys: CounterArray, step: IntArray, dimension: int) -> FloatArray:
        """The draw for each environment's step, shape (n, B)."""
        draws = (step // self.dwell).astype(np.uint64) * np.uint64(dimension)
        numbers = counter_random.uniforms(keys, draws + np.arange(dimension, dtype=np.uint64)[:, None])
        numbers -= 0.5
        numbers *= 2 * self.bound
        return numbers
