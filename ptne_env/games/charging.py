"""Charging of electric vehicles, coupled through the total load of each time interval."""

from __future__ import annotations

import numpy as np

from ptne_env.games.affine import AffineGame
from ptne_env.shared.arrays import FloatArray, frozen, ordered_sum

_ENERGY = frozen([4.0, 5.0, 6.0, 7.0, 8.0])
"""E_i of each vehicle."""

_LOAD = frozen([8.0, 3.0, 1.0, 5.0])
"""D_t of each time interval."""

_WEAR, _PENALTY, _PRICE, _LIMIT = 0.5, 1.0, 0.3, 2.0
"""q, ρ, a and the largest power X."""


class ElectricVehicleCharging(AffineGame):
    """J_i(x) = ½ q ‖x_i‖² + ½ ρ (Σ_t x_it − E_i)² + Σ_t a (D_t + Σ_k x_kt) x_it, 0 ≤ x_it ≤ X.

    Vehicle i charges x_it in time interval t. It pays for battery wear, for missing its energy E_i, and a price per
    interval that rises with the total of the base load D_t and all vehicles. An aggregative game, after Z. Ma, D.
    Callaway and I. Hiskens, "Decentralized charging control of large populations of plug-in electric vehicles", IEEE
    Transactions on Control Systems Technology 21(1), 2013; there the energy is a constraint, here a penalty, so that
    the only constraint is a box. The numbers are ours. dF = (q + a) I + ρ blockdiag(11ᵀ) + a 11ᵀ⊗I, so F is strongly
    monotone with ε ≥ q + a.
    """

    def __init__(self) -> None:
        vehicles, intervals = _ENERGY.size, _LOAD.size
        matrix = (_WEAR + _PRICE) * np.eye(vehicles * intervals)
        matrix += _PENALTY * np.kron(np.eye(vehicles), np.ones((intervals, intervals)))
        matrix += _PRICE * np.kron(np.ones((vehicles, vehicles)), np.eye(intervals))
        offset = (_PRICE * _LOAD - _PENALTY * _ENERGY[:, None]).ravel()
        super().__init__(matrix, offset, (intervals,) * vehicles, low=0.0, high=_LIMIT)

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (n, B) to (N, B)."""
        power = strategies.reshape(self.num_players, _LOAD.size, -1)
        total = ordered_sum(power)
        bill = _PRICE * (_LOAD[:, None] + total) * power
        missing = self.summed(strategies) - _ENERGY[:, None]
        return self.summed(_WEAR * strategies**2 / 2 + bill.reshape(strategies.shape)) + _PENALTY * missing**2 / 2
