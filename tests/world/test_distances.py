import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_games import RestingGame, generators

from ptne_env.games import RandomEnergy
from ptne_env.world import distances


def sample(seed, players=3, dimension=4, batch=2):
    generator = np.random.default_rng(seed)
    estimates = generator.normal(size=(dimension, players, batch))
    return estimates, RestingGame(generator.normal(size=dimension), players)


def norm(values):
    return math.sqrt(math.fsum(value * value for value in values))


@given(st.integers(0, 2**32 - 1))
def test_distances_agree_with_their_definitions(seed):
    estimates, game = sample(seed)
    strategies, equilibrium = estimates[:, 0], game.point
    scale = norm(equilibrium)
    per_player = distances.player_distances(estimates, game)
    team = distances.estimate_distance(estimates, game)
    plotted = distances.strategy_distance(strategies, game)
    for b in range(2):
        errors = [estimates[:, i, b] - equilibrium for i in range(3)]
        for i in range(3):
            assert per_player[i, b] == pytest.approx(norm(errors[i]) / scale, rel=1e-13)
        assert team[b] == pytest.approx(norm(np.concatenate(errors)) / (math.sqrt(3) * scale), rel=1e-13)
        assert plotted[b] == pytest.approx(norm(strategies[:, b] - equilibrium) / scale, rel=1e-13)


def test_scale_is_1_for_an_equilibrium_at_the_origin():
    estimates, game = np.full((2, 2, 1), 2.0), RestingGame(np.zeros(2), 2)
    assert game.equilibrium_scale.tolist() == [1.0]
    assert distances.player_distances(estimates, game)[:, 0] == pytest.approx([math.sqrt(8)] * 2)
    assert distances.estimate_distance(estimates, game)[0] == pytest.approx(math.sqrt(8))


def test_distances_are_exactly_0_at_the_equilibrium():
    _, game = sample(0)
    estimates = np.repeat(game.point[:, None, None], 3, axis=1)
    assert distances.estimate_distance(estimates, game).tolist() == [0.0]
    assert distances.strategy_distance(estimates[:, 0], game).tolist() == [0.0]


def test_at_most_twelve_digits_count():
    assert distances.digits(np.array([1.0, 1e-3, 1e-12, 1e-15, 0.0])) == pytest.approx([0, 3, 12, 12, 12])


@pytest.mark.parametrize("players", [2, 11, 40])
@pytest.mark.parametrize("drawn", [False, True], ids=["one game", "a game per environment"])
def test_batch_equals_single_environments_bit_for_bit(players, drawn):
    batch, family = 5, RandomEnergy(players)
    games = family.draw(generators(range(batch))) if drawn else family.representative
    estimates = np.random.default_rng(3).normal(size=(players, players, batch))
    strategies = np.ascontiguousarray(estimates[:, 0])
    assert len(set(games.equilibrium_scale.tolist())) == (batch if drawn else 1)
    for b in range(batch):
        game = family.draw(generators([b])) if drawn else games
        alone, own = estimates[:, :, b : b + 1].copy(), strategies[:, b : b + 1].copy()
        for measure in (distances.player_distances, distances.estimate_distance):
            assert np.array_equal(measure(alone, game)[..., 0], measure(estimates, games)[..., b])
        together = distances.strategy_distance(strategies, games)[b]
        assert distances.strategy_distance(own, game)[0] == together


@pytest.mark.parametrize("factor", [0.999, 1.001])
def test_success_is_judged_by_all_estimates_together(factor):
    """A player alone may be √N times as far away as all together; the order of players and environments is free."""
    limit = factor * distances.SUCCESS_DISTANCE
    alone = np.array([[math.sqrt(5) * limit, 0, 0, 0, 0], [0, 0, 0, 0, math.sqrt(5) * limit], [limit] * 5])
    for batch in (alone.T, alone[:1].T):
        assert distances.is_success(batch).tolist() == [factor < 1] * batch.shape[1]
