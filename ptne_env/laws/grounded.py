"""Ye & Hu's law of 2017, grounded in the neighbours' real strategies."""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import FloatArray, require_non_negative
from ptne_env.interface import Layout, Reading
from ptne_env.laws.base import Law, consensus


class Grounded(Law):
    """e^i_i = 0; for j ≠ i, e^i_j = −κ [Σ_k a_ik (x^i_j − x^k_j) + a_ij (x^i_j − x^j_j)].

    M. Ye and G. Hu, "Distributed Nash equilibrium seeking by a consensus based approach", IEEE Transactions on
    Automatic Control 62(9), 2017, in effective time. A strategy follows its own gradient alone, and the estimates of it
    are leader–follower consensus with the player itself as the leader.

    Args:
        layout: of the environment.
        kappa: κ ≥ 0.

    Raises:
        ValueError: for a negative gain.
    """

    def __init__(self, layout: Layout, kappa: float = 2.0) -> None:
        super().__init__(layout)
        self.kappa = require_non_negative("kappa", kappa)

    def _inputs(self, reading: Reading, memory: None) -> tuple[FloatArray, None]:
        error = consensus(reading.weights, reading.relative_estimates)
        leaders = self.layout.neighbour_components[reading.player]
        error += np.einsum("rd,rdn,rdn->rn", reading.weights, reading.relative_estimates, leaders)
        own = self.layout.own_mask[reading.player]
        return np.where(own, -reading.gradient, self.kappa * error), memory
