"""Random numbers without a state: each is a hash of a key and a counter, for any batch size and any policy.

A stream is named by a 64-bit key, and its number c is ``mix(mix(key) + (c + 1) γ)``, where mix is the finaliser of
splitmix64 and γ = 2^64/φ, odd: Steele, Lea & Flood, "Fast splittable pseudorandom number generators" (OOPSLA 2014).
The generator is counter-based in the sense of Salmon, Moraes, Dror & Shaw, "Parallel random numbers: as easy as 1, 2,
3" (SC 2011): each number depends only on its key and counter.
"""

from __future__ import annotations

import sys
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import special

from ptne_env.shared.arrays import FloatArray, array_namespace, is_numpy

CounterArray: TypeAlias = npt.NDArray[np.uint64]
"""Keys and counters: unsigned 64-bit numbers, whose arithmetic wraps."""

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
_DROPPED_BITS = np.uint64(12)


def special_functions(array: Any) -> Any:
    """Return ``scipy.special``, or ``jax.scipy.special`` for an array of JAX."""
    return special if is_numpy(array) else sys.modules["jax"].scipy.special


def mix(values: CounterArray) -> CounterArray:
    """Apply the finaliser of splitmix64, a bijection of 64-bit numbers: every input bit affects every output bit."""
    xp = array_namespace(values)
    values = xp.array(values, dtype=np.uint64, ndmin=1)  # a copy; scalars would warn where arrays wrap
    for shift, factor in zip(_SHIFTS, (_FIRST, _SECOND, None), strict=True):
        values ^= values >> shift
        if factor is not None:
            values *= factor
    return values


def child_keys(keys: CounterArray, index: int) -> CounterArray:
    """Return the keys of child stream ``index`` of the streams ``keys``, in the same shape.

    Raises:
        OverflowError: when ``index`` is negative or not below 2^64.
    """
    # Mixed twice, so that a child's key is not a number of its parent's stream.
    return mix(mix(mix(keys) + np.uint64(index) * np.ones(1, np.uint64) * _GAMMA) ^ _GAMMA)


def words(keys: CounterArray, counters: CounterArray) -> CounterArray:
    """Return 64 random bits for every key and counter; the two arrays are broadcast."""
    return mix(mix(keys) + (counters + np.uint64(1)) * _GAMMA)


def uniforms(keys: CounterArray, counters: CounterArray) -> FloatArray:
    """Return U(0, 1) for every key and counter: multiples of 2^−53, never 0 or 1, symmetric about 1/2."""
    bits = words(keys, counters)
    bits >>= _DROPPED_BITS  # 52 bits plus ½ are exact in float64; 53 bits plus ½ could round up to 1
    result = bits.astype(np.float64)
    result += 0.5
    result *= 2.0**-52
    return result


def normals(keys: CounterArray, counters: CounterArray) -> FloatArray:
    """Return N(0, 1) for every key and counter, by inversion; none is larger than 8.3."""
    numbers = uniforms(keys, counters)
    result: FloatArray = special_functions(numbers).ndtri(numbers)
    return result
