"""Markets: the table of the IEEE 118-bus case, and equilibria that other solvers and definitions confirm."""

import networkx as nx
import numpy as np
import pytest
import scipy
from sample_games import generators

from ptne_env.games import CournotMarket, Market118
from ptne_env.games.market import LOAD, PRICE
from ptne_env.games.market import generators as generators_of_the_case
from ptne_env.world.graphs import market_118


def test_the_table_is_the_case():
    case, graph = generators_of_the_case(), nx.from_numpy_array(market_118().adjacency)
    assert len(case["capacity"]) == 54
    assert case["capacity"].sum() == pytest.approx(9966.2)
    assert case["quadratic"].max() / case["quadratic"].min() == pytest.approx(250)
    assert set(case["linear"]) == {20.0, 40.0}
    assert (graph.number_of_edges(), market_118().largest_degree, nx.diameter(graph)) == (157, 16, 7)
    assert market_118().algebraic_connectivity == pytest.approx(0.157, abs=5e-4)
    # Generation at least cost meets the load at the stated price, within its two decimals.
    supply = [
        np.clip((price - case["linear"]) / (2 * case["quadratic"]), 0, case["capacity"]).sum()
        for price in (PRICE - 0.005, PRICE + 0.005)
    ]
    assert supply[0] < LOAD < supply[1]


def test_demand_passes_through_the_load_with_the_elasticity():
    market = Market118(elasticity=0.25).representative
    outputs = np.full((54, 1), LOAD / 54)
    assert market.price(outputs) == pytest.approx(PRICE)
    more = market.price(1.01 * outputs)
    assert (more - PRICE) / PRICE == pytest.approx(-0.01 / 0.25)


def test_equilibria_are_those_of_another_solver_and_no_firm_earns_more_by_another_output():
    markets = Market118().draw(generators(range(20)))
    matrix, at_rest = markets.matrices, markets.nash_equilibria
    for hour in range(20):  # costs are those of a potential, a quadratic programme, here as least squares in a box
        root = np.linalg.cholesky(matrix[:, :, hour])
        right = -scipy.linalg.solve_triangular(root, markets.offsets[:, hour], lower=True)
        other = scipy.optimize.lsq_linear(root.T, right, (0, markets.high), method="bvls", tol=1e-14)
        np.testing.assert_allclose(at_rest[:, hour], other.x, atol=1e-6)
    profits = -markets.costs(at_rest)
    by_hand = markets.price(at_rest) * at_rest - markets.quadratic * at_rest**2 - markets.linear * at_rest
    np.testing.assert_allclose(profits, by_hand, atol=1e-6)
    for share in np.linspace(0, 1, 11):
        for firm in range(54):
            moved = at_rest.copy()
            moved[firm] = share * markets.high[firm]
            assert np.all(-markets.costs(moved)[firm] <= profits[firm] + 1e-9)


def test_in_an_hour_some_firms_stop_and_some_are_at_capacity():
    markets = Market118().draw(generators(range(50)))
    outputs = markets.nash_equilibria
    assert ((outputs == 0).sum(axis=0) > 0).all()
    assert ((outputs == markets.high[:, None]).sum(axis=0) > 0).mean() > 0.95
    assert (markets.held_at_equilibrium.sum(axis=0) < 40).all()


def test_wrong_markets_are_refused():
    with pytest.raises(ValueError, match=r"one number per firm .*got the shapes \(2,\) and \(3,\)"):
        CournotMarket([1.0, 1.0], [1.0, 2.0, 3.0], 10.0, 0.1, 5.0)
    with pytest.raises(ValueError, match="slope must be a finite number above 0"):
        CournotMarket([1.0, 1.0], [1.0, 2.0], 10.0, 0.0, 5.0)
    with pytest.raises(ValueError, match="fuel must be a probability"):
        Market118(fuel=1.5)
