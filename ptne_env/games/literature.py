"""Games of the literature, with numbers of ours, and the weakly monotone game."""

from __future__ import annotations

import numpy as np

from ptne_env.games.affine import AffineGame, times
from ptne_env.games.base import Game
from ptne_env.shared.arrays import FloatArray, array_namespace, freeze, ordered_sum, product


class ElectricVehicleCharging(AffineGame):
    """J_i(x) = ½ q ‖x_i‖² + ½ ρ (Σ_t x_it − E_i)² + Σ_t a (D_t + Σ_k x_kt) x_it, 0 ≤ x_it ≤ X.

    Vehicle i charges x_it in time interval t. It pays for battery wear, for missing its energy E_i, and a price per
    interval that rises with the total of the base load D_t and all vehicles. An aggregative game, after Z. Ma, D.
    Callaway and I. Hiskens, "Decentralized charging control of large populations of plug-in electric vehicles", IEEE
    Transactions on Control Systems Technology 21(1), 2013; there the energy is a constraint, here a penalty, so that
    the only constraint is a box. The numbers are ours. dF = (q + a) I + ρ blockdiag(11ᵀ) + a 11ᵀ⊗I, so F is strongly
    monotone with ε ≥ q + a.
    """

    _ENERGY, _LOAD = freeze([4.0, 5.0, 6.0, 7.0, 8.0]), freeze([8.0, 3.0, 1.0, 5.0])  # E_i and D_t
    _WEAR, _PENALTY, _PRICE = 0.5, 1.0, 0.3  # q, ρ and a
    action_dims = (4,) * 5
    low, high = 0.0, 2.0
    matrix = freeze(
        (_WEAR + _PRICE) * np.eye(20)
        + _PENALTY * np.kron(np.eye(5), np.ones((4, 4)))
        + _PRICE * np.kron(np.ones((5, 5)), np.eye(4))
    )
    offset = freeze((_PRICE * _LOAD - _PENALTY * _ENERGY[:, None]).ravel())

    def costs(self, strategies: FloatArray) -> FloatArray:
        power = strategies.reshape(self.num_players, self._LOAD.size, -1)
        total = ordered_sum(power)
        bill = self._PRICE * (self._LOAD[:, None] + total) * power
        missing = self.summed(strategies) - self._ENERGY[:, None]
        wear = self._WEAR * strategies**2 / 2
        return self.summed(wear + bill.reshape(strategies.shape)) + self._PENALTY * missing**2 / 2


class NetworkedCournot(AffineGame):
    """J_i(x) = Σ_{m∈M_i} [½ q_i x_im² + c_i x_im − (P_m − χ_m Σ_k x_km) x_im], 0 ≤ x_im ≤ X_i.

    Firm i sells x_im in each market m ∈ M_i that it is linked to, at a price that falls with the total sales there, up
    to its capacity per market. F is strongly monotone with ε ≥ min (q_i + χ_m), for dF = diag(q_i + χ_m) + Bᵀ diag(χ) B
    with B the incidence matrix of markets and deliveries. The model is that of K. Bimpikis, S. Ehsani and R. Ilkiliç,
    "Cournot competition in networked markets", Management Science 65(6), 2019, with linear demand, and a capacity; the
    numbers are ours. At their equilibrium two firms are at capacity, and one delivery is 0.
    """

    _PRICES, _SLOPES = freeze([14.0, 12.0, 10.0]), freeze([0.6, 0.5, 0.4])  # P_m and χ_m
    _MARKETS = np.array([0, 1, 1, 0, 2, 1, 2, 0])  # the market of each delivery
    _DELIVERIES = np.arange(3)[:, None] == _MARKETS  # B
    action_dims = (2, 1, 2, 2, 1)
    low, high = 0.0, freeze(np.repeat((4.0, 6.0, 3.0, 5.0, 4.0), action_dims))  # X_i
    matrix = freeze(
        np.diag(np.repeat((0.6, 0.8, 0.5, 0.7, 0.9), action_dims) + _SLOPES[_MARKETS])  # q_i + χ_m
        + _DELIVERIES.T @ np.diag(_SLOPES) @ _DELIVERIES
    )
    offset = freeze(np.repeat((2.0, 3.0, 8.5, 4.0, 2.5), action_dims) - _PRICES[_MARKETS])  # c_i − P_m


