import numpy as np
from sample_games import BlockGame, CubicGame, ForgetfulEnergyGame

from ptne_env.games import EnergyGame, check_game


class ConcaveGame(EnergyGame):
    """The second player's cost is turned upside down, and so is its gradient."""

    def costs(self, strategies):
        return super().costs(strategies) * np.array([1, -1, 1, 1, 1])[:, None]

    def own_gradients(self, estimates):
        return super().own_gradients(estimates) * np.array([1, -1, 1, 1, 1])[:, None]


def test_forgotten_term_of_a_gradient_is_caught():
    report = check_game(ForgetfulEnergyGame())
    assert not report.gradients_agree
    assert report.gradient_error > 1e-3


def test_wrong_sign_in_one_component_is_caught():
    game = BlockGame()
    game.matrix = game.matrix.copy()
    right = game.own_gradients
    game.own_gradients = lambda estimates: right(estimates) * np.array([1, 1, 1, 1, -1, 1])[:, None]
    assert not check_game(game).gradients_agree


def test_right_game_of_unequal_dimensions_passes():
    report = check_game(BlockGame())
    assert report.gradients_agree
    assert report.assumption_3_holds


def test_concave_cost_is_named_by_player():
    report = check_game(ConcaveGame())
    assert report.gradients_agree
    assert report.strictly_convex == (True, False, True, True, True)
    assert report.radially_unbounded == (True, False, True, True, True)


def test_cost_that_falls_forever_is_not_radially_unbounded():
    assert check_game(CubicGame()).radially_unbounded == (False, False)


def test_same_seed_gives_the_same_report():
    assert check_game(ForgetfulEnergyGame(), seed=3) == check_game(ForgetfulEnergyGame(), seed=3)


def test_points_are_drawn_within_the_radius():
    near = check_game(ForgetfulEnergyGame(), radius=0.01).gradient_error
    far = check_game(ForgetfulEnergyGame(), radius=5.0).gradient_error
    assert near < 1e-3 < far  # the forgotten term is 0.1 x_i
