"""Saturating games: exact equilibria, Jacobians and best responses."""

import numpy as np
import pytest
from sample_games import generators
from scipy import optimize

from ptne_env import theory
from ptne_env.field.games import RandomAffine, RandomSaturating, SaturatingGame
from ptne_env.games import RandomEnergy

FAMILIES = {
    "saturating, energy": RandomSaturating(RandomEnergy(4)),
    "saturating": RandomSaturating(RandomAffine(action_dim=(1, 2, 3, 1, 2))),
}


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES.keys())
def test_equilibria_are_those_that_a_solver_finds(family):
    game = family.draw(generators([3]))
    found = optimize.root(lambda x: game.pseudo_gradient(x[:, None])[:, 0], np.zeros(game.dimension), tol=1e-13)
    assert game.nash_equilibrium == pytest.approx(found.x, abs=1e-8)
    assert game.best_response(game.nash_equilibria) == pytest.approx(game.nash_equilibria, abs=1e-9)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES.keys())
def test_jacobian_and_best_response_follow_from_the_costs(family):
    games, generator = family.draw(generators(range(3))), np.random.default_rng(0)
    x, move = generator.uniform(-9, 9, (2, games.dimension, 3))
    step = 1e-6
    slope = (games.pseudo_gradient(x + step * move) - games.pseudo_gradient(x - step * move)) / (2 * step)
    assert np.einsum("ijb,jb->ib", games.jacobian(x), move) == pytest.approx(slope, abs=1e-5)
    response = games.best_response(x)
    for player in range(games.num_players):
        own = (games.owners == player)[:, None]
        best = games.costs(np.where(own, response, x))[player]
        for _ in range(20):
            other = np.where(own, response + generator.normal(size=x.shape), x)
            assert (games.costs(other)[player] >= best - 1e-9 * (1 + np.abs(best))).all()


def test_saturating_game_without_bend_is_affine():
    flat, affine = (family.draw(generators([1])) for family in (RandomSaturating(bend=0.0), RandomAffine()))
    x = np.random.default_rng(0).normal(size=(5, 3))
    assert flat.pseudo_gradient(x) == pytest.approx(affine.pseudo_gradient(x), abs=1e-12)
    bent = RandomSaturating().draw(generators([1]))
    assert not np.allclose(bent.jacobian(x)[..., 0], bent.jacobian(x)[..., 1], atol=0.1)


def test_saturating_games_have_the_sampled_constants_that_are_promised():
    game = RandomSaturating(RandomAffine(epsilon=0.7)).representative
    constants = theory.monotonicity_constants(game)
    assert constants.epsilon >= 0.7
    assert (
        constants.iota_strategies
        <= np.linalg.norm(game.matrix[..., 0], 2) + np.linalg.norm(game.prices[..., 0], 2) ** 2
    )


def test_wrong_shapes_of_prices_are_named():
    with pytest.raises(ValueError, match=r"prices are \(m, 2\)"):
        SaturatingGame(np.eye(2), np.ones((3, 1)), np.ones(3), np.ones(2))
