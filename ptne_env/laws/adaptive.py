"""The paper's law with adaptive gains per link."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.laws.base import Law, consensus
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, array_namespace, require_non_negative


def adaptive_inputs(
    observation: Observation, memory: FloatArray, gamma: FloatArray, surplus: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the inputs (..., n) of the adaptive law, and the next memory (..., D) after an Euler step.

    u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j κ_ij a_ij (x^i − x^j) and dκ_ij/dτ = γ_ij a_ij ‖x^i − x^j‖², eqs. (36) and (47),
    where κ_ij is the memory and the surplus, by which κ_ij(0) is above the smallest number of the table.
    """
    differences = observation.relative_estimates
    inputs = consensus((memory + surplus) * observation.weights, differences) - observation.gradient
    squared = array_namespace(differences).einsum("...dn,...dn->...d", differences, differences)
    growth = gamma * observation.weights * squared * observation.unit**2
    return inputs, memory + observation.theta * growth


class Adaptive(Law):
    """The adaptive law of the paper (Theorem 3), :func:`adaptive_inputs`.

    On a switching topology a_ij is that of the active graph, but convergence (Theorem 4) is proven only where every
    mode is connected (docs/errata.md, 2). The gains take an Euler step of Θ_k like the estimates. Both ends of a link
    see the same differences, so κ_ij = κ_ji needs no message; nothing is proven where links are directed, of which the
    listener alone tunes the gain. The memory is κ_ij less its surplus per neighbour slot, shape (R, D), in natural
    units.

    Args:
        layout: the layout of the environment.
        gamma: γ_ij ≥ 0, one number for all links or a symmetric table (N, N), of which each player reads its own row.
            The paper does not give it; 0.1 needs Θ ≲ 0.04 to stay stable.
        initial_gain: κ_ij(0) ≥ 0, likewise.

    Raises:
        ValueError: for a negative number, or a table that is not symmetric or of another shape.
    """

    has_gains: ClassVar[bool] = True

    def __init__(
        self, layout: ObservationLayout, gamma: npt.ArrayLike = 0.01, initial_gain: npt.ArrayLike = 0.5
    ) -> None:
        super().__init__(layout)
        self.gamma, gains = _of_links("gamma", gamma, layout), _of_links("initial_gain", initial_gain, layout)
        self.smallest_gain = float(np.min(initial_gain))  # of the table, whatever the links are
        self.surplus = gains - self.smallest_gain

    def initial_memory(self, rows: int) -> FloatArray:
        """Return the smallest κ_ij(0) per neighbour slot, shape (R, D)."""
        return np.full((rows, self.layout.slots), self.smallest_gain)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        return adaptive_inputs(observation, memory, self.gamma[observation.player], self.surplus[observation.player])


def _of_links(name: str, numbers: npt.ArrayLike, layout: ObservationLayout) -> FloatArray:
    """Return the numbers of a player's links in each row, (N, D), from one number for all or a table (N, N)."""
    if np.ndim(numbers) == 0:
        return np.full((layout.num_players, layout.slots), require_non_negative(name, numbers))  # type: ignore[arg-type]
    table, shape = np.array(numbers, dtype=np.float64), (layout.num_players,) * 2
    if table.shape != shape or not np.all(np.isfinite(table) & (table >= 0) & (table == table.T)):
        raise ValueError(f"{name} is a number of at least 0, or a symmetric table {shape} of them, got {numbers!r}")
    np.fill_diagonal(table, table.max())  # padded slots hold the player itself, with weight 0
    return np.take_along_axis(table, np.array(layout.neighbours), axis=1)
