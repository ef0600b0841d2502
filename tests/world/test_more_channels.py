"""The channels of the field: their distributions, and what stays the same from step to step."""

import numpy as np
import pytest
from scipy import stats

from ptne_env.world.channels import Bias, HeavyTails, LateNoise, LinkRandomness, Messages

PLAYERS, BATCH = 10, 50
SENDERS = np.stack([(np.arange(PLAYERS) + shift) % PLAYERS for shift in (1, 2, 3)])
SHAPE = (3, PLAYERS, PLAYERS, BATCH)
FALSE_ALARM = 1e-6


def errors(channel, steps):
    """What the channel adds to messages in each step."""
    keys, memory, found = np.arange(BATCH, dtype=np.uint64), None, []
    for step in range(steps):
        values = np.full(SHAPE, 7.0)
        live = np.ones((3, PLAYERS, BATCH), dtype=bool)
        messages = Messages(values, live, live.astype(float))
        randomness = LinkRandomness(keys, np.full(BATCH, step), SENDERS, np.arange(PLAYERS))
        received, memory = channel.transmit(messages, memory, randomness)
        assert np.all(values == 7.0)
        found.append(received.values - 7.0)
    return np.stack(found)


def test_a_bias_is_uniform_over_links_and_components_and_the_same_in_all_steps():
    found = errors(Bias(0.1), 3)
    np.testing.assert_array_equal(found[1:], found[:1].repeat(2, axis=0))
    assert stats.kstest(found[0].ravel(), stats.uniform(-0.1, 0.2).cdf).pvalue > FALSE_ALARM


def test_heavy_tails_are_those_of_students_distribution_of_two_degrees():
    found = errors(HeavyTails(0.5), 2)
    assert stats.kstest(found.ravel() / 0.5, stats.t(2).cdf).pvalue > FALSE_ALARM
    assert np.isfinite(found).all()
    assert abs(stats.spearmanr(found[0].ravel(), found[1].ravel()).statistic) < 0.05


def test_late_noise_starts_at_its_step():
    found = errors(LateNoise(0.5, 2), 4)
    assert np.all(found[:2] == 0)
    assert stats.kstest(found[2:].ravel() / 0.5, stats.norm.cdf).pvalue > FALSE_ALARM


@pytest.mark.parametrize("make", [lambda: Bias(-1), lambda: HeavyTails(np.nan), lambda: LateNoise(1, -1)])
def test_numbers_out_of_range_are_refused(make):
    with pytest.raises(ValueError, match="must be|at least|≥ 0"):
        make()
