import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptne_env.games import EnergyGame


def reals(low, high):
    return st.floats(low, high, allow_nan=False, width=64)


@st.composite
def energy_games(draw, most=6):
    players = draw(st.integers(2, most))
    curvature = draw(st.lists(reals(0.2, 5), min_size=players, max_size=players))
    target = draw(st.lists(reals(-40, 40), min_size=players, max_size=players))
    return EnergyGame(curvature, target, coupling=draw(reals(0, 2)), base_price=draw(reals(-20, 20)))


def test_equilibrium_is_that_of_the_paper():
    assert EnergyGame().nash_equilibrium == pytest.approx([2.01465, 6.77656, 11.53846, 16.30037, 21.06227], abs=5e-6)


@given(energy_games())
def test_equilibrium_agrees_with_an_independent_linear_solver(game):
    a, b, c, d = game.curvatures[:, 0], game.targets[:, 0], game.couplings, game.base_price
    players = a.size
    system = np.diag(2 * a + c) + c * np.ones((players, players))
    assert game.nash_equilibrium == pytest.approx(np.linalg.solve(system, 2 * a * b - d), abs=1e-10, rel=1e-10)


def test_costs_are_those_of_the_paper():
    x = np.array([1.0, -2.0, 3.0, 0.5, 4.0])
    targets = [10.0, 15.0, 20.0, 25.0, 30.0]
    expected = [(x[i] - targets[i]) ** 2 + (0.1 * x.sum() + 10) * x[i] for i in range(5)]
    assert EnergyGame().costs(x[:, None])[:, 0] == pytest.approx(expected, rel=1e-14)


def test_the_game_is_aggregative_and_has_a_potential():
    """Others enter a cost through Σ x_j alone, and F is a gradient."""
    game, x = EnergyGame(), np.arange(5.0)[:, None]
    moved = x + np.array([[0.0], [1.0], [-3.0], [2.0], [0.0]])  # the same sum
    assert game.costs(moved)[[0, 4]] == pytest.approx(game.costs(x)[[0, 4]])
    slopes = game.jacobian(x)[:, :, 0]
    assert np.array_equal(slopes, slopes.T)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"curvature": 0.0}, "curvature > 0"),
        (
            {"curvature": [1.0, 1.0]},
            r"curvature \(2,\).* do not fit target \(5,\); give one number for all, or one per player",
        ),
        ({"coupling": -0.1}, "coupling ≥ 0"),
        ({"target": [1.0]}, "at least 2 players"),
        ({"target": 3.0}, "one number per player"),
        ({"target": [1.0, float("nan")]}, "finite"),
    ],
)
def test_bad_parameters_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        EnergyGame(**arguments)
