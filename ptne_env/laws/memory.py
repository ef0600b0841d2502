"""Memories of several parts: one flat row per player, as laws pass it from step to step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.arrays import FloatArray


class Parts:
    """The parts of a memory by name.

    Args:
        shapes: of each part, per player.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self._shapes = dict(shapes)
        ends = np.cumsum([int(np.prod(shape)) for shape in self._shapes.values()])
        self._cuts = ends[:-1]

    def split(self, memory: FloatArray) -> dict[str, FloatArray]:
        """The parts of a memory of R players, each of shape (R, ...)."""
        pieces = np.split(memory, self._cuts, axis=1)
        return {
            name: piece.reshape(len(memory), *shape)
            for (name, shape), piece in zip(self._shapes.items(), pieces, strict=True)
        }

    def join(self, parts: Mapping[str, FloatArray]) -> FloatArray:
        """The inverse of :meth:`split`; parts broadcast over their shape."""
        rows = max(len(part) for part in parts.values())
        pieces = (np.broadcast_to(parts[name], (rows, *shape)) for name, shape in self._shapes.items())
        return np.concatenate([piece.reshape(rows, -1) for piece in pieces], axis=1)

    def zeros(self, rows: int) -> dict[str, FloatArray]:
        """Parts of ``rows`` players, all 0."""
        return {name: np.zeros((rows, *shape)) for name, shape in self._shapes.items()}
