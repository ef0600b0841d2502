"""Proximal best responses: best responses that stay near the estimates, from an identified row of dF."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.laws.base import RecordLaw, consensus, per_step
from ptne_env.laws.building_blocks.own_gradient import (
    RESOLUTION,
    UNLIMITED,
    Model,
    identify,
    initial_model,
    largest,
    own_block,
    own_curvatures,
    own_entries,
    own_places,
    shorten,
    trust_radius,
    with_own,
)
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive


class ProximalMemory(NamedTuple):
    """What R players remember of the step before."""

    model: Model  # the identified rows of dF
    estimate: FloatArray  # own estimates, shape (R, n)
    gradient: FloatArray  # own gradient, shape (R, m)
    radius: FloatArray  # of the trust region, shape (R, 1)
    started: FloatArray  # whether there was a step before, shape (R, 1)


class ProximalBestResponse(RecordLaw):
    """A law that takes proximal best responses to the estimates, and averages the estimates with the neighbours'.

    x^i_j ← ½ (x^i_j + x̂^i_j) and x^i_i ← argmin_y J_i(y, new x^i_{-i}) + (‖y − x^i_i‖² + ‖y − x̂^i_i‖²)/(2α), with
    x̂^i = Σ_j w_ij x^j and W = I − h L. M. Bianchi, G. Belgioioso and S. Grammatico, "A fully-distributed
    proximal-point algorithm for Nash equilibrium seeking with linear convergence rate", arXiv:1910.11613, 2019.

    A player sees its own gradient only, so the argmin is that of the quadratic model with the identified own row G of
    dF, :func:`~ptne_env.laws.building_blocks.own_gradient.identify`: (2 I + α G_ii) Δx_i = h Σ_j a_ij (x^j_i − x^i_i) −
    α (∂J_i/∂x_i + G_{i,−i} Δx_{−i}). It is exact for affine F as soon as the row is known. Until then three standard
    deviations are added to each curvature of G_ii, and a curvature below 0 counts as 0. In games with more than 32
    components the own block alone is identified, and G_{i,−i} counts as 0. Because F need not be affine, no own
    displacement after the first step is longer than
    :func:`~ptne_env.laws.building_blocks.own_gradient.trust_radius`. In a box the environment projects the step, which
    is the argmin in the box where n_i = 1.

    Args:
        layout: the layout of the environment, with the interface ``physical``.
        step: α > 0.
        mixing: h > 0, with h Σ_j a_ij < 1 for every player.
        spread: the standard deviation of the entries of dF before anything is identified, > 0, in units of gradient
            per strategy.

    Raises:
        ValueError: for a number that is not positive, or another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(
        self, layout: ObservationLayout, step: float = 4.0, mixing: float = 0.45, spread: float = 10.0
    ) -> None:
        super().__init__(layout)
        self.step, self.mixing = require_positive("step", step), require_positive("mixing", mixing)
        self.spread = require_positive("spread", spread)
        model, n, none = initial_model(layout, self.spread), layout.dimension, np.zeros((1, 1))
        self.start = ProximalMemory(model, np.zeros((1, n)), np.zeros((1, max(layout.action_dims))), none, none)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        layout, was = self.layout, self.unpack(memory)
        estimate, is_own = observation.own_estimate, layout.own_mask[observation.player]
        blocks = layout.own_components[observation.player]
        gradient, is_whole = own_entries(observation.gradient, blocks), was.model.rows.shape[2] == layout.dimension

        moved = np.where(was.started > 0, estimate - was.estimate, 0.0)
        own_moved = own_entries(moved, blocks)
        deviation = RESOLUTION * (largest(gradient) + self.spread * (largest(estimate) + largest(was.estimate)))
        if not is_whole:
            deviation = deviation + self.spread * largest(np.where(is_own, 0.0, moved))
        shift = moved if is_whole else own_moved
        model, error, failed = identify(was.model, shift, gradient - was.gradient, deviation**2)
        radius = trust_radius(was.radius, own_moved, (error, failed), was.gradient, estimate)

        pull = self.mixing * consensus(observation.weights, observation.relative_estimates)
        drift = np.where(is_own, 0.0, pull / 2)
        places = own_places(blocks, model, layout.dimension)
        foreseen = np.einsum("rmq,rq->rm", model.rows, drift if is_whole else np.zeros_like(shift))
        own = own_block(model.rows, places)
        curvature, doubt, vectors = own_curvatures((own + own.swapaxes(1, 2)) / 2, model, places)
        curvature = np.maximum(curvature, 0.0) + doubt
        wanted = own_entries(pull, blocks) - self.step * (gradient + foreseen)
        along = np.einsum("rba,rb->ra", vectors, wanted) / (2 + self.step * curvature)
        longest = np.where(was.started > 0, radius, UNLIMITED)
        displacement = with_own(drift, shorten(np.einsum("rab,rb->ra", vectors, along), longest), blocks)
        fresh = ProximalMemory(model, estimate, gradient, radius, np.ones_like(radius))
        return per_step(displacement, observation), self.pack(fresh)
