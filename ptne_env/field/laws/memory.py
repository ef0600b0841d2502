"""Memories as records: named arrays with a row per player, which travel from step to step as one flat row per player."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np

from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray

Record = TypeVar("Record", bound=tuple[Any, ...])


class Memory(Generic[Record]):
    """Records of one kind as flat memories.

    Args:
        start: the record of one player at the start of an episode: a named tuple of arrays (1, ...) and of such tuples.
    """

    def __init__(self, start: Record) -> None:
        self._start, self._row = start, self.pack(start)

    def initial(self, rows: int) -> FloatArray:
        """The memory of R = ``rows`` players at the start of an episode, shape (R, size)."""
        return np.repeat(self._row, rows, axis=0)

    def pack(self, record: Record) -> FloatArray:
        """The memory (R, size) that holds a record of R players; a new array."""
        parts = [np.asarray(part, dtype=np.float64) for part in _arrays(record)]
        return np.concatenate([part.reshape(len(part), part[:1].size) for part in parts], axis=1)

    def unpack(self, memory: FloatArray) -> Record:
        """The inverse of :meth:`pack`; the arrays are views."""
        first = 0

        def taken(like: Any) -> Any:
            nonlocal first
            if isinstance(like, tuple):
                return _like(like, map(taken, like))
            part = memory[:, first : first + like.size].reshape(len(memory), *like.shape[1:])
            first += like.size
            return part

        return taken(self._start)  # type: ignore[no-any-return]


def rows_in(mask: BoolArray) -> IntArray | slice:
    """The rows in a mask (R,) as an index; of all rows, one that copies nothing."""
    return slice(None) if mask.all() else np.flatnonzero(mask)


def taken_rows(record: Record, rows: IntArray | slice) -> Record:
    """The rows of every array in a record."""
    return _like(record, (taken_rows(part, rows) if isinstance(part, tuple) else part[rows] for part in record))


def with_rows(record: Record, rows: IntArray | slice, fresh: Record) -> Record:
    """A record with the arrays of ``fresh`` in ``rows``, the inverse of :func:`taken_rows`."""
    if isinstance(rows, slice):  # all of them
        return fresh

    def replaced(old: Any, new: Any) -> Any:
        if isinstance(old, tuple):
            return with_rows(old, rows, new)
        result = old.copy()
        result[rows] = new
        return result

    return _like(record, map(replaced, record, fresh))


def _arrays(record: tuple[Any, ...]) -> list[Any]:
    """The arrays of a record in order."""
    return [array for part in record for array in (_arrays(part) if isinstance(part, tuple) else [part])]


def _like(record: Any, parts: Any) -> Any:
    """A tuple of the kind of ``record`` with other parts."""
    return record._make(parts) if hasattr(record, "_make") else tuple(parts)
