"""Primal-dual gradient play at several rates, for games whose shared constraint a market operator prices."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import largest
from ptne_env.field.laws.identification import RESOLUTION
from ptne_env.field.laws.memory import Memory
from ptne_env.field.laws.routed import Routes, no_routes, routed_copies, routed_inputs
from ptne_env.laws.base import Law, per_step
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_non_negative, require_positive

_PROBES = 2
"""Steps in which a player learns its role: one along its gradient, and one back."""

_FLAT = 0.1
"""A gradient that answers to an own move with less than this curvature, in units of gradient per strategy, is flat."""

_VISIBLE = 8.0
"""Resolutions of observations that an answer must exceed to be seen."""


class Roles(NamedTuple):
    """What R players remember."""

    routes: Routes  # of the copies
    gradient: FloatArray  # own gradient in the step before, shape (R, n)
    estimate: FloatArray  # own estimates in the step before, shape (R, n)
    is_price: FloatArray  # whether the player is an operator, shape (R, 1)


class MultiRate(Law):
    """x^i_c ← mean of x^j_c over the live sources j; x_i ← x_i − η g_i, and μ ← μ − η_μ (g_μ + δ (g_μ − g_μ⁻)).

    With g_i = ∂J_i/∂x_i(x^i) now and g_i⁻ a step before. Three layers run at once and at their own rates: copies of
    strategies and prices, one link per step (:func:`~ptne_env.field.laws.routed.routed_copies`); descent of the
    players, −g_i = −∂J_i/∂x_i − C_iᵀ μ; and ascent of the prices, −g_μ = C x − b, which the environment keeps at 0 at
    least. With the lead δ, a price is a proportional and integral feedback of the violation, which damps its
    oscillation with the strategies and makes up for delays.

    For games with a coupled constraint C x ≤ b and prices μ ≥ 0, :func:`ptne_env.field.games.priced`, in the spirit of
    L. Mudrik, I. Kaminer, S. Kragelund and A. H. Clark, "Prescribed-time distributed generalized Nash equilibrium
    seeking", arXiv:2603.16865, 2026, where the observer of the strategies and the multipliers contract faster than the
    strategies. The construction is ours: they descend along Hessian-gradient products of a Fischer–Burmeister function
    in continuous time, with a copy of the multipliers per player, and their theorem is not claimed for this law.

    A player learns its role in the first two steps, in which copies rest and it moves by −η g_i and back: the cost of
    an operator is linear, so its gradient does not answer. A bound holds at most one of the two moves. A player that
    cannot move is no operator. In games without operator the law is then :class:`~ptne_env.field.laws.RoutedUnknown`.

    Args:
        layout: of the environment, interface ``physical``.
        step: η > 0 of the players.
        price_step: η_μ > 0 of the operators.
        lead: δ ≥ 0 of the operators.

    Raises:
        LayoutError: for a layout without own estimates.
        ValueError: for a number out of range.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(
        self, layout: ObservationLayout, step: float = 0.2, price_step: float = 0.2, lead: float = 2.0
    ) -> None:
        super().__init__(layout)
        self.step, self.price_step = require_positive("step", step), require_positive("price_step", price_step)
        self.lead = require_non_negative("lead", lead)
        none = np.zeros((1, layout.dimension))
        self._memory: Memory[Any] = Memory(Roles(no_routes(layout), none, none, np.zeros((1, 1))))

    def initial_memory(self, rows: int) -> FloatArray:
        """Nothing seen, shape (R, size)."""
        return self._memory.initial(rows)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        was = self._memory.unpack(memory)
        gradient, estimate, before = observation.gradient, observation.own_estimate, was.gradient
        steps = was.routes.steps
        change, moved = largest(gradient - before), largest(estimate - was.estimate)
        resolution = RESOLUTION * (largest(gradient) + largest(before) + largest(estimate))
        is_informative = (steps > 0) & (steps <= _PROBES) & (_FLAT * moved > _VISIBLE * resolution)
        is_price = np.where(is_informative, change <= _FLAT * moved, was.is_price > 0)

        ahead = np.where(is_price, gradient + self.lead * (gradient - before), gradient)
        drift, routes = routed_copies(observation, was.routes, self.layout, moves=steps >= _PROBES)
        rate = np.where(is_price, self.price_step, self.step)
        inputs = routed_inputs(observation._replace(gradient=ahead), drift, rate)
        probe = per_step(np.where(steps == 0, -gradient, before) * self.step, observation)
        fresh = Roles(routes, gradient, estimate, is_price.astype(np.float64))
        return np.where(steps < _PROBES, probe, inputs), self._memory.pack(fresh)
