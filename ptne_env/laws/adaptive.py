"""The paper's law with adaptive gains per link (Theorem 3), also over switching graphs (Theorem 4)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.laws.base import Law, consensus
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, array_namespace, require_non_negative


def adaptive_inputs(
    observation: Observation, memory: FloatArray, gamma: Any, initial_gain: Any = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the inputs (..., n) of the adaptive law, and the next memory (..., D) after an Euler step.

    u^i = −R_i^T ∂J_i/∂x_i(x^i) − Σ_j κ_ij a_ij (x^i − x^j) and dκ_ij/dτ = γ_ij a_ij ‖x^i − x^j‖², eqs. (36) and (47),
    where κ_ij is the memory, added to ``initial_gain`` where it holds the growth alone.
    """
    differences = observation.relative_estimates
    inputs = consensus((memory + initial_gain) * observation.weights, differences) - observation.gradient
    squared = array_namespace(differences).einsum("...dn,...dn->...d", differences, differences)
    growth = gamma * observation.weights * squared * observation.unit**2
    return inputs, memory + observation.theta * growth


class Adaptive(Law):
    """The adaptive law of the paper (Theorem 3; over switching graphs, its Theorem 4), :func:`adaptive_inputs`.

    On a switching topology a_ij is that of the active graph. The gains take an Euler step of Θ_k like the estimates.
    Both ends of a link see the same differences, so κ_ij = κ_ji needs no message. The memory, per neighbour slot, is
    κ_ij, or its growth where the κ_ij(0) differ: shape (R, D), in natural units.

    Args:
        layout: the layout of the environment.
        gamma: γ_ij ≥ 0, one number for all links or a symmetric table (N, N), of which each player reads its own row.
            The paper does not give it; 0.1 needs Θ ≲ 0.04 to stay stable.
        initial_gain: κ_ij(0) ≥ 0, likewise.

    Raises:
        ValueError: for a negative number, or a table that is not symmetric or of another shape.
    """

    def __init__(
        self, layout: ObservationLayout, gamma: npt.ArrayLike = 0.01, initial_gain: npt.ArrayLike = 0.5
    ) -> None:
        super().__init__(layout)
        self.gamma = of_links("gamma", gamma, layout)
        self.initial_gain = of_links("initial_gain", initial_gain, layout)

    def initial_memory(self, rows: int) -> FloatArray:
        """Return κ_ij(0) per neighbour slot, or 0 where they differ; shape (R, D)."""
        return np.full((rows, self.layout.slots), 0.0 if self.initial_gain.ndim else self.initial_gain)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        gamma = self.gamma[observation.player] if self.gamma.ndim else self.gamma
        start = self.initial_gain[observation.player] if self.initial_gain.ndim else 0.0
        return adaptive_inputs(observation, memory, gamma, start)

    def gains(self, memory: FloatArray) -> FloatArray:
        """Return κ_ij of every link, in both directions."""
        neighbours = np.array(self.layout.neighbours)
        gains = memory + (self.initial_gain if self.initial_gain.ndim else 0.0)
        return np.asarray(gains[neighbours != np.arange(len(neighbours))[:, None]])


def of_links(name: str, numbers: npt.ArrayLike, layout: ObservationLayout) -> FloatArray:
    """Return one number for all links, shape (), or those of a symmetric table (N, N), a row per player: (N, D)."""
    if np.ndim(numbers) == 0:
        return np.array(require_non_negative(name, numbers))  # type: ignore[arg-type]  # which it checks
    table, players = np.array(numbers, dtype=np.float64), layout.num_players
    if table.shape != (players, players) or not np.all(np.isfinite(table) & (table >= 0) & (table == table.T)):
        raise ValueError(
            f"{name} is a number of at least 0, or a symmetric table ({players}, {players}) of them, got {numbers!r}"
        )
    np.fill_diagonal(table, table.max())  # padded slots hold the player itself, with weight 0
    return table[np.arange(players)[:, None], np.array(layout.neighbours)]
