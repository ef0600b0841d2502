"""Sums and maxima of arrays, and their order."""

import numpy as np
import pytest
from extras import need_jax

from ptne_env.shared.arrays import fold, ordered_sum, round_to_integers, row_maxima

SHAPES = [(5, 1), (5, 63), (5, 64), (3, 4, 50), (400, 70), (1, 200), (20, 2000, 3)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("axis", [0, 1])
def test_sums_add_terms_in_order_whatever_the_size_of_the_batch(shape, axis):
    array = np.random.default_rng(0).standard_normal(shape) * 10.0 ** np.arange(shape[-1])[::-1].clip(0, 12)
    expected = np.zeros(np.delete(shape, axis))
    for term in np.moveaxis(array, axis, 0):
        expected = expected + term
    before = array.copy()
    assert ordered_sum(array, axis=axis).tobytes() == expected.tobytes()
    assert array.tobytes() == before.tobytes()


def test_sums_of_booleans_count_them():
    flags = np.ones((300, 200), dtype=np.bool_)
    assert (ordered_sum(flags) == 300).all()


@pytest.mark.parametrize("length", [1, 2, 16, 17, 100])
def test_row_maxima_are_those_of_numpy_with_nan_and_infinity(length):
    array = np.random.default_rng(1).standard_normal((7, 40, length))
    array[0, 0, 0], array[1, 2, -1], array[3] = np.nan, np.inf, -np.inf
    np.testing.assert_array_equal(row_maxima(array), array.max(axis=-1))


def test_fold_reduces_booleans_by_the_operation_of_its_name():
    flags = np.random.default_rng(2).random((50, 4, 6)) > 0.7
    np.testing.assert_array_equal(fold(np.logical_or, flags, axis=1), flags.any(axis=1))


def test_rounding_has_the_gradient_of_no_rounding():
    jax = need_jax()
    numbers = np.array([-2.6, -0.4, 0.5, 1.5, 7.0], dtype=np.float32)
    assert np.array_equal(round_to_integers(jax.numpy.asarray(numbers)), round_to_integers(numbers))
    gradient = jax.grad(lambda array: (round_to_integers(array) * numbers).sum())(numbers)
    assert np.array_equal(gradient, numbers)
