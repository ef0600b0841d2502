import numpy as np
import pytest
from sample_games import BlockGame, CubicGame

from ptne_env.games import EnergyGame, Game, NoBestResponseError, NonQuadraticGame


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
