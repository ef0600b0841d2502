"""Saturating games: exact equilibria, Jacobians and best responses."""

import numpy as np
import pytest
from sample_games import generators

from ptne_env import theory
from ptne_env.games import RandomAffine, RandomSaturating, SaturatingGame


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
        <= np.linalg.norm(game.matrices[..., 0], 2) + np.linalg.norm(game.all_prices[..., 0], 2) ** 2
    )


def test_wrong_shapes_of_prices_are_named():
    with pytest.raises(ValueError, match=r"prices are \(m, 2\)"):
        SaturatingGame(np.eye(2), np.ones((3, 1)), np.ones(3), np.ones(2))
