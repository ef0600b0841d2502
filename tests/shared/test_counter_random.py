"""Counter-based random numbers. Statistical tests have the false-alarm probability stated and fixed seeds."""

import numpy as np
import pytest
from scipy import stats

from ptne_env.shared import counter_random

FALSE_ALARM = 1e-6
KEYS = {"zero": 0, "small": 1, "random": 0x5DEECE66D1234567, "largest": 2**64 - 1}
SIZE = 200_000


def python_mix(value):
    """splitmix64's finaliser on Python's whole numbers."""
    value &= 2**64 - 1
    value = (value ^ (value >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
    value = (value ^ (value >> 27)) * 0x94D049BB133111EB % 2**64
    return value ^ (value >> 31)


def key_array(*keys):
    return np.array(keys, dtype=np.uint64)


def normals(keys, counters):
    return counter_random.normal_quantiles(counter_random.uniforms(keys, counters))


def test_mix_gives_the_published_sequence_of_splitmix64():
    states = [(1234567 + (index + 1) * 0x9E3779B97F4A7C15) % 2**64 for index in range(5)]
    published = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    assert counter_random.mix(key_array(*states)).tolist() == published


def test_golden_values():
    keys, numbers = key_array(1, 2), np.arange(3, dtype=np.uint64)[:, None]
    expected = [
        [python_mix(python_mix(key) + (number + 1) * 0x9E3779B97F4A7C15) for key in (1, 2)] for number in range(3)
    ]
    assert counter_random.words(keys, numbers).tolist() == expected
    assert counter_random.uniforms(keys, numbers).tolist() == [
        [((word >> 12) + 0.5) / 2**52 for word in row] for row in expected
    ]
    assert expected[0] == [13830413928045401970, 4689417271487893854]  # the numbers never change


@pytest.mark.parametrize("function", [counter_random.words, counter_random.uniforms, normals])
def test_numbers_do_not_depend_on_the_shape_of_the_request(function):
    keys = counter_random.mix(np.arange(7, dtype=np.uint64))
    numbers = np.arange(12, dtype=np.uint64).reshape(3, 4, 1)
    together = function(keys, numbers)
    assert together.shape == (3, 4, 7)
    for b in range(7):
        assert np.array_equal(together[..., b], function(keys[b : b + 1], numbers)[..., 0])
    assert together[2, 1, 3] == function(keys[3:4], key_array(9))[0]


@pytest.mark.parametrize("key", KEYS)
def test_counters_of_a_key_are_uniform_and_normal(key):
    keys, numbers = key_array(KEYS[key]), np.arange(SIZE, dtype=np.uint64)
    assert stats.kstest(counter_random.uniforms(keys, numbers), "uniform").pvalue > FALSE_ALARM
    assert stats.kstest(normals(keys, numbers), "norm").pvalue > FALSE_ALARM


def correlated(first, second):
    """Whether the correlation is significant at the level FALSE_ALARM."""
    limit = stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(first.size)
    return abs(np.corrcoef(first, second)[0, 1]) > limit


@pytest.mark.parametrize("lag", [1, 2, 5, 25, 64])
def test_neighbouring_counters_are_uncorrelated(lag):
    numbers = normals(key_array(77), np.arange(SIZE, dtype=np.uint64))
    assert not correlated(numbers[:-lag], numbers[lag:])
    assert not correlated(numbers[:-lag] ** 2, numbers[lag:] ** 2)


def test_child_streams_differ_from_their_parent_and_each_other():
    numbers = np.arange(SIZE, dtype=np.uint64)
    parent = key_array(3)
    streams = [parent, *(counter_random.child_keys(parent, index) for index in range(3))]
    streams.append(counter_random.child_keys(streams[1], 1))
    draws = [counter_random.uniforms(key, numbers) for key in streams]
    for index, first in enumerate(draws):
        for second in draws[:index]:
            assert not correlated(first, second)
            assert not np.isin(first[:1000], second).any()


def test_every_input_bit_changes_half_of_the_output_bits():
    values = counter_random.mix(np.arange(500, dtype=np.uint64))
    for bit in range(64):
        changed = counter_random.mix(values) ^ counter_random.mix(values ^ np.uint64(1 << bit))
        flipped = np.unpackbits(changed.view(np.uint8)).mean()
        assert abs(flipped - 0.5) < stats.norm.isf(FALSE_ALARM / 2) * 0.5 / np.sqrt(500 * 64)


def test_numbers_are_never_at_the_ends():
    assert (2**52 - 1 + 0.5) * 2.0**-52 < 1  # the largest number
    assert np.isfinite(normals(key_array(0), np.arange(SIZE, dtype=np.uint64))).all()
