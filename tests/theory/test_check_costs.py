import numpy as np
from sample_games import BlockGame, CubicGame

from ptne_env.games import EnergyGame
from ptne_env.theory import check_costs


class ConcaveGame(EnergyGame):
    """The second player's cost has the opposite sign."""

    def costs(self, strategies):
        return super().costs(strategies) * np.array([1, -1, 1, 1, 1])[:, None]


def test_convex_costs_of_unequal_dimensions_pass():
    assert np.all(check_costs(BlockGame()))


def test_concave_cost_is_reported_for_its_player():
    expected = [True, False, True, True, True]
    assert [each.tolist() for each in check_costs(ConcaveGame())] == [expected, expected]


def test_unbounded_decrease_is_not_radial_growth():
    assert check_costs(CubicGame())[1].tolist() == [False, False]
