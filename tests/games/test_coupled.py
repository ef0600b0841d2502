"""Games with a shared constraint: the priced equilibrium is the variational generalised Nash equilibrium."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_games import generators
from worlds import make_env

from ptne_env import FactorySpec, evaluate, get_scenario, theory
from ptne_env.games import (
    CoupledConstraint,
    EnergyGame,
    NetworkedCournot,
    NoBestResponseError,
    NonQuadraticGame,
    QuadraticGame,
    RandomAffine,
    RandomEnergy,
    price_constraint,
)

PLAYERS = 5


def parts_of(game, lines):
    """F's matrix and offset of the players, C and b of one priced game."""
    n = game.dimension - lines
    matrix, offset = game.matrices[..., 0], game.offsets[:, 0]
    return matrix[:n, :n], offset[:n], -matrix[n:, :n], offset[n:]


def kkt_residual(game, lines):
    """The largest violation of the Karush–Kuhn–Tucker conditions of the variational generalised equilibrium."""
    matrix, offset, rows, limit = parts_of(game, lines)
    x, prices = np.split(game.nash_equilibrium, [len(offset)])
    slack = limit - rows @ x
    stationary = matrix @ x + offset + rows.T @ prices
    return np.abs([*stationary, *np.minimum(slack, 0), *np.minimum(prices, 0), *(slack * prices)]).max()


@given(
    seed=st.integers(0, 2**32 - 1),
    lines=st.integers(1, 3),
    dims=st.sampled_from([1, (1, 2, 1, 3)]),
    epsilon=st.sampled_from([0.3, 1.0]),
)
def test_priced_equilibrium_satisfies_the_conditions_of_the_variational_equilibrium(seed, lines, dims, epsilon):
    family = CoupledConstraint(RandomAffine(players=4, epsilon=epsilon, action_dim=dims), lines=lines)
    game = family.draw(generators([seed]))
    assert kkt_residual(game, lines) < 1e-9 * (1 + np.abs(game.nash_equilibrium).max() ** 2)


def test_equilibrium_in_a_half_space_has_a_closed_form():
    game, row = EnergyGame(), np.ones((1, 5))
    matrix, free = game.jacobian(np.zeros((5, 1)))[..., 0], game.nash_equilibrium
    limit = free.sum() - 10.0
    price = 10.0 / np.linalg.solve(matrix, np.ones(5)).sum()
    expected = [*(free - price * np.linalg.solve(matrix, np.ones(5))), price]
    assert price_constraint(game, row, [limit]).nash_equilibrium == pytest.approx(expected, abs=1e-10)
    assert price_constraint(game, row, [limit + 20.0]).nash_equilibrium == pytest.approx([*free, 0.0], abs=1e-10)


def test_constraint_is_active_in_most_draws():
    prices = CoupledConstraint(RandomEnergy()).draw(generators(range(500))).nash_equilibria[PLAYERS:]
    assert 0.45 < (prices > 0).mean() < 0.65
    assert (prices > 0).any(axis=0).mean() > 0.9
    assert (prices == 0).any()


def test_bounds_of_the_players_stay():
    game = NetworkedCournot()
    rows = np.ones((1, game.dimension))
    limit = 0.8 * game.nash_equilibrium.sum()
    shared = price_constraint(game, rows, [limit])
    assert np.array_equal(shared.box[0][:-1], game.box[0])
    assert np.array_equal(shared.box[1][:-1], game.box[1])
    assert (shared.box[0][-1, 0], shared.box[1][-1, 0]) == (0.0, np.inf)
    assert shared.nash_equilibrium[:-1].sum() == pytest.approx(limit)


def test_operator_has_no_best_response_and_regret_is_unknown():
    family = CoupledConstraint(RandomEnergy())
    game = family.draw(generators([0]))
    assert not game.has_best_response
    with pytest.raises(NoBestResponseError, match="flat direction"):
        game.regrets(np.zeros((7, 1)))
    results = evaluate(["static"], [SCENARIO], episodes=2)
    assert np.isnan(results.samples[SCENARIO.name, "static"]["regret"]).all()


SCENARIO = get_scenario(
    "random-energy",
    name="coupled",
    game=FactorySpec.of("game:coupled", game=FactorySpec.of("game:random-energy", players=4), lines=1),
)


def test_environment_plays_a_priced_game_and_prices_stay_above_zero():
    env = make_env(SCENARIO)
    env.reset(seed=0)
    for _ in range(5):
        env.step({agent: env.action_space(agent).low for agent in env.agents})
    assert env.strategies[-1] == 0.0


def test_certificates_of_priced_games_say_that_they_are_monotone_only():
    certificate = theory.certify(SCENARIO, "law:relay")
    assert certificate.assumptions[4].verdict == "fails"
    assert certificate.condition.name.startswith("F is strongly monotone")
    assert not certificate.condition.holds


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"game": NetworkedCournot()}, "needs an affine game without bounds.*got NetworkedCournot"),
        ({"game": RandomEnergy(), "lines": 0}, "lines must be"),
        ({"game": NonQuadraticGame()}, "needs an affine game without bounds.*got NonQuadraticGame"),
    ],
)
def test_wrong_arguments_of_the_family_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        CoupledConstraint(**arguments)


@pytest.mark.parametrize(("rows", "limit"), [(np.ones((1, 4)), [1.0]), (np.ones((1, 5)), [1.0, 2.0])])
def test_constraints_of_another_shape_are_refused(rows, limit):
    with pytest.raises(ValueError, match=r"constraint is \(m, 5\) and limit \(m,\)"):
        price_constraint(EnergyGame(), rows, limit)


@pytest.mark.parametrize("constraint", [np.ones((1, 2)), lambda x: [x[0] - 1]])
def test_a_family_has_no_price_and_several_games_have_one_where_all_is_affine(constraint):
    family = RandomEnergy(players=2)
    with pytest.raises(ValueError, match="one game, got a RandomEnergy; a family of affine games goes into"):
        price_constraint(family, constraint)
    if callable(constraint):
        with pytest.raises(ValueError, match=r"the constraint is a matrix, got 3 games; the operator of others is one"):
            price_constraint(family.draw(generators(range(3))), constraint)


def at_most_one_and_at_least_two(x):
    return [x[0] - 1, 2 - x[0]]


def test_a_constraint_that_no_strategy_satisfies_has_no_equilibrium():
    """Prices rise without end there, and beside a price of 1e16 no residual counts."""
    game = QuadraticGame(np.eye(2), np.zeros(2))
    rows, limits = np.array([[1.0, 0.0], [-1.0, 0.0]]), [1.0, -2.0]
    for infeasible in (price_constraint(game, at_most_one_and_at_least_two), price_constraint(game, rows, limits)):
        with pytest.raises(ArithmeticError, match="a shared constraint that no strategy satisfies has none"):
            _ = infeasible.nash_equilibria
