"""Electricity markets: generators as Nash–Cournot firms, and the market of the IEEE 118-bus case."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from importlib.resources import files
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.affine import AffineGame
from ptne_env.games.base import Game, GameFamily
from ptne_env.shared.arrays import FloatArray, freeze, ordered_sum, require_positive, require_probability, with_games
from ptne_env.shared.parts import checked


class CournotMarket(AffineGame):
    """J_i(x) = q_i x_i² + c_i x_i − (P − β Σ_j x_j) x_i, 0 ≤ x_i ≤ X_i: minus the profit of firm i, in $/h.

    Firm i generates x_i MW at a quadratic cost, up to its capacity, and all sell at one price, which falls with the
    total. F is strongly monotone with ε ≥ min 2 q_i + β, for dF = diag(2 q_i + β) + β 11ᵀ.

    Attributes:
        quadratic: q_i ≥ 0 in $/MW²h, (N,), or (N, G) for a batch.
        linear: c_i in $/MWh, likewise.
        intercept: P, the price without supply, in $/MWh; (G,) for a batch.
        slope: β > 0 in $/MW²h.
        high: the capacities X_i in MW, one number for all or (N,).

    Raises:
        ValueError: when shapes disagree, or as :class:`AffineGame`.
    """

    parameters: ClassVar[Mapping[str, int]] = {"quadratic": 1, "linear": 1, "intercept": 0}
    low = 0.0

    quadratic: npt.ArrayLike
    linear: npt.ArrayLike
    intercept: npt.ArrayLike
    slope: float = checked(require_positive)
    high: npt.ArrayLike

    def __post_init__(self) -> None:
        if np.ndim(self.linear) not in (1, 2) or np.shape(self.quadratic) != np.shape(self.linear):
            raise ValueError(
                "CournotMarket: quadratic and linear have one number per firm (and game), got the shapes "
                f"{np.shape(self.quadratic)} and {np.shape(self.linear)}"
            )
        super().__post_init__()

    @cached_property
    def matrix(self) -> FloatArray:
        """diag(2 q_i + β) + β 11ᵀ, shape (N, N, G)."""
        quadratic, own = with_games(self.quadratic, 1), np.eye(len(self.offsets))[:, :, None]
        return freeze(own * (2 * quadratic) + self.slope * (1 + own))

    @cached_property
    def offset(self) -> FloatArray:
        """The vector c − P, shape (N, G)."""
        return freeze(with_games(self.linear, 1) - with_games(self.intercept, 0))

    def price(self, strategies: FloatArray) -> FloatArray:
        """P − β Σ_j x_j in $/MWh: (N, B) to (B,)."""
        return with_games(self.intercept, 0) - self.slope * ordered_sum(strategies)


LOAD, PRICE = 4242.0, 39.38
"""The load of the case in MW, and the marginal cost in $/MWh at which its generators serve it at least cost."""


@cache
def generators() -> Mapping[str, FloatArray]:
    """The generators of the IEEE 118-bus case by column, each (54,), with ``adjacency``, (54, 54), of neighbours.

    The case is that of MATPOWER (R. D. Zimmerman, C. E. Murillo-Sánchez and R. J. Thomas, IEEE Transactions on Power
    Systems 26(1), 2011). Two generators are neighbours where a path of the grid between them passes no other one.
    ``baselines/market.py`` made the table.
    """
    with (files("ptne_env.games") / "market_118.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    linked = [[row["bus"] in other["neighbours"].split() for row in rows] for other in rows]
    numbers = {name: freeze([float(row[name]) for row in rows]) for name in ("quadratic", "linear", "capacity")}
    return {**numbers, "adjacency": freeze(linked)}


class Market118(GameFamily):
    """The 54 generators of the IEEE 118-bus case as a :class:`CournotMarket`: hours with other loads and fuel prices.

    Demand is linear, with the elasticity e at the case's load L and the price p, so β = p/(e L). The load of an hour
    moves it, P = p + β L U(1 − w, 1 + w), and each c_i is that of the case times U(1 − v, 1 + v), all independent. Most
    generators run at no load in the case, at 40 $/MWh: the hour decides whether they stop, run or are at capacity.

    Attributes:
        load: w, the largest relative change of the load, at most 1.
        fuel: v, the largest relative change of a fuel price, at most 1.
        elasticity: e > 0. Values of 0.1 to 1 are usual in studies of electricity markets.

    Numbers out of range are a ``ValueError``.
    """

    is_strongly_monotone = True

    load: float = checked(require_probability, default=0.2)
    fuel: float = checked(require_probability, default=0.2)
    elasticity: float = checked(require_positive, default=0.4)

    @cached_property
    def representative(self) -> Game:
        """The case itself, with its own load and costs."""
        return self._market(np.zeros((55, 1)))

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        return self._market(np.stack([generator.uniform(-1, 1, 55) for generator in generators], axis=-1))

    def _market(self, changes: FloatArray) -> CournotMarket:
        """Return the games of changes in [−1, 1] of the load, then of the fuel prices, (55, G)."""
        case, slope = generators(), PRICE / (self.elasticity * LOAD)
        return CournotMarket(
            quadratic=np.repeat(case["quadratic"][:, None], changes.shape[1], axis=1),
            linear=case["linear"][:, None] * (1 + self.fuel * changes[1:]),
            intercept=PRICE + slope * LOAD * (1 + self.load * changes[0]),
            slope=slope,
            high=case["capacity"],
        )
