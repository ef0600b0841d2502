import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptne_env import distances


def world(seed, players=3, dimension=4, batch=2):
    generator = np.random.default_rng(seed)
    return generator.normal(size=(dimension, players, batch)), generator.normal(size=dimension)


def norm(values):
    return math.sqrt(math.fsum(value * value for value in values))


@given(st.integers(0, 2**32 - 1))
def test_distances_are_those_of_their_definitions(seed):
    estimates, equilibrium = world(seed)
    strategies = estimates[:, 0]
    scale = norm(equilibrium)
    per_player = distances.player_distances(estimates, equilibrium)
    team = distances.estimate_distance(estimates, equilibrium)
    plotted = distances.strategy_distance(strategies, equilibrium)
    disagreement = distances.consensus_error(estimates, equilibrium)
    for b in range(2):
        errors = [estimates[:, i, b] - equilibrium for i in range(3)]
        for i in range(3):
            assert per_player[i, b] == pytest.approx(norm(errors[i]) / scale, rel=1e-13)
        assert team[b] == pytest.approx(norm(np.concatenate(errors)) / (math.sqrt(3) * scale), rel=1e-13)
        assert plotted[b] == pytest.approx(norm(strategies[:, b] - equilibrium) / scale, rel=1e-13)
        mean = sum(estimates[:, i, b] for i in range(3)) / 3
        spread = norm(np.concatenate([estimates[:, i, b] - mean for i in range(3)]))
        assert disagreement[b] == pytest.approx(spread / (math.sqrt(3) * scale), rel=1e-12)


def test_equilibrium_at_the_origin_is_measured_in_natural_units():
    estimates, equilibrium = np.full((2, 3, 1), 2.0), np.zeros(2)
    assert distances.scale(equilibrium) == 1.0
    assert distances.player_distances(estimates, equilibrium)[:, 0] == pytest.approx([math.sqrt(8)] * 3)
    assert distances.estimate_distance(estimates, equilibrium)[0] == pytest.approx(math.sqrt(8))


def test_distances_vanish_at_the_equilibrium_exactly():
    _, equilibrium = world(0)
    estimates = np.repeat(equilibrium[:, None, None], 3, axis=1)
    assert distances.estimate_distance(estimates, equilibrium).tolist() == [0.0]
    assert distances.strategy_distance(estimates[:, 0], equilibrium).tolist() == [0.0]


def test_arguments_are_left_alone():
    estimates, equilibrium = world(1)
    kept = estimates.copy(), equilibrium.copy()
    distances.player_distances(estimates, equilibrium)
    distances.consensus_error(estimates, equilibrium)
    assert np.array_equal(estimates, kept[0])
    assert np.array_equal(equilibrium, kept[1])


def test_twelve_digits_are_all_that_is_counted():
    assert distances.digits(np.array([1.0, 1e-3, 1e-12, 1e-15, 0.0])) == pytest.approx([0, 3, 12, 12, 12])


def test_success_is_half_a_percent():
    assert distances.SUCCESS_DISTANCE == 0.005


@pytest.mark.parametrize("players", [3, 11, 40])
def test_batch_agrees_bit_for_bit_with_batches_of_one(players):
    estimates, equilibrium = world(2, players=players, dimension=players, batch=5)
    strategies = np.ascontiguousarray(estimates[:, 0])
    for b in range(5):
        alone, own = estimates[:, :, b : b + 1].copy(), strategies[:, b : b + 1].copy()
        for measure in (distances.player_distances, distances.estimate_distance, distances.consensus_error):
            assert np.array_equal(measure(alone, equilibrium)[..., 0], measure(estimates, equilibrium)[..., b])
        together = distances.strategy_distance(strategies, equilibrium)[b]
        assert distances.strategy_distance(own, equilibrium)[0] == together
