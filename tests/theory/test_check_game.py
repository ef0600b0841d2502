import numpy as np
import pytest
from sample_games import BlockGame, CubicGame, ForgetfulEnergyGame

from ptne_env.games import EnergyGame, QuadraticGame
from ptne_env.theory import check_game


class ConcaveGame(EnergyGame):
    """The second player's cost and gradient have the opposite sign."""

    def costs(self, strategies):
        return super().costs(strategies) * np.array([1, -1, 1, 1, 1])[:, None]

    def own_gradients(self, estimates):
        return super().own_gradients(estimates) * np.array([1, -1, 1, 1, 1])[:, None]


def test_missing_term_of_a_gradient_is_detected():
    report = check_game(ForgetfulEnergyGame())
    assert not report.gradients_agree
    assert report.gradient_error > 1e-3


def test_wrong_sign_in_one_component_is_detected():
    game = BlockGame()
    right = game.own_gradients
    vars(game)["own_gradients"] = lambda estimates: right(estimates) * np.array([1, 1, 1, 1, -1, 1])[:, None]
    assert not check_game(game).gradients_agree


def test_correct_game_with_unequal_dimensions_passes():
    report = check_game(BlockGame())
    assert report.gradients_agree
    assert report.assumption_3_holds


def test_concave_cost_is_reported_for_its_player():
    report = check_game(ConcaveGame())
    assert report.gradients_agree
    assert report.strictly_convex == (True, False, True, True, True)
    assert report.radially_unbounded == (True, False, True, True, True)


def test_a_game_without_an_equilibrium_is_told_of():
    """J1 = ½(x1 − x2 − 1)² and J2 = ½(x2 − x1)² satisfy Assumption 3, and F1 + F2 = −1 everywhere."""
    report = check_game(QuadraticGame([[1.0, -1.0], [-1.0, 1.0]], [-1.0, 0.0]))
    assert report.strictly_convex == report.radially_unbounded == (True, True)
    assert "no single Nash equilibrium" in report.equilibrium_error
    assert not report.assumption_3_holds
    assert check_game(EnergyGame()).equilibrium_error is None


def test_unbounded_decrease_is_not_radial_growth():
    assert check_game(CubicGame()).radially_unbounded == (False, False)


def test_points_are_drawn_within_the_radius():
    near = check_game(ForgetfulEnergyGame(), radius=0.01).gradient_error
    far = check_game(ForgetfulEnergyGame(), radius=5.0).gradient_error
    assert near < 1e-3 < far  # the missing term is 0.1 x_i


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (
            {"own_gradients": np.diag},
            r"maps \(n, N, B\) = \(5, 5, 8\) to \(n, B\) = \(5, 8\), environments B last; it raised ValueError: Input",
        ),
        ({"costs": lambda strategies: strategies[0][0][0]}, r"maps \(n, B\) = \(5, 8\) to .*it raised IndexError"),
        ({"costs": lambda strategies: strategies.sum(axis=1)}, r"\(N, B\) = \(5, 8\).*it returned the shape \(5,\)"),
    ],
)
def test_a_method_for_one_environment_alone_is_refused_with_the_axes(method, message):
    game = EnergyGame()
    vars(game).update(method)
    with pytest.raises(ValueError, match=message):
        check_game(game, samples=8)
