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
    """What a player of :class:`MultiRate` remembers.

    Attributes:
        routes: of the copies.
        gradient: the own gradient in the step before, shape (n,).
        estimate: the own estimates in the step before, shape (n,).
        is_price: whether the player is an operator, shape (1,).
    """

    routes: Routes
    gradient: FloatArray
    estimate: FloatArray
    is_price: FloatArray


def multi_rate_inputs(
    observation: Observation, was: Roles, layout: ObservationLayout, step: float, price_step: float, lead: float
) -> tuple[FloatArray, Roles]:
    """x^i_c ← mean of x^j_c over the live sources j; x_i ← x_i − η g_i, and μ ← μ − η_μ (g_μ + δ (g_μ − g_μ⁻)).

    With g_i = ∂J_i/∂x_i(x^i) now and g_i⁻ a step before, η = ``step``, η_μ = ``price_step`` and δ = ``lead``. Three
    layers run at once and at their own rates: copies of strategies and prices, one link per step
    (:func:`~ptne_env.field.laws.routed.routed_copies`); descent of the players, −g_i = −∂J_i/∂x_i − C_iᵀ μ; and ascent
    of the prices, −g_μ = C x − b, which the environment keeps at 0 at least. With the lead, a price is a proportional
    and integral feedback of the violation, which damps its oscillation with the strategies and makes up for delays.

    A player learns its role in the first two steps, in which copies rest and it moves by −η g_i and back: the cost of
    an operator is linear, so its gradient does not answer. A bound holds at most one of the two moves. A player that
    cannot move is no operator.

    Args:
        observation: of R players.
        was: the memory so far.
        layout: of the observations.
        step: η.
        price_step: η_μ.
        lead: δ.

    Returns:
        Inputs, shape (R, n), and the memory for the next step.
    """
    gradient, estimate, before, count = observation.gradient, observation.own_estimate, was.gradient, was.routes.steps
    change, moved = (largest(part) for part in (gradient - before, estimate - was.estimate))
    resolution = RESOLUTION * (largest(gradient) + largest(before) + largest(estimate))
    is_informative = (count > 0) & (count <= _PROBES) & (_FLAT * moved > _VISIBLE * resolution)
    is_price = np.where(is_informative, change <= _FLAT * moved, was.is_price > 0)
    ahead = np.where(is_price, gradient + lead * (gradient - before), gradient)
    drift, routes = routed_copies(observation, was.routes, layout, moves=count >= _PROBES)
    inputs = routed_inputs(observation._replace(gradient=ahead), drift, np.where(is_price, price_step, step))
    probe = per_step(np.where(count == 0, -gradient, before) * step, observation)
    return np.where(count < _PROBES, probe, inputs), Roles(routes, gradient, estimate, is_price.astype(np.float64))


class MultiRate(Law):
    """Primal-dual gradient play with copies from live sources, :func:`multi_rate_inputs`.

    For games with a coupled constraint C x ≤ b and prices μ ≥ 0, :func:`ptne_env.field.games.priced`, in the spirit of L.
    Mudrik, I. Kaminer, S. Kragelund and A. H. Clark, "Prescribed-time distributed generalized Nash equilibrium
    seeking", arXiv:2603.16865, 2026, where the observer of the strategies and the multipliers contract faster than the
    strategies. The construction is ours: they descend along Hessian-gradient products of a Fischer–Burmeister function
    in continuous time, with a copy of the multipliers per player, and their theorem is not claimed for this law.

    In games without operator it is :class:`~ptne_env.field.laws.RoutedUnknown` after its two probing steps.

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
        n = layout.dimension
        self._memory: Memory[Any] = Memory(
            Roles(no_routes(layout), np.zeros((1, n)), np.zeros((1, n)), np.zeros((1, 1)))
        )

    def initial_memory(self, rows: int) -> FloatArray:
        """Nothing seen, shape (R, size)."""
        return self._memory.initial(rows)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        was = self._memory.unpack(memory)
        inputs, roles = multi_rate_inputs(observation, was, self.layout, self.step, self.price_step, self.lead)
        return inputs, self._memory.pack(roles)
