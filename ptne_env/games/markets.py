"""Markets: Cournot competition on a network of markets, and an oligopoly in prices."""

from __future__ import annotations

import numpy as np

from ptne_env.games.affine import AffineGame, times
from ptne_env.shared.arrays import FloatArray, frozen

_LINKS = ((0, 1), (1,), (0, 2), (1, 2), (0,))
"""The markets that each firm is linked to."""

_FIRMS = (0.6, 0.8, 0.5, 0.7, 0.9), (2.0, 3.0, 8.5, 4.0, 2.5), (4.0, 6.0, 3.0, 5.0, 4.0)
"""q_i of the cost of production, marginal cost c_i and capacity X_i of each firm."""


class NetworkedCournot(AffineGame):
    """J_i(x) = Σ_{m∈M_i} [½ q_i x_im² + c_i x_im − (P_m − χ_m Σ_k x_km) x_im], 0 ≤ x_im ≤ X_i.

    Firm i sells x_im in each market m ∈ M_i that it is linked to, at a price that falls with the total sales there, up
    to its capacity per market. F is strongly monotone with ε ≥ min (q_i + χ_m), for dF = diag(q_i + χ_m) + Bᵀ diag(χ) B
    with B the incidence matrix of markets and deliveries. The model is that of K. Bimpikis, S. Ehsani and R. Ilkiliç,
    "Cournot competition in networked markets", Management Science 65(6), 2019, with linear demand, and a capacity; the
    numbers are ours. At their equilibrium two firms are at capacity, and one delivery is 0.
    """

    def __init__(self) -> None:
        prices, slopes = np.array([14.0, 12.0, 10.0]), np.array([0.6, 0.5, 0.4])
        markets = np.array([market for row in _LINKS for market in row])
        dims = [len(row) for row in _LINKS]
        curvatures, costs, capacities = (np.repeat(values, dims) for values in _FIRMS)
        deliveries = markets == np.arange(prices.size)[:, None]
        shared = deliveries.T @ np.diag(slopes) @ deliveries
        super().__init__(
            np.diag(curvatures + slopes[markets]) + shared, costs - prices[markets], dims, low=0.0, high=capacities
        )


class Oligopoly(AffineGame):
    """J_i(x) = −s_i(x) (x_i − m_i), sales s_i = (R_∥/R_i) (S − x_i/R̄_i + Σ_{j≠i} x_j/R_j), prices x.

    With 1/R_∥ = Σ 1/R_k and 1/R̄_i = Σ_{k≠i} 1/R_k. Consumers of total demand S split like a current over resistors:
    a small R_i means that they prefer firm i. Minus the profit is minimised; dF is symmetric and diagonally dominant,
    so F is strongly monotone. The model is that of P. Frihauf, M. Krstić and T. Başar, "Nash equilibrium seeking in
    noncooperative games", IEEE Transactions on Automatic Control 57(5), 2012, where prices need not be known to
    competitors. The numbers are ours.
    """

    def __init__(self) -> None:
        resistances, marginal, demand = np.array([0.15, 0.30, 0.60, 1.0]), np.array([30.0, 30.0, 25.0, 20.0]), 100.0
        conductances = 1 / resistances
        parallel = 1 / conductances.sum()
        others = conductances.sum() - conductances
        # s = sales + response x, with −response/diagonal the own effect
        response = parallel * conductances[:, None] * conductances
        np.fill_diagonal(response, -parallel * conductances * others)
        self._response, self._sales = frozen(response[:, :, None]), frozen(parallel * demand * conductances[:, None])
        self.marginal_cost = frozen(marginal[:, None])
        own = np.diag(response)
        matrix = -response - np.diag(own)
        super().__init__(matrix, own * marginal - self._sales[:, 0])

    def sales(self, strategies: FloatArray) -> FloatArray:
        """s_i(x): (N, B) to (N, B)."""
        return times(self._response, strategies) + self._sales

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x), minus the profit: (N, B) to (N, B)."""
        return -self.sales(strategies) * (strategies - self.marginal_cost)