class Oligopoly(AffineGame):
    """J_i(x) = −s_i(x) (x_i − m_i), sales s_i = (R_∥/R_i) (S − x_i/R̄_i + Σ_{j≠i} x_j/R_j), prices x.

    With 1/R_∥ = Σ 1/R_k and 1/R̄_i = Σ_{k≠i} 1/R_k. Consumers of total demand S split like a current over resistors:
    a small R_i means that they prefer firm i. Minus the profit is minimised; dF is symmetric and diagonally dominant,
    so F is strongly monotone. The model is that of P. Frihauf, M. Krstić and T. Başar, "Nash equilibrium seeking in
    noncooperative games", IEEE Transactions on Automatic Control 57(5), 2012, where prices need not be known to
    competitors. The numbers are ours.
    """

    _CONDUCTANCES, _MARGINAL_COSTS = 1 / np.array([0.15, 0.30, 0.60, 1.0]), np.array([30.0, 30.0, 25.0, 20.0])
    _PARALLEL, _OTHERS = 1 / _CONDUCTANCES.sum(), _CONDUCTANCES.sum() - _CONDUCTANCES  # R_∥ and 1/R̄_i
    _OWN = -_PARALLEL * _CONDUCTANCES * _OTHERS  # ∂s_i/∂x_i
    _RESPONSE = np.where(np.eye(4, dtype=bool), _OWN, _PARALLEL * _CONDUCTANCES[:, None] * _CONDUCTANCES)  # ∂s_i/∂x_j
    _DEMAND = _PARALLEL * 100.0 * _CONDUCTANCES  # s_i(0)
    matrix = freeze(-_RESPONSE - np.diag(_OWN))
    offset = freeze(_OWN * _MARGINAL_COSTS - _DEMAND)

    def sales(self, strategies: FloatArray) -> FloatArray:
        """s_i(x): (N, B) to (N, B)."""
        return times(self._RESPONSE[:, :, None], strategies) + self._DEMAND[:, None]

    def costs(self, strategies: FloatArray) -> FloatArray:
        return -self.sales(strategies) * (strategies - self._MARGINAL_COSTS[:, None])


class ConnectivityControl(AffineGame):
    """J_i(x) = w_i ‖x_i − p_i‖² + Σ_j c_ij ‖x_i − x_j‖²: robots in the plane stay near their posts p_i.

    Connectivity control of mobile sensors, after M. S. Stanković, K. H. Johansson and D. M. Stipanović, "Distributed
    seeking of Nash equilibria with applications to mobile sensor networks", IEEE Transactions on Automatic Control
    57(4), 2012; the numbers are ours. c need not be symmetric, so the game is no potential game. With L_c = diag(Σ_j
    c_ij) − c the equilibrium is X = (diag(w) + L_c)⁻¹ diag(w) P, one column per coordinate, and F is strongly monotone
    where diag(w) + (L_c + L_cᵀ)/2 is positive definite. Coordinates of a robot are adjacent components.
    """

    _POSTS = freeze([(8.0, 0.0), (2.0, 8.0), (-7.0, 5.0), (-6.0, -5.0), (3.0, -7.0)])  # p_i
    _PULL = 0.6  # w_i of every robot
    _TOUCH = freeze(0.6 * np.roll(np.eye(5), 1, axis=1) + 0.2 * np.roll(np.eye(5), -1, axis=1))  # c_ij on a ring
    action_dims = (2,) * 5
    matrix = freeze(np.kron(2 * (np.diag(_PULL + _TOUCH.sum(axis=1)) - _TOUCH), np.eye(2)))
    offset = freeze(-2 * (_PULL * _POSTS).ravel())

    def costs(self, strategies: FloatArray) -> FloatArray:
        at = strategies.reshape(self.num_players, 2, -1)
        from_post = ordered_sum((at - self._POSTS[:, :, None]) ** 2, axis=1)
        apart = ordered_sum((at[:, None] - at[None]) ** 2, axis=2)
        return self._PULL * from_post + ordered_sum(self._TOUCH[:, :, None] * apart, axis=1)


