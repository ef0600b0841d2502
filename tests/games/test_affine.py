import numpy as np
import pytest
from sample_games import generators

from ptne_env.games import NoBestResponseError, QuadraticGame, RandomAffine, require_strong_monotonicity


def skew_part(game):
    return (game.matrices - game.matrices.transpose(1, 0, 2)) / 2


@pytest.mark.parametrize(
    ("epsilon", "asymmetry", "action_dim"), [(0.05, 3.0, 1), (1.0, 0.0, 1), (4.0, 0.5, 2), (0.05, 3.0, 2)]
)
def test_epsilon_spread_and_asymmetry_are_exact(epsilon, asymmetry, action_dim):
    family = RandomAffine(players=4, epsilon=epsilon, asymmetry=asymmetry, spread=1.5, action_dim=action_dim)
    games = family.draw(generators(range(30)))
    require_strong_monotonicity(games)
    matrices = np.moveaxis(games.matrices, 2, 0)
    eigenvalues = np.linalg.eigvalsh((matrices + matrices.transpose(0, 2, 1)) / 2)
    assert eigenvalues[:, 0] == pytest.approx(np.full(30, epsilon), abs=1e-12)
    assert epsilon < eigenvalues[:, -1].min() <= eigenvalues[:, -1].max() <= epsilon + 1.5 + 1e-12
    sizes = np.linalg.norm(np.moveaxis(skew_part(games), 2, 0), 2, axis=(1, 2))
    assert sizes == pytest.approx(np.full(30, asymmetry), abs=1e-12)


def test_equilibria_fill_the_range_and_own_blocks_are_hessians():
    games = RandomAffine(players=3, action_dim=2).draw(generators(range(200)))
    assert -10 <= games.nash_equilibria.min() < -9.9
    assert 9.9 < games.nash_equilibria.max() <= 10
    same = games.owners[:, None] == games.owners
    assert not skew_part(games)[same].any()


def test_bounds_hold_about_half_of_the_components():
    games = RandomAffine(low=-5.0, high=5.0).draw(generators(range(200)))
    assert np.abs(games.natural_residual(games.nash_equilibria)).max() < 1e-12
    assert 0.3 < games.held_at_equilibrium.mean() < 0.7


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: QuadraticGame(np.eye(3), [1.0, 2.0]), r"matrix is \(2, 2\)"),
        (lambda: QuadraticGame(np.eye(2), [1.0, 2.0], (1, 2)), r"matrix is \(3, 3\)"),
        (lambda: QuadraticGame([[1.0, 1.0, 0], [0.0, 1.0, 0], [0, 0, 1]], np.ones(3), (2, 1)), "A_ii is not symmetric"),
        (lambda: QuadraticGame(-np.eye(2), [1.0, 2.0]), "not convex in x_i"),
        (lambda: QuadraticGame(np.eye(2), [1.0, 2.0], low=np.zeros((2, 3)), high=1.0), r"shape \(2, 3\); give one"),
        (lambda: RandomAffine(epsilon=0.0, asymmetry=0.0), "epsilon must be a finite number above 0"),
        (lambda: RandomAffine(asymmetry=-1.0), "asymmetry must be a finite number of at least 0"),
        (lambda: RandomAffine(players=1), "players must be a whole number of at least 2"),
        (lambda: RandomAffine(low=1.0, high=0.0), "low < high"),
    ],
)
def test_invalid_games_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_a_flat_cost_has_no_best_response():
    game = QuadraticGame([[0.0, 1.0], [-1.0, 0.0]], [-1.0, 1.0], low=-2.0, high=3.0)
    assert not game.has_best_response
    with pytest.raises(NoBestResponseError, match="flat direction"):
        game.best_response(np.zeros((2, 1)))
    assert game.nash_equilibrium == pytest.approx([1.0, 1.0], abs=1e-12)


def test_a_cost_that_rounding_alone_bends_has_no_best_response():
    """A_11 = v vᵀ has rank one, and an inverse in floating point."""
    direction = np.array([1 / 3, 0.7])
    matrix = np.eye(3)
    matrix[:2, :2] = np.outer(direction, direction)
    matrix[1, 1] *= 1 + 4e-16
    np.linalg.inv(matrix[:2, :2])
    game = QuadraticGame(matrix, np.ones(3), action_dims=(2, 1), low=-2.0, high=3.0)
    assert not game.has_best_response


def test_singular_game_has_no_single_equilibrium():
    with pytest.raises(ArithmeticError, match="no single Nash equilibrium"):
        _ = QuadraticGame(np.ones((2, 2)), [1.0, 2.0]).nash_equilibria
