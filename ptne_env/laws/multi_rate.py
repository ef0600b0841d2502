"""Primal-dual gradient play at several rates, for games whose shared constraint a market operator prices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray, require_non_negative, require_positive
from ptne_env.laws.base import Law
from ptne_env.laws.routed import nearer_slots, routed_inputs
from ptne_env.observation import Interface, LayoutError, Observation, ObservationLayout


def multi_rate_inputs(
    observation: Observation, memory: FloatArray, sources: BoolArray, step: FloatArray, lead: float
) -> tuple[FloatArray, FloatArray]:
    """x^i_c ← mean of x^j_c over the live sources j of c, and x^i_i ← x^i_i − η_i (g_i + ℓ (g_i − g_i⁻)).

    g_i = ∂J_i/∂x_i(x^i) now and g_i⁻ a step before, with η_i = ``step`` and ℓ = ``lead``. Three layers run at once and
    at their own rates: copies of all strategies and prices, one link per step (:func:`routed_inputs`); descent of the
    players; and ascent of the prices, which the environment keeps at 0 at least. ℓ = 1 is the optimistic gradient of
    L. D. Popov, "A modification of the Arrow–Hurwicz method for search of saddle points", Mathematical Notes 28, 1980:
    it contracts where F rotates without pull, as between strategies and prices, and offsets a delay.

    The memory is g_i⁻, shape (R, n), NaN before the first step.
    """
    gradient = observation.gradient * observation.unit
    before = np.where(np.isnan(memory), gradient, memory)
    ahead = (gradient + lead * (gradient - before)) / observation.unit
    return routed_inputs(observation._replace(gradient=ahead), sources, step), gradient


class MultiRate(Law):
    """Primal-dual gradient play with copies along shortest paths, :func:`multi_rate_inputs`.

    For a coupled constraint C x ≤ b with prices μ ≥ 0, :func:`ptne_env.games.priced`, it is x_i ← x_i − η (∂J_i/∂x_i +
    C_iᵀ μ) and μ ← max(0, μ + η_μ (C x − b)), each on its player's estimates and with the lead ℓ. In the spirit of L.
    Mudrik, I. Kaminer, S. Kragelund and A. H. Clark, "Prescribed-time distributed generalized Nash equilibrium seeking",
    arXiv:2603.16865, 2026, where a state observer and the multipliers contract faster than the strategies. It is not
    their law: they descend along Hessian-gradient products of a Fischer–Burmeister function, in continuous time and
    with a copy of the multipliers per player, and their theorem is not claimed here.

    A player knows whether it is an operator. On a fixed graph it is gradient play with delays equal to hop counts.
    Where no bound becomes or ceases to be active any more, the loop is linear, and
    :func:`~ptne_env.theory.delayed_play.multi_rate_radius` is its spectral radius.

    Args:
        layout: of the environment, with the knowledge of the law's interface.
        step: η > 0 of the players.
        price_step: η_μ > 0 of the operators.
        lead: ℓ ≥ 0.
        operators: players that price a constraint; negative numbers count from the last.

    Raises:
        LayoutError: for a layout without hop counts, or an operator that is no player.
        ValueError: for a number out of range.
    """

    interface: ClassVar[Interface] = Interface(graph_knowledge="union")

    def __init__(
        self,
        layout: ObservationLayout,
        step: float = 0.2,
        price_step: float = 0.3,
        lead: float = 1.0,
        operators: Sequence[int] = (-1,),
    ) -> None:
        super().__init__(layout)
        players = layout.num_players
        if not all(-players <= operator < players for operator in operators):
            raise LayoutError(f"operators are players, {-players} to {players - 1}, got {tuple(operators)}")
        self.steps = np.full((players, 1), require_positive("step", step))
        self.steps[list(operators)] = require_positive("price_step", price_step)
        self.lead = require_non_negative("lead", lead)
        self._nearer = nearer_slots(layout)

    def initial_memory(self, rows: int) -> FloatArray:
        """No gradient yet, shape (R, n)."""
        return np.full((rows, self.layout.dimension), np.nan)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        player = observation.player
        return multi_rate_inputs(observation, memory, self._nearer[player], self.steps[player], self.lead)
