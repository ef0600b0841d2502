"""Array types, and the argument checks of all public constructors."""

from __future__ import annotations

import math
import sys
from functools import reduce
from numbers import Real
from operator import add
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
import numpy.typing as npt
from numpy.ma import MaskedArray

FloatArray: TypeAlias = npt.NDArray[np.float64]
Float32Array: TypeAlias = npt.NDArray[np.float32]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

Array = TypeVar("Array", bound=npt.NDArray[np.generic])


def is_numpy(array: Any) -> bool:
    """Return whether an array is numpy's. One of JAX may not know its numbers yet, and never changes them."""
    return isinstance(array, np.ndarray)


def array_namespace(array: Any) -> Any:
    """Return the library of an array, numpy or ``jax.numpy``, so that a formula serves both: ``xp.exp(x)``."""
    return np if is_numpy(array) else array.__array_namespace__()


def without_gradient(array: Any) -> Any:
    """Return the same array, which JAX does not differentiate."""
    return array if is_numpy(array) else sys.modules["jax"].lax.stop_gradient(array)


def round_to_integers(array: Any) -> Any:
    """Round to whole numbers. JAX differentiates this as if nothing were rounded (straight-through)."""
    if is_numpy(array):
        return np.rint(array)
    return array + without_gradient(array_namespace(array).rint(array) - array)


def root(array: Any) -> Any:
    """Return the square root. JAX differentiates it as 0 at 0."""
    if is_numpy(array):
        return np.sqrt(array)
    xp = array_namespace(array)
    return xp.where(array > 0, xp.sqrt(xp.where(array > 0, array, 1.0)), 0.0)


def product(first: Any, second: Any) -> Any:
    """Return ``first * second`` in C order, because the order of a sum's additions depends on it."""
    if is_numpy(second):
        return np.multiply(first, second, order="C")
    return first * second


def _is_finite(value: object) -> bool:
    """Return whether ``value``, which may have any type, is a finite number."""
    return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)


def require_positive(name: str, value: float, unit: str = "") -> float:
    """Return ``value`` as a float, or raise ``ValueError`` when it is not finite and positive."""
    if not (_is_finite(value) and value > 0):
        raise ValueError(f"{name} must be a finite number above 0{unit}, got {value!r}")
    return float(value)


def require_non_negative(name: str, value: float) -> float:
    """Return ``value`` as a float, or raise ``ValueError`` when it is not finite and at least 0."""
    if not (_is_finite(value) and value >= 0):
        raise ValueError(f"{name} must be a finite number of at least 0, got {value!r}")
    return float(value)


def require_probability(name: str, value: float) -> float:
    """Return ``value`` as a float, or raise ``ValueError`` when it is not a number in [0, 1]."""
    if require_non_negative(name, value) > 1:
        raise ValueError(f"{name} must be a probability, a number between 0 and 1, got {value!r}")
    return float(value)


def require_positive_probability(name: str, value: float) -> float:
    """Return ``value`` as a float, or raise ``ValueError`` when it is not a number in (0, 1]."""
    return require_probability(name, require_positive(name, value))


def require_count(name: str, value: int, minimum: int) -> int:
    """Return ``value``, or raise ``ValueError`` when it is not a whole number of at least ``minimum``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:  # type: ignore[redundant-expr]  # callers may pass any type
        raise ValueError(f"{name} must be a whole number of at least {minimum}, got {value!r}")
    return int(value)


def require_flag(name: str, value: bool) -> bool:  # noqa: FBT001 - what it checks
    """Return ``value``, or raise ``ValueError`` when it is neither True nor False, as the text "no" is not."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return value


def require_printable(name: str, value: str) -> str:
    """Return ``value``, or raise ``ValueError`` when it is no text of printable characters, as escape sequences are."""
    if not (isinstance(value, str) and value.isprintable()):  # type: ignore[redundant-expr]  # callers may pass any type
        raise ValueError(f"{name} must be a text of printable characters, got {value!r}")
    return value


def as_plain(name: str, value: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return ``value`` as an array, or raise ``ValueError`` when it is a masked array, whose mask would be lost."""
    if isinstance(value, MaskedArray):
        raise ValueError(f"{name} must be a plain array, got a masked array: fill its masked entries")
    return np.asarray(value)


def require_mask(name: str, value: npt.ArrayLike, size: int) -> BoolArray:
    """Return ``value`` as an array, or raise ``ValueError`` when it is not ``size`` booleans, shape (size,)."""
    mask = as_plain(name, value)
    if mask.shape != (size,) or mask.dtype != np.bool_:
        raise ValueError(f"{name} is {size} booleans, got {mask.dtype} of shape {mask.shape}")
    return mask


def freeze(array: npt.ArrayLike) -> FloatArray:
    """Return a read-only float64 copy, which is safe to share; an array of JAX as it is."""
    if not is_numpy(array) and hasattr(array, "__array_namespace__"):
        return cast(FloatArray, array)
    result = np.array(array, dtype=np.float64)
    result.flags.writeable = False
    return result


def with_games(values: npt.ArrayLike, axes: int) -> FloatArray:
    """Return a read-only array with a last axis for games; the numbers of a single game have ``axes`` and lack it."""
    array = freeze(values)
    return array if array.ndim > axes else array[..., None]


def fold(ufunc: np.ufunc, array: Array, axis: int) -> Array:
    """Reduce a short axis term by term, in order: faster than ``ufunc.reduce`` where the terms are long."""
    terms: Any = array
    before = (slice(None),) * (axis % array.ndim)
    result: Array = terms[(*before, 0)].copy()
    for term in range(1, array.shape[axis]):
        ufunc(result, terms[(*before, term)], out=result)
    return result


def ordered_sum(array: FloatArray, axis: int = 0) -> FloatArray:
    """Sum along ``axis`` in order. Numpy's own order depends on the memory layout, so on the size of the batch."""
    if not is_numpy(array):
        # Compiled, a sum of few terms is several times as fast as a reduction.
        terms = array_namespace(array).moveaxis(array, axis, 0)
        return reduce(add, terms) if 0 < len(terms) <= 64 else terms.sum(0)
    if array.dtype.kind == "f" and array.size >= 64 * array.shape[axis] > 0:  # long terms
        return fold(np.add, array, axis)
    return np.add.accumulate(array, axis=axis).take(-1, axis=axis)


def data_frame(content: Any) -> Any:
    """Return columns by name, or records, as a ``pandas.DataFrame``; ``ImportError`` where pandas is missing."""
    try:
        from pandas import DataFrame
    except ImportError as error:
        raise ImportError('data frames need pandas: pip install "ptne-env[pandas]"') from error
    return DataFrame(content)


def row_maxima(array: FloatArray) -> FloatArray:
    """Return the largest entry along the last axis, (..., k) to (...)."""
    return fold(np.maximum, array, -1) if array.shape[-1] <= 16 else np.maximum.reduce(array, axis=-1)


def replace_columns(old: Array, fresh: Array, mask: BoolArray) -> Array:
    """Return a copy of ``old`` whose columns in ``mask`` (B,) are replaced, in order, by those of ``fresh``."""
    result = old.copy()
    result[..., mask] = fresh
    return result
