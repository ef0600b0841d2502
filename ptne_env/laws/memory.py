"""Memories of several parts: one flat row per player, as laws pass it from step to step."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from math import prod

import numpy as np

from ptne_env.shared.arrays import FloatArray


class Parts:
    """The parts of a memory by name.

    Args:
        shapes: of each part, per player.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self._shapes = dict(shapes)
        ends = list(accumulate(prod(shape) for shape in self._shapes.values()))
        self._places = dict(zip(self._shapes, map(slice, [0, *ends], ends), strict=False))
        self._size = ends[-1]

    def split(self, memory: FloatArray) -> dict[str, FloatArray]:
        """The parts of a memory of R players, each of shape (R, ...), as views."""
        return {name: self._part(memory, name) for name in self._shapes}

    def join(self, parts: Mapping[str, FloatArray]) -> FloatArray:
        """The inverse of :meth:`split`, a new array; parts broadcast over their shape."""
        memory = np.empty((max(len(part) for part in parts.values()), self._size))
        for name in self._shapes:
            self._part(memory, name)[...] = parts[name]
        return memory

    def _part(self, memory: FloatArray, name: str) -> FloatArray:
        return memory[:, self._places[name]].reshape(len(memory), *self._shapes[name])

    def zeros(self, rows: int) -> dict[str, FloatArray]:
        """Parts of ``rows`` players, all 0."""
        return {name: np.zeros((rows, *shape)) for name, shape in self._shapes.items()}
