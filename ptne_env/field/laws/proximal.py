"""Proximal best response: the best response to the estimates, held near them, from an identified row of dF."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from ptne_env.field.laws.best_response import (
    LARGEST_ROW,
    UNLIMITED,
    largest,
    own_block,
    own_curvatures,
    own_entries,
    own_places,
    shortened,
    trust_radius,
    with_own,
)
from ptne_env.field.laws.identification import RESOLUTION, Model, blank, identify
from ptne_env.field.laws.memory import Memory
from ptne_env.laws.base import Law, consensus, per_step
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive


class LastStep(NamedTuple):
    """What a player of :class:`ProximalBestResponse` remembers.

    Attributes:
        model: the identified rows of dF.
        estimate: the own estimates in the step before, shape (n,).
        gradient: the own gradient in the step before, shape (m,).
        radius: of the trust region, shape (1,).
        started: whether there was a step before, shape (1,).
    """

    model: Model
    estimate: FloatArray
    gradient: FloatArray
    radius: FloatArray
    started: FloatArray


def proximal_displacement(
    observation: Observation,
    was: LastStep,
    layout: ObservationLayout,
    step: float,
    mixing: float,
    spread: float,
) -> tuple[FloatArray, LastStep]:
    """x^i_j ← ½ (x^i_j + x̂^i_j), x^i_i ← argmin_y J_i(y, new x^i_{-i}) + (‖y − x^i_i‖² + ‖y − x̂^i_i‖²)/(2α).

    With x̂^i = Σ_j w_ij x^j, W = I − h L, α = ``step`` and h = ``mixing``. M. Bianchi, G. Belgioioso and S. Grammatico,
    "A fully-distributed proximal-point algorithm for Nash equilibrium seeking with linear convergence rate",
    arXiv:1910.11613, 2019.

    A player sees its own gradient only, so the argmin is that of the quadratic model with the identified own row G of
    dF, :func:`~ptne_env.field.laws.identification.identify`: (2 I + α G_ii) Δx_i = h Σ_j a_ij (x^j_i − x^i_i) − α (∂J_i/∂x_i
    + G_{i,−i} Δx_{−i}). It is exact for affine F as soon as the row is known. Until then three standard deviations are
    added to each curvature of G_ii, and a curvature below 0 counts as 0. In games with more than 32 components the own
    block alone is identified, and G_{i,−i} counts as 0. After the first step, no own displacement is longer than
    :func:`~ptne_env.field.laws.best_response.trust_radius`, because F need not be affine.

    Args:
        observation: of R players.
        was: the memory so far.
        layout: of the observations.
        step: α.
        mixing: h.
        spread: standard deviation of the rows before anything is identified, in units of gradient per strategy.

    Returns:
        The displacements Δx^i, shape (R, n), and the memory for the next step.
    """
    estimate, blocks = observation.own_estimate, layout.own_components[observation.player]
    is_own = layout.own_mask[observation.player]
    gradient = own_entries(observation.gradient, blocks)
    is_whole = was.model.rows.shape[2] == layout.dimension

    moved = np.where(was.started > 0, estimate - was.estimate, 0.0)
    scale = largest(estimate) + largest(was.estimate)
    deviation = RESOLUTION * (largest(gradient) + spread * scale)
    if not is_whole:
        deviation = deviation + spread * largest(np.where(is_own, 0.0, moved))
    regressors = moved if is_whole else own_entries(moved, blocks)
    model, error, failed = identify(was.model, regressors, gradient - was.gradient, deviation**2)
    own_moved = own_entries(moved, blocks)
    radius = trust_radius(was.radius, own_moved, (error, failed), was.gradient, estimate)

    pull = mixing * consensus(observation.weights, observation.relative_estimates)
    drift = np.where(is_own, 0.0, pull / 2)
    places = own_places(blocks, model, layout.dimension)
    foreseen = np.einsum("rmq,rq->rm", model.rows, drift if is_whole else np.zeros_like(regressors))
    own = own_block(model.rows, places)
    curvature, doubt, vectors = own_curvatures((own + own.swapaxes(1, 2)) / 2, model, places)
    curvature = np.maximum(curvature, 0.0) + doubt
    wanted = own_entries(pull, blocks) - step * (gradient + foreseen)
    own_step = np.einsum("rab,rb->ra", vectors, np.einsum("rba,rb->ra", vectors, wanted) / (2 + step * curvature))
    longest = np.where(was.started > 0, radius, UNLIMITED)
    displacement = with_own(drift, shortened(own_step, longest), blocks)
    return displacement, LastStep(model, estimate, gradient, radius, np.ones((len(estimate), 1)))


class ProximalBestResponse(Law):
    """Bianchi, Belgioioso and Grammatico's proximal best response, :func:`proximal_displacement`.

    A player knows its own links. In a box the environment projects the step, which is the argmin in the box where n_i =
    1.

    Args:
        layout: of the environment, interface ``physical``.
        step: α > 0.
        mixing: h > 0, with h Σ_j a_ij < 1 for every player.
        spread: standard deviation of the entries of dF before anything is identified, > 0, in units of gradient per
            strategy.

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
        outputs, dimension = max(layout.action_dims), layout.dimension
        regressors = dimension if dimension <= LARGEST_ROW else outputs
        start, none = blank(1, outputs, regressors, self.spread), np.zeros((1, 1))
        self._memory: Memory[Any] = Memory(
            LastStep(start, np.zeros((1, dimension)), np.zeros((1, outputs)), none, none)
        )

    def initial_memory(self, rows: int) -> FloatArray:
        """A model of zeros with the standard deviation ``spread``, and nothing seen; shape (R, size)."""
        return self._memory.initial(rows)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        was = self._memory.unpack(memory)
        displacement, fresh = proximal_displacement(observation, was, self.layout, self.step, self.mixing, self.spread)
        return per_step(displacement, observation), self._memory.pack(fresh)
