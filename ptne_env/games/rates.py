"""Rate control in a network of links with congestion prices."""

from __future__ import annotations

import numpy as np

from ptne_env.games.affine import times
from ptne_env.games.base import Game
from ptne_env.shared.arrays import FloatArray, array_namespace, frozen, product

_ROUTES = ((0,), (0, 1), (1, 2), (2,), (0, 2))
"""The links that each user's data pass."""


class RateControl(Game):
    """J_i(x) = −w_i log(1 + x_i) + x_i Σ_{l∈route i} a_l Σ_{k uses l} x_k, 0 ≤ x_i ≤ X_i.

    Users weigh a logarithmic utility, as TCP's proportional fairness does, against a congestion price of every link on
    their route that is linear in the link's load; after T. Alpcan and T. Başar, "A game-theoretic framework for
    congestion control in general topology networks", IEEE Conference on Decision and Control, 2002. The numbers are
    ours. dF = diag(w_i/(1 + x_i)² + Σ_{l∈route i} a_l) + Rᵀ diag(a) R with R the routing matrix, so F is strongly
    monotone on x > −1 with ε ≥ min_i Σ_{l∈route i} a_l. Costs are defined for x_i > −1 only, which the box ensures.
    """

    def __init__(self) -> None:
        weights, prices = np.array([6.0, 8.0, 9.0, 7.0, 10.0]), np.array([0.4, 0.5, 0.3])
        super().__init__((1,) * len(_ROUTES), low=0.0, high=[2.0, 4.0, 4.0, 2.0, 4.0])
        uses = np.array([[link in row for row in _ROUTES] for link in range(prices.size)], dtype=np.float64)
        self.utility = frozen(weights[:, None])
        # Entry (i, k) is the sum of the prices of the links that users i and k share.
        self._shared = frozen((uses.T @ np.diag(prices) @ uses)[:, :, None])
        self._own = frozen(np.diag(self._shared[:, :, 0])[:, None])

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (N, B) to (N, B)."""
        return strategies * times(self._shared, strategies) - self.utility * array_namespace(strategies).log1p(
            strategies
        )

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """−w_i/(1 + x^i_i) + Σ_{l∈route i} a_l (x^i_i + Σ_{k uses l} x^i_k): (N, N, B) to (N, B)."""
        xp = array_namespace(estimates)
        own = xp.einsum("iib->ib", estimates)
        # _shared is symmetric, so its row for player i is its column
        load = xp.add.reduce(product(self._shared, estimates), axis=0)
        gradients: FloatArray = load + self._own * own - self.utility / (1 + own)
        return gradients

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """diag(w_i/(1 + x_i)² + Σ_{l∈route i} a_l) + Rᵀ diag(a) R: (N, B) to (N, N, B)."""
        matrix = np.broadcast_to(self._shared, (*self._shared.shape[:2], strategies.shape[1])).copy()
        np.einsum("iib->ib", matrix)[...] += self.utility / (1 + strategies) ** 2 + self._own
        return matrix

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """The root of 2 β x² + (α + 2 β) x + α − w = 0 in the box, β = Σ a_l, α the others' price: (N, B) to (N, B)."""
        others = times(self._shared, strategies) - self._own * strategies
        gap = others - 2 * self._own
        root = (array_namespace(gap).sqrt(gap**2 + 8 * self._own * self.utility) - others - 2 * self._own) / (
            4 * self._own
        )
        return self.project(root)
