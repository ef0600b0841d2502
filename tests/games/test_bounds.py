"""Bounded strategies in games, worlds, checks and theory."""

import numpy as np
import pytest
from derivatives import gradient_error
from sample_games import BlockGame
from worlds import make_env

from ptne_env import get_scenario, theory
from ptne_env.games import EnergyGame, Game
from ptne_env.theory import check_costs
from ptne_env.world.world import World


class BoxedEnergy(EnergyGame):
    """The energy game in a box, solved by the base class."""

    low: object = None
    high: object = None

    def best_response(self, strategies):
        return self.project(super().best_response(strategies))

    def _solve_nash_equilibria(self):
        return Game._solve_nash_equilibria(self)


class NarrowLog(Game):
    """J_i = x_i² − log(x_i), undefined at x_i ≤ 0, close to the box."""

    action_dims = (1, 1)
    low, high = 0.001, 0.05

    def costs(self, strategies):
        if np.any(strategies <= 0):
            raise AssertionError("cost evaluated outside its domain")
        return strategies**2 - np.log(strategies)

    def own_gradients(self, estimates):
        own = np.einsum("iib->ib", estimates)
        return 2 * own - 1 / own

    def best_response(self, strategies):
        return np.full_like(strategies, 0.05)


@pytest.mark.parametrize(
    ("low", "high"), [(3.0, 2.0), (1.0, 1.0), (float("nan"), 2.0), ([0.0, 0.0], 1.0), (0.0, np.ones((3, 2)))]
)
def test_empty_or_misshapen_boxes_are_refused(low, high):
    with pytest.raises(ValueError, match=r"low < high|give one number for all"):
        BoxedEnergy(low=low, high=high)


def test_one_bound_is_enough_and_the_other_is_infinite():
    game = BoxedEnergy(low=5.0)
    assert game.box is not None
    assert game.box[1].tolist() == [[np.inf]] * 5
    matrix = game.jacobian(np.zeros((5, 1)))[1:, :, 0]
    rest = np.linalg.solve(matrix[:, 1:], 2 * game.targets[1:, 0] - 10 - matrix[:, 0] * 5.0)
    assert game.nash_equilibrium == pytest.approx([5.0, *rest], abs=1e-12)
    assert game.held_at_equilibrium[:, 0].tolist() == [True, False, False, False, False]


def test_start_outside_the_box_is_projected():
    env = make_env("ev-charging")
    env.reset(options={"estimates": np.full((5, 20), 50.0)})
    assert np.array_equal(env.strategies, np.full(20, 2.0))
    assert np.sum(env.estimates == 50.0) == 5 * 20 - 20


def test_check_samples_only_inside_the_box():
    assert gradient_error(NarrowLog()) < 1e-9
    assert np.all(check_costs(NarrowLog()))
    assert NarrowLog().nash_equilibrium == pytest.approx([0.05, 0.05], abs=0)


def test_growth_is_checked_in_unbounded_directions():
    class Falling(BlockGame):
        """The first player's cost is unbounded below along its first component."""

        low: object = None
        high: object = None

        def costs(self, strategies):
            return super().costs(strategies) - np.eye(3)[:, :1] * 1e6 * strategies[0]

    assert check_costs(Falling())[1].tolist() == [False, True, True]
    for low, high, expected in [(-2.0, None, False), (None, 2.0, True), (-2.0, 2.0, True)]:
        free = (np.inf,) * 5
        game = Falling(low=(-np.inf if low is None else low, *np.negative(free)), high=(high or np.inf, *free))
        assert check_costs(game)[1][0] == expected


def test_theory_samples_only_inside_the_box():
    constants = theory.monotonicity_constants(World(get_scenario("rate-control")).game, radius=100.0)
    assert 0.4 < constants.epsilon < constants.iota < 15
    assert constants.radius == 100.0
