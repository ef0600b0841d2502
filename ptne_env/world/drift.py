"""Drifts: games whose origin, and with it whose equilibrium, moves during an episode."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from ptne_env.shared import counter_random
from ptne_env.shared.arrays import FloatArray, require_non_negative, require_positive
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import Part


class Drift(Part, ABC):
    """A path δ(t) of the game's origin: F_t(x) = F(x − δ(t)), so the equilibrium at time t is x* + δ(t).

    The games that are played at each instant are :class:`~ptne_env.games.MovedGame`. Only games without a box drift.

    Attributes:
        is_random: whether two episodes differ.
    """

    is_random: bool = True

    @abstractmethod
    def offset(self, keys: CounterArray, t: FloatArray, dimension: int) -> FloatArray:
        """The offset δ(t) in units of the strategies, shape (n, B), float64.

        Args:
            keys: keys of the random numbers (:mod:`ptne_env.shared.counter_random`), one per environment, shape (B,).
            t: physical time in seconds, shape (B,).
            dimension: n.
        """


class _ScaledPath(Drift):
    """δ(t) = a p(t), with a ~ U(−size, size) per component, constant over the episode."""

    def __init__(self, size: float) -> None:
        self._size = size

    def offset(self, keys: CounterArray, t: FloatArray, dimension: int) -> FloatArray:
        """The path times each component's draw, shape (n, B)."""
        unit = 2 * counter_random.uniforms(keys, np.arange(dimension, dtype=np.uint64)[:, None]) - 1
        return self._size * unit * self._path(t)

    @abstractmethod
    def _path(self, t: FloatArray) -> FloatArray:
        """The path p(t), shape (B,)."""


class ConstantVelocity(_ScaledPath):
    """The origin moves with constant velocity between two times: δ(t) = v (min(t, end) − start) for t ≥ start, else 0.

    v ~ U(−speed, speed) per component, drawn per episode.

    Args:
        speed: > 0, in units of the strategies per second.
        start: ≥ 0, in seconds.
        end: > start, in seconds, after which the origin rests; ``None`` for never.

    Raises:
        ValueError: when the speed is not positive, or the times are negative or not in order.
    """

    def __init__(self, speed: float, start: float = 0.0, end: float | None = None) -> None:
        super().__init__(require_positive("speed", speed))
        self.start = require_non_negative("start", start)
        self.end = math.inf if end is None else require_positive("end", end)
        if self.end <= self.start:
            raise ValueError(f"ConstantVelocity needs start < end, got {start!r} and {end!r}")

    def _path(self, t: FloatArray) -> FloatArray:
        return np.clip(t, self.start, self.end) - self.start


class Sinusoid(_ScaledPath):
    """The origin oscillates: δ(t) = a sin(2π t/period), a ~ U(−amplitude, amplitude) per component and episode.

    Args:
        amplitude: > 0, in units of the strategies.
        period: > 0, in seconds.

    Raises:
        ValueError: when a number is not positive.
    """

    def __init__(self, amplitude: float, period: float) -> None:
        super().__init__(require_positive("amplitude", amplitude))
        self.period = require_positive("period", period)

    def _path(self, t: FloatArray) -> FloatArray:
        path: FloatArray = np.sin(2 * np.pi / self.period * t)
        return path
