"""Charging of electric vehicles, coupled through the total load of each time interval."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptne_env.games.affine import AffineGame
from ptne_env.shared.arrays import FloatArray, frozen, ordered_sum, require_positive


class ElectricVehicleCharging(AffineGame):
    """J_i(x) = ½ q ‖x_i‖² + ½ ρ (Σ_t x_it − E_i)² + Σ_t a (D_t + Σ_k x_kt) x_it, 0 ≤ x_it ≤ X.

    Vehicle i charges x_it in time interval t. It pays for battery wear, for missing its energy E_i, and a price per
    interval that rises with the total of the base load D_t and all vehicles. An aggregative game, after Z. Ma, D.
    Callaway and I. Hiskens, "Decentralized charging control of large populations of plug-in electric vehicles", IEEE
    Transactions on Control Systems Technology 21(1), 2013; there the energy is a constraint, here a penalty, so that
    the only constraint is a box. The numbers are ours. dF = (q + a) I + ρ blockdiag(11ᵀ) + a 11ᵀ⊗I, so F is strongly
    monotone with ε ≥ q + a.

    Args:
        energy: E_i > 0, which sets N.
        base_load: D_t, which sets n_i, the number of time intervals.
        wear: q > 0.
        penalty: ρ > 0.
        price: a > 0.
        limit: X > 0, the largest power.

    Raises:
        ValueError: when a number is out of range.
    """

    def __init__(
        self,
        energy: Sequence[float] = (4.0, 5.0, 6.0, 7.0, 8.0),
        base_load: Sequence[float] = (8.0, 3.0, 1.0, 5.0),
        wear: float = 0.5,
        penalty: float = 1.0,
        price: float = 0.3,
        limit: float = 2.0,
    ) -> None:
        energies, load = np.asarray(energy, dtype=np.float64), np.asarray(base_load, dtype=np.float64)
        if energies.ndim != 1 or load.ndim != 1 or not energies.min(initial=np.inf) > 0:
            raise ValueError(
                f"energy lists one number > 0 per vehicle and base_load one per time interval, got {energy!r}"
            )
        self.wear, self.penalty = require_positive("wear", wear), require_positive("penalty", penalty)
        self.price, self.limit = require_positive("price", price), require_positive("limit", limit)
        self.energy, self.base_load = frozen(energies), frozen(load)
        vehicles, intervals = energies.size, load.size
        matrix = (self.wear + self.price) * np.eye(vehicles * intervals)
        matrix += self.penalty * np.kron(np.eye(vehicles), np.ones((intervals, intervals)))
        matrix += self.price * np.kron(np.ones((vehicles, vehicles)), np.eye(intervals))
        offset = (self.price * load - self.penalty * energies[:, None]).ravel()
        super().__init__(matrix, offset, (intervals,) * vehicles, low=0.0, high=self.limit)

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (n, B) to (N, B)."""
        power = strategies.reshape(self.num_players, self.base_load.size, -1)
        total = ordered_sum(power)
        bill = self.price * (self.base_load[:, None] + total) * power
        missing = self.summed(strategies) - self.energy[:, None]
        return (
            self.summed(self.wear * strategies**2 / 2 + bill.reshape(strategies.shape)) + self.penalty * missing**2 / 2
        )
