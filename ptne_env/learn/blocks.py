"""Batches of a whole number of blocks of rows, so that a network decides each row alike in every batch.

Libraries of linear algebra take other code for small batches, and for the last numbers of an array that fill no vector
register, which changes the last bits of a row's result. With whole blocks every row goes through the same code.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

BLOCK = 32
"""Rows in a block: twice the smallest batch, 16, from which on torch's products have the same bits in every batch, and
a multiple of the numbers in a vector register, at most 16."""


def in_blocks(array: npt.NDArray[Any], axis: int = 0) -> npt.NDArray[Any]:
    """``array`` with zeros appended along ``axis`` up to a multiple of :data:`BLOCK`; itself if it has that length."""
    missing = -array.shape[axis] % BLOCK
    if not missing:
        return array
    shape = (*array.shape[:axis], missing, *array.shape[axis + 1 :])
    return np.concatenate([array, np.zeros(shape, dtype=array.dtype)], axis=axis)
