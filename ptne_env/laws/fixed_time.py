"""Fixed-time play: signed powers of gradients and differences, so that the start does not matter."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.laws.grounded import grounded_inputs
from ptne_env.laws.identification import Curvature, clip_to_reach, see_curvature
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive

_TINY = float(np.finfo(np.float64).tiny)
"""What stands for 0 in divisors."""


class FixedTime(Law):
    """The grounded law with signed powers of gradients and differences, in effective time.

    u^i_i = −s(∂J_i/∂x_i(x^i)) and u^i_j = −κ s(ξ^i_j) for j ≠ i, with :func:`~ptne_env.laws.grounded.grounded_error`
    and s(v) = sign(v) (|v|^{1−α} + |v|^{1+α}) of every component in natural units: the larger power acts far from rest
    and the smaller one near it, so one time to settle holds for all starts. J. I. Poveda, M. Krstić and T. Başar,
    "Fixed-time Nash equilibrium seeking in time-varying networks", IEEE Transactions on Automatic Control 68(4), 2023.
    There players know each other's strategies, here estimates, which settle alike; no theorem covers both together. In
    continuous time, strategies settle within π n^{α/4}/(2 α μ) if all estimates are exact and the game has a strongly
    convex potential, of constant μ, and estimates within π (N−1)^{α/4}/(2 α κ λ) after them on a fixed graph, λ being
    the smallest eigenvalue of the grounded Laplacians.

    In steps of Θ the smaller power would chatter and the larger one overshoot. So no step takes a strategy further than
    a gradient step of η or 1/L, the smaller one (:func:`~ptne_env.laws.identification.see_curvature`), or an estimate
    further than to the weighted mean of what the neighbours say, ξ^i_j/(Σ_k a_ik + a_ij). Near rest, and far from it,
    the law is this linear iteration. The input limit may slow it, and then the bounds are void. The memory is L.

    Args:
        layout: the layout of the environment, with the interface ``physical``.
        kappa: κ > 0.
        power: α, in (0, 1].
        step: η > 0, the largest gradient step.

    Raises:
        ValueError: for a number out of range.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)  # natural units, in which the input limit is known

    def __init__(self, layout: ObservationLayout, kappa: float = 2.0, power: float = 0.5, step: float = 1.0) -> None:
        super().__init__(layout)
        self.kappa, self.step = require_positive("kappa", kappa), require_positive("step", step)
        self.power = require_positive("power", power)
        if power > 1:
            raise ValueError(f"power must be at most 1, or inputs grow without bound near rest, got {power}")

    def initial_memory(self, rows: int) -> Curvature:
        return Curvature(np.zeros((rows, 1)), *np.zeros((2, rows, self.layout.dimension)))

    def inputs(self, observation: Observation, memory: Curvature) -> tuple[FloatArray, Curvature]:
        player = observation.player
        own, leaders = self.layout.own_mask[player], self.layout.neighbour_components[player]
        pull: FloatArray = grounded_inputs(observation, own, leaders, kappa=1.0)
        size = np.maximum(np.abs(pull) * observation.unit, _TINY)
        gains = np.where(own, 1.0, self.kappa) * (size**-self.power + size**self.power)
        seen = see_curvature(memory, observation, own)
        degrees = consensus(observation.weights, leaders + np.float64(1.0))
        stiffness = np.where(own, np.maximum(1 / self.step, seen.largest), np.maximum(degrees, _TINY))
        moves = clip_to_reach(pull * np.minimum(observation.theta * gains, 1 / stiffness), observation, self.layout)
        return per_step(moves, observation), seen._replace(moves=moves * observation.unit)