class RateControl(Game):
    """J_i(x) = −w_i log(1 + x_i) + x_i Σ_{l∈route i} a_l Σ_{k uses l} x_k, 0 ≤ x_i ≤ X_i.

    Users weigh a logarithmic utility, as TCP's proportional fairness does, against a congestion price of every link on
    their route that is linear in the link's load; after T. Alpcan and T. Başar, "A game-theoretic framework for
    congestion control in general topology networks", IEEE Conference on Decision and Control, 2002. The numbers are
    ours. dF = diag(w_i/(1 + x_i)² + Σ_{l∈route i} a_l) + Rᵀ diag(a) R with R the routing matrix, so F is strongly
    monotone on x > −1 with ε ≥ min_i Σ_{l∈route i} a_l. Costs are defined for x_i > −1 only, which the box ensures.
    """

    _UTILITIES = freeze([6.0, 8.0, 9.0, 7.0, 10.0])[:, None]  # w_i
    _ROUTES = np.array([[1.0, 1, 0, 0, 1], [0, 1, 1, 0, 0], [0, 0, 1, 1, 1]])  # R: a row per link, a column per user
    # Entry (i, k) is the sum of the prices a_l of the links that users i and k share.
    _SHARED = freeze((_ROUTES.T @ np.diag([0.4, 0.5, 0.3]) @ _ROUTES)[:, :, None])
    _OWN = freeze(np.diag(_SHARED[:, :, 0])[:, None])
    action_dims = (1,) * 5
    low, high = 0.0, (2.0, 4.0, 4.0, 2.0, 4.0)

    def costs(self, strategies: FloatArray) -> FloatArray:
        logarithms = array_namespace(strategies).log1p(strategies)
        return strategies * times(self._SHARED, strategies) - self._UTILITIES * logarithms

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """−w_i/(1 + x^i_i) + Σ_{l∈route i} a_l (x^i_i + Σ_{k uses l} x^i_k): (N, N, B) to (N, B)."""
        xp = array_namespace(estimates)
        own = xp.einsum("iib->ib", estimates)
        # _SHARED is symmetric, so its row for player i is its column
        load = xp.add.reduce(product(self._SHARED, estimates), axis=0)
        gradients: FloatArray = load + self._OWN * own - self._UTILITIES / (1 + own)
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """diag(w_i/(1 + x_i)² + Σ_{l∈route i} a_l) + Rᵀ diag(a) R: (N, B) to (N, N, B)."""
        matrix = np.broadcast_to(self._SHARED, (*self._SHARED.shape[:2], strategies.shape[1])).copy()
        np.einsum("iib->ib", matrix)[...] += self._UTILITIES / (1 + strategies) ** 2 + self._OWN
        return matrix

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """The root of 2 β x² + (α + 2 β) x + α − w = 0 in the box, β = Σ a_l, α the others' price: (N, B) to (N, B)."""
        beta, others = self._OWN, times(self._SHARED, strategies) - self._OWN * strategies
        gap = others - 2 * beta
        root = array_namespace(gap).sqrt(gap**2 + 8 * beta * self._UTILITIES)
        return self.project((root - others - 2 * beta) / (4 * beta))


class WeaklyMonotoneGame(AffineGame):
    """J_i(x) = (x_i − x̄)² N/(N−1) + c_i(x) − d_i x_i up to terms of others, x̄ the mean of all strategies.

    The first player leads and the others follow, c_1 = a x_1 Σ_{j>1} x_j and c_i = −a x_i x_1. So
    dF = 2 (I − 11ᵀ/N) + a K with K skew-symmetric: each J_i is strictly convex in x_i and F is monotone, but not
    strongly: no cost depends on the mean alone, so 1ᵀ dF 1 = 0 and Assumption 4 fails. Yet dF is regular and the
    equilibrium unique. Here N = 5, d_i = i and a = 0.5.
    """

    _LEADS = np.outer(np.eye(5)[0], 1 - np.eye(5)[0])
    matrix = freeze(2 * (np.eye(5) - 1 / 5) + 0.5 * (_LEADS - _LEADS.T))
    offset = freeze(-np.arange(1.0, 6.0))
