import numpy as np
import pytest
from sample_games import BlockGame, CubicGame

from ptne_env.games import EnergyGame, Game, NoBestResponseError, NonQuadraticGame, QuadraticGame


@pytest.mark.parametrize("game", [EnergyGame(), NonQuadraticGame(), BlockGame()], ids=lambda game: type(game).__name__)
def test_pseudo_gradient_is_own_gradients_at_equal_estimates(game):
    x = np.random.default_rng(2).uniform(-5, 5, (game.dimension, 4))
    shared = np.repeat(x[:, None, :], game.num_players, axis=1)
    assert np.array_equal(game.pseudo_gradient(x), game.own_gradients(shared))


def test_equilibrium_without_closed_form_is_solved_numerically():
    game = BlockGame()
    assert game.nash_equilibrium == pytest.approx(np.linalg.solve(game.matrix, -game.offset), abs=1e-10)


def test_regrets_with_unequal_dimensions_follow_the_definition():
    game = BlockGame()
    x = np.random.default_rng(6).uniform(-5, 5, (6, 2))
    regrets = game.regrets(x)
    assert regrets.shape == (3, 2)
    for player in range(3):
        deviated = x.copy()
        deviated[game.block(player)] = game.best_response(x)[game.block(player)]
        assert regrets[player] == pytest.approx(game.costs(x)[player] - game.costs(deviated)[player], abs=1e-12)
    assert regrets.min() > 0


def test_game_without_equilibrium_is_an_error():
    with pytest.raises(ArithmeticError, match="no Nash equilibrium was found"):
        _ = CubicGame().nash_equilibrium


def test_equilibrium_cannot_be_overwritten():
    with pytest.raises(ValueError, match="read-only"):
        EnergyGame().nash_equilibrium[0] = 0.0


def test_blocks_and_owners_follow_the_dimensions():
    game = BlockGame((2, 1, 3))
    assert game.dimension == 6
    assert game.owners.tolist() == [0, 0, 1, 2, 2, 2]


@pytest.mark.parametrize("dims", [(1,), (), (1, 0), (2, -1), (1, 1.5), (True, 1)])
def test_bad_dimensions_are_refused(dims):
    with pytest.raises(ValueError, match="at least"):
        BlockGame(dims)


class Peaks(Game):
    """J_1 = x1²/2 and J_2 = cos x2, which has a maximum at 0, where F vanishes."""

    action_dims = (1, 1)

    def costs(self, strategies):
        return np.stack([strategies[0] ** 2 / 2, np.cos(strategies[1])])

    def own_gradients(self, estimates):
        return np.stack([estimates[0, 0], -np.sin(estimates[1, 1])])

    def best_response(self, strategies):
        raise NoBestResponseError("no minimum")


def test_a_maximum_of_a_cost_is_no_equilibrium():
    with pytest.raises(ArithmeticError, match="cost of player 1 has the curvature -1 there.*no Nash equilibrium"):
        Peaks().nash_equilibrium  # noqa: B018 - the property raises
    assert HeldPeaks().nash_equilibrium == pytest.approx([0.0, 1.5])  # a bound holds player 1


class HeldPeaks(Peaks):
    """In a box in which J_2 falls towards a bound."""

    low, high = (-1.0, 0.5), (1.0, 1.5)


class Hardening(Game):
    """F_i = x_i + x_i³ − 1e-20, so that x* is 0 but for rounding."""

    action_dims, low, high = (1, 1), -1.0, 2.0

    def costs(self, strategies):
        return strategies**2 / 2 + strategies**4 / 4 - 1e-20 * strategies

    def own_gradients(self, estimates):
        own = np.stack([estimates[0, 0], estimates[1, 1]])
        return own + own**3 - 1e-20


def test_an_equilibrium_at_zero_has_the_scale_1_also_where_it_is_rounded():
    game = Hardening()
    assert 0 < np.abs(game.nash_equilibrium).max() < 1e-15
    assert game.equilibrium_scale.tolist() == [1.0]
    assert QuadraticGame(np.eye(2), [1e-6, 0.0]).equilibrium_scale == pytest.approx([1e-6])


class Vanishing(Game):
    """F = e^x, which has no zero but underflows."""

    action_dims = (1, 1)

    def costs(self, strategies):
        return np.exp(strategies)

    def own_gradients(self, estimates):
        return np.exp(np.stack([estimates[0, 0], estimates[1, 1]]))

    def best_response(self, strategies):
        raise NoBestResponseError("no minimum")


def test_zero_at_infinity_is_not_an_equilibrium():
    with pytest.raises(ArithmeticError):
        Vanishing().nash_equilibrium  # noqa: B018 - the property raises
