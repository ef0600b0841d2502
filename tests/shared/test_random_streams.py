import dataclasses

import numpy as np
import pytest

from ptne_env.shared.random_streams import RandomStreams

NAMES = [field.name for field in dataclasses.fields(RandomStreams)]


def test_numbers_depend_on_the_seed():
    draws = [[getattr(RandomStreams.from_seed(seed), name).random(4).tolist() for name in NAMES] for seed in (7, 7, 8)]
    assert draws[0] == draws[1]
    assert draws[0] != draws[2]


def test_streams_of_a_seed_differ():
    streams = RandomStreams.from_seed(7)
    assert len({getattr(streams, name).random() for name in NAMES}) == len(NAMES)


@pytest.mark.parametrize("busy", NAMES)
def test_draws_from_a_stream_do_not_affect_the_others(busy):
    quiet, other = RandomStreams.from_seed(3), RandomStreams.from_seed(3)
    getattr(other, busy).random(1000)
    for name in NAMES:
        same = getattr(quiet, name).random() == getattr(other, name).random()
        assert same == (name != busy)


def test_no_seed_takes_fresh_entropy():
    assert RandomStreams.from_seed(None).start.random() != RandomStreams.from_seed(None).start.random()


def test_numpy_integers_are_seeds():
    assert RandomStreams.from_seed(np.int64(7)).start.random() == RandomStreams.from_seed(7).start.random()


@pytest.mark.parametrize("seed", [-1, 1.0, "7", True, [1]])
def test_invalid_seeds_are_refused(seed):
    with pytest.raises(ValueError, match="whole number of at least 0"):
        RandomStreams.from_seed(seed)
