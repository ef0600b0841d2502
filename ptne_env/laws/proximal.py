"""Proximal best responses: best responses that stay near the estimates, from an identified row of dF."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.laws.identification import Model, identify, initial_model, own_curvatures, own_entries, shorten, with_own
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive


class ProximalBestResponse(Law):
    """A law that takes proximal best responses to the estimates, and averages the estimates with the neighbours'.

    x^i_j ← ½ (x^i_j + x̂^i_j) and x^i_i ← argmin_y J_i(y, new x^i_{-i}) + (‖y − x^i_i‖² + ‖y − x̂^i_i‖²)/(2α), with
    x̂^i = Σ_j w_ij x^j and W = I − h L. M. Bianchi, G. Belgioioso and S. Grammatico, "A fully-distributed
    proximal-point algorithm for Nash equilibrium seeking with linear convergence rate", arXiv:1910.11613, 2019.

    A player sees its own gradient only, so the argmin is that of the quadratic model with the identified own row G of
    dF, :func:`~ptne_env.laws.identification.identify`: (2 I + α G_ii) Δx_i = h Σ_j a_ij (x^j_i − x^i_i) −
    α (∂J_i/∂x_i + G_{i,−i} Δx_{−i}). It is exact for affine F as soon as the row is known. Until then three standard
    deviations are added to each curvature of G_ii, and a curvature below 0 counts as 0. Because F need not be affine,
    no own displacement after the first step is longer than the trust region. In a box the environment projects the
    step, which is the argmin in the box where n_i = 1. The memory is the model.

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

    def initial_memory(self, rows: int) -> Model:
        return initial_model(self.layout, rows)

    def inputs(self, observation: Observation, memory: Model) -> tuple[FloatArray, Model]:
        blocks = self.layout.own_components[observation.player]
        is_own, gradient = self.layout.own_mask[observation.player], own_entries(observation.gradient, blocks)
        widest, unlimited = np.full_like(memory.radius, self.spread), np.full_like(memory.radius, np.inf)
        model = identify(memory, observation.own_estimate, gradient, widest, unlimited, is_own)

        pull = self.mixing * consensus(observation.weights, observation.relative_estimates)
        drift = np.where(is_own, 0.0, pull / 2)
        curvature, doubt, vectors = own_curvatures(model, blocks)
        wanted = own_entries(pull, blocks) - self.step * (gradient + np.einsum("rmn,rn->rm", model.rows, drift))
        along = np.einsum("rba,rb->ra", vectors, wanted) / (2 + self.step * (np.maximum(curvature, 0.0) + doubt))
        step = np.einsum("rab,rb->ra", vectors, along)
        displacement = with_own(drift, shorten(step, model.radius), blocks)
        return per_step(displacement, observation), model
