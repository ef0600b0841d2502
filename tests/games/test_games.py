"""Properties of all games, and the models of single games."""

import numpy as np
import pytest
from derivatives import gradient_error
from sample_games import BlockGame

from ptne_env import theory
from ptne_env.games import (
    ConnectivityControl,
    CournotMarket,
    ElectricVehicleCharging,
    EnergyGame,
    NetworkedCournot,
    NonQuadraticGame,
    Oligopoly,
    QuadraticGame,
    RandomAffine,
    RandomEnergy,
    RandomSaturating,
    RateControl,
    WeaklyMonotoneGame,
    require_strong_monotonicity,
)
from ptne_env.theory import check_costs

HVAC = EnergyGame(target=(50, 55, 60, 65, 70), coupling=0.04, base_price=5.0)
GAMES = {
    "hvac": HVAC,
    "energy, three players": EnergyGame([1.0, 2.0, 0.5], [3.0, -4.0, 5.0], coupling=0.7, base_price=-2.0),
    "cournot": NetworkedCournot(),
    "market": CournotMarket([0.01, 0.5, 2.0, 0.1], [4.0, 2.0, 3.0, 9.0], 10.0, 0.3, [3.0, 9.0, 2.0, 5.0]),
    "oligopoly": Oligopoly(),
    "robots": ConnectivityControl(),
    "charging": ElectricVehicleCharging(),
    "rates": RateControl(),
    "random affine": RandomAffine().representative,
    "random affine in a box": RandomAffine(players=3, action_dim=2, low=-3.0, high=2.0).representative,
    "weakly monotone": WeaklyMonotoneGame(),
    "saturating": RandomSaturating(RandomEnergy(4)).representative,
    "saturating, unequal dimensions": RandomSaturating(RandomAffine(players=3, action_dim=(2, 1, 3))).representative,
}
EPSILON = {"hvac": 2.04, "charging": 0.8, "random affine": 1.0, "random affine in a box": 1.0, "weakly monotone": 0.0}
"""ε, where the docstring states it."""
BELOW = {"cournot": 0.9, "market": 0.32, "oligopoly": 0.92, "robots": 0.6 * 2, "rates": 0.4}
"""Lower bounds of ε in the docstrings; for the oligopoly, Gershgorin's bound of its rows."""
each_game = pytest.mark.parametrize("game", GAMES.values(), ids=GAMES.keys())
FURTHER = {
    "energy": EnergyGame(),
    "non-quadratic": NonQuadraticGame(),
    "non-quadratic, printed": NonQuadraticGame("printed"),
    "blocks": BlockGame(),
    "other blocks": BlockGame((1, 4, 2, 1), seed=9),
}
any_game = pytest.mark.parametrize("game", (GAMES | FURTHER).values(), ids=(GAMES | FURTHER).keys())


def sampled(game, count, seed=0):
    """Strategies within the box, or around the equilibrium."""
    points = game.nash_equilibria[:, :1] + np.random.default_rng(seed).uniform(-5, 5, (game.dimension, count))
    return game.project(points)


def deviations(game, point, player, count, seed):
    """``point`` (n,) with the player's block moved in its box by steps of all sizes."""
    generator = np.random.default_rng(seed)
    moved = np.repeat(point[:, None], count, axis=1)
    reach = np.logspace(-4, 1, count)
    own = game.owners == player
    moved[own] += reach * generator.normal(size=(own.sum(), count))
    return game.project(moved)


@each_game
def test_own_gradients_are_derivatives_of_convex_costs(game):
    assert gradient_error(game) < 1e-9
    assert np.all(check_costs(game))


@any_game
def test_jacobian_is_the_derivative_of_the_pseudo_gradient(game):
    points, step = sampled(game, 3), 1e-6
    jacobian = game.jacobian(points)
    assert jacobian.shape == (game.dimension, game.dimension, 3)
    for component in range(game.dimension):
        forward, backward = points.copy(), points.copy()
        forward[component] += step
        backward[component] -= step
        slope = (game.pseudo_gradient(forward) - game.pseudo_gradient(backward)) / (2 * step)
        assert jacobian[:, component] == pytest.approx(slope, rel=1e-6, abs=1e-6)


