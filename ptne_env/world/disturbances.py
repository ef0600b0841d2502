"""Disturbances: pushes of the real strategies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from ptne_env.shared import counter_random
from ptne_env.shared.arrays import FloatArray, IntArray, require_count, require_positive
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import Part, checked


class Disturbance(Part, ABC):
    """A bounded velocity w added to that of the real strategies: dx_i/dt = g(t) u^i_i + w_i, constant over a step.

    Estimates of other players are memory and are not disturbed.
    """

    is_random: ClassVar[bool] = True
    """Whether two episodes differ."""

    @abstractmethod
    def velocity(self, keys: CounterArray, step: IntArray, dimension: int) -> FloatArray:
        """Return the velocity w in units of the strategies per second, shape (n, B).

        Args:
            keys: keys of the random numbers (:mod:`ptne_env.shared.counter_random`), one per environment, shape (B,).
            step: index of the step, shape (B,).
            dimension: n.
        """


class UniformDisturbance(Disturbance):
    """A velocity w ~ U(−bound, bound) per component, which is drawn anew every ``dwell`` steps.

    Attributes:
        bound: > 0, in units of the strategies per second.
        dwell: steps per draw; the number of steps of the episode makes it a constant bias.
    """

    bound: float = checked(require_positive)
    dwell: int = checked(require_count, 1, default=1)

    def velocity(self, keys: CounterArray, step: IntArray, dimension: int) -> FloatArray:
        draws = (step // self.dwell).astype(np.uint64) * np.uint64(dimension)
        numbers = counter_random.uniforms(keys, draws + np.arange(dimension, dtype=np.uint64)[:, None])
        numbers -= 0.5
        numbers *= 2 * self.bound
        return numbers
