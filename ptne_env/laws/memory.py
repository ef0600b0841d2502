"""Memories as records: named arrays, which travel from step to step as one flat row per player."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from ptne_env.laws.base import Law
from ptne_env.shared.arrays import BoolArray, FloatArray

Record = TypeVar("Record", bound=tuple[Any, ...])


class RecordLaw(Law):
    """A law whose memory is a record. A subclass sets ``start`` when it is made.

    Attributes:
        start: the record of one player at the start of an episode: a named tuple of arrays (1, ...) and of such tuples.
    """

    start: tuple[Any, ...]

    def initial_memory(self, rows: int) -> FloatArray:
        """The record of the start in every row, shape (R, size)."""
        return np.repeat(self.pack(self.start), rows, axis=0)

    def pack(self, record: tuple[Any, ...]) -> FloatArray:
        """The memory (R, size) that holds a record of R players; a new array."""
        parts = [np.asarray(part, dtype=np.float64) for part in _arrays(record)]
        return np.concatenate([part.reshape(len(part), part[:1].size) for part in parts], axis=1)

    def unpack(self, memory: FloatArray) -> Any:
        """The inverse of :meth:`pack`; the arrays are views."""
        first = 0

        def taken(like: Any) -> Any:
            nonlocal first
            if isinstance(like, tuple):
                return _like(like, map(taken, like))
            part = memory[:, first : first + like.size].reshape(len(memory), *like.shape[1:])
            first += like.size
            return part

        return taken(self.start)


def chosen(mask: BoolArray, fresh: Record, old: Record) -> Record:
    """The rows of ``fresh`` in a mask (R, 1), the rows of ``old`` elsewhere, array by array."""
    if mask.all():
        return fresh

    def choice(new: Any, before: Any) -> Any:
        if isinstance(new, tuple):
            return chosen(mask, new, before)
        return np.where(mask.reshape(-1, *(1,) * (new.ndim - 1)), new, before)

    return _like(fresh, map(choice, fresh, old))


def _arrays(record: tuple[Any, ...]) -> list[Any]:
    """The arrays of a record in order."""
    return [array for part in record for array in (_arrays(part) if isinstance(part, tuple) else [part])]


def _like(record: Any, parts: Any) -> Any:
    """A tuple of the kind of ``record`` with other parts."""
    return record._make(parts) if hasattr(record, "_make") else tuple(parts)