@any_game
def test_own_gradient_depends_only_on_the_own_estimate(game):
    generator = np.random.default_rng(1)
    estimates = generator.uniform(0, 2, (game.dimension, game.num_players, 2))
    gradients = game.own_gradients(estimates)
    for player in range(game.num_players):
        scrambled = generator.uniform(0, 2, estimates.shape)
        scrambled[:, player] = estimates[:, player]
        own = game.owners == player
        assert np.array_equal(game.own_gradients(scrambled)[own], gradients[own])


@each_game
def test_equilibrium_solves_the_variational_inequality(game):
    point = game.nash_equilibria
    assert np.array_equal(point, game.project(point))
    assert np.abs(game.natural_residual(point)).max() < 1e-12 * (1 + np.abs(point).max())
    # The definition: F(x*)ᵀ(y − x*) ≥ 0 for every y in the box.
    others = sampled(game, 200, seed=2)
    assert ((others - point) * game.pseudo_gradient(point)).sum(axis=0).min() > -1e-9


@each_game
def test_unilateral_deviations_from_the_equilibrium_cost_more(game):
    at_rest = game.costs(game.nash_equilibria)[:, 0]
    for player in range(game.num_players):
        moved = deviations(game, game.nash_equilibria[:, 0], player, 300, seed=player)
        cost = game.costs(moved)[player]
        assert cost.min() >= at_rest[player] - 1e-9 * (1 + abs(at_rest[player]))
        assert cost.max() > at_rest[player]


@each_game
def test_best_response_beats_sampled_strategies_in_the_box(game):
    points = sampled(game, 4, seed=3)
    response = game.best_response(points)
    assert np.array_equal(response, game.project(response))
    for environment in range(4):
        for player in range(game.num_players):
            own = game.owners == player
            chosen = np.where(own, response[:, environment], points[:, environment])
            best = game.costs(chosen[:, None])[player, 0]
            others = deviations(game, chosen, player, 200, seed=player)
            assert game.costs(others)[player].min() >= best - 1e-9 * (1 + abs(best))


@each_game
def test_regrets_are_zero_only_at_the_equilibrium(game):
    assert np.abs(game.regrets(game.nash_equilibria)).max() < 1e-9
    regrets = game.regrets(sampled(game, 20, seed=4))
    assert regrets.min() > -1e-9
    assert regrets.sum(axis=0).min() > 1e-3


@pytest.mark.parametrize("name", EPSILON | BELOW)
def test_monotonicity_constant_is_that_of_the_docstring_or_more(name):
    constants = theory.monotonicity_constants(GAMES[name])
    assert constants.exact == GAMES[name].is_affine
    assert constants.epsilon >= (EPSILON | BELOW)[name] - 1e-12
    assert name in BELOW or constants.epsilon <= EPSILON[name] + 1e-12


# --- single games -----------------------------------------------------------------------------------------------------


def test_equilibrium_of_the_hvac_game_of_ye_and_hu():
    assert HVAC.nash_equilibrium == pytest.approx([41.535, 46.437, 51.339, 56.241, 61.143], abs=5e-4)


def test_robots_equilibrium_solves_its_linear_system():
    game, touch = ConnectivityControl(), ConnectivityControl._TOUCH
    laplacian = np.diag(touch.sum(axis=1)) - touch
    places = np.linalg.solve(0.6 * np.eye(5) + laplacian, 0.6 * ConnectivityControl._POSTS)
    assert game.nash_equilibrium.reshape(5, 2) == pytest.approx(places, abs=1e-12)
    assert not np.array_equal(touch, touch.T)  # not a potential game


def test_robots_costs_are_weighted_squared_distances():
    game, x = ConnectivityControl(), np.random.default_rng(0).normal(size=(10, 1))
    at = x.reshape(5, 2)
    for i in range(5):
        cost = 0.6 * np.sum((at[i] - ConnectivityControl._POSTS[i]) ** 2)
        cost += sum(ConnectivityControl._TOUCH[i, j] * np.sum((at[i] - at[j]) ** 2) for j in range(5))
        assert game.costs(x)[i, 0] == pytest.approx(cost, rel=1e-13)


def test_cournot_prices_fall_with_total_sales():
    links = ((0, 1), (1,), (0, 2), (1, 2), (0,))
    price, slope = np.array([14.0, 12.0, 10.0]), np.array([0.6, 0.5, 0.4])
    curvature, marginal = (0.6, 0.8, 0.5, 0.7, 0.9), (2.0, 3.0, 8.5, 4.0, 2.5)
    game, x = NetworkedCournot(), np.random.default_rng(1).uniform(0, 3, 8)
    sold, sales = np.zeros(3), iter(x)
    deliveries = [[(market, next(sales)) for market in row] for row in links]
    for row in deliveries:
        for market, amount in row:
            sold[market] += amount
    for firm, row in enumerate(deliveries):
        cost = sum(
            curvature[firm] * amount**2 / 2
            + marginal[firm] * amount
            - (price[market] - slope[market] * sold[market]) * amount
            for market, amount in row
        )
        assert game.costs(x[:, None])[firm, 0] == pytest.approx(cost, rel=1e-12)


def test_cournot_equilibrium_has_components_at_both_bounds():
    game = NetworkedCournot()
    at, held = game.nash_equilibrium, game.held_at_equilibrium[:, 0]
    assert held.tolist() == [True, True, False, False, True, False, False, True]
    assert at[held] == pytest.approx([4.0, 4.0, 0.0, 4.0], abs=0)


def test_charging_costs_are_wear_plus_missing_energy_plus_bill():
    game, x = ElectricVehicleCharging(), np.random.default_rng(2).uniform(0, 2, 20)
    power, load = x.reshape(5, 4), np.array([8.0, 3.0, 1.0, 5.0])
    price = 0.3 * (load + power.sum(axis=0))
    for i, energy in enumerate((4.0, 5.0, 6.0, 7.0, 8.0)):
        cost = 0.25 * np.sum(power[i] ** 2) + 0.5 * (power[i].sum() - energy) ** 2 + price @ power[i]
        assert game.costs(x[:, None])[i, 0] == pytest.approx(cost, rel=1e-13)


def test_rates_satisfy_first_order_conditions_of_free_users():
    game = RateControl()
    x = game.nash_equilibrium
    routes, congestion = ((0,), (0, 1), (1, 2), (2,), (0, 2)), (0.4, 0.5, 0.3)
    load = [sum(x[user] for user, row in enumerate(routes) if link in row) for link in range(3)]
    for user, weight in enumerate((6.0, 8.0, 9.0, 7.0, 10.0)):
        slope = -weight / (1 + x[user]) + sum(congestion[link] * (load[link] + x[user]) for link in routes[user])
        if user == 3:  # at its limit, with a falling cost
            assert x[user] == 2.0
            assert slope < -0.1
        else:
            assert slope == pytest.approx(0, abs=1e-12)


def test_oligopoly_divides_demand_like_a_current():
    game = Oligopoly()
    x = np.random.default_rng(3).uniform(20, 60, 4)
    resistance, marginal = np.array([0.15, 0.30, 0.60, 1.0]), np.array([30.0, 30.0, 25.0, 20.0])
    parallel = 1 / np.sum(1 / resistance)
    for i in range(4):
        others = np.arange(4) != i
        around = 1 / np.sum(1 / resistance[others])
        sales = parallel / resistance[i] * (100 - x[i] / around + np.sum(x[others] / resistance[others]))
        assert game.sales(x[:, None])[i, 0] == pytest.approx(sales, rel=1e-12)
        assert game.costs(x[:, None])[i, 0] == pytest.approx(-sales * (x[i] - marginal[i]), rel=1e-12)
    assert game.sales(x[:, None]).sum() == pytest.approx(100)  # total sales are the demand


def test_weakly_monotone_game_satisfies_assumption_3_but_not_4():
    game = WeaklyMonotoneGame()
    jacobian = game.jacobian(np.zeros((5, 1)))[:, :, 0]
    assert np.linalg.eigvalsh(jacobian + jacobian.T)[:2] == pytest.approx([0.0, 4.0], abs=1e-14)
    assert abs(np.linalg.det(jacobian)) > 1
    assert np.all(check_costs(game))
    with pytest.raises(ValueError, match="not strongly monotone"):
        require_strong_monotonicity(game)


def test_numbers_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="finite parameters"):
        QuadraticGame(np.eye(2), [1.0, np.nan])
