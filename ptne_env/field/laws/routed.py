"""Routed play: each component of the estimates travels from its owner to all other players, one link per step."""

from __future__ import annotations

import numpy as np

from ptne_env.field.laws.best_response import within_reach
from ptne_env.field.laws.contacts import contact_parts, contacts
from ptne_env.laws.base import Law, per_step
from ptne_env.laws.memory import Parts
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, fold, ordered_sum, require_positive


def totals(observation: Observation, sources: BoolArray) -> tuple[FloatArray, IntArray]:
    """Σ_j x^j_c − x^i_c over the live sources j of component c, and their number: shapes (R, n)."""
    live = sources & (observation.weights > 0)[:, :, None]
    total = ordered_sum(np.where(live, observation.relative_estimates, 0.0), axis=1)
    return total, fold(np.add, live.astype(np.int32), axis=1).astype(np.int64)


def copies(observation: Observation, sources: BoolArray) -> FloatArray:
    """Mean of x^j_c − x^i_c over the live sources j of component c, 0 without one; arguments of :func:`routed_inputs`.

    Returns:
        Displacements, shape (R, n).
    """
    total, count = totals(observation, sources)
    return total / np.maximum(count, 1)


def routed_inputs(observation: Observation, drift: FloatArray, step: float | FloatArray) -> FloatArray:
    """x^i_c ← mean of x^j_c over the live sources j of c, else x^i_c; and x^i_i ← x^i_i − η ∂J_i/∂x_i(x^i).

    The whole law, with η = ``step``. A player has no source of its own components. Where the sources are the neighbours
    that are nearer to the owner of c on a fixed graph, x^i_c is the owner's strategy d_ic steps ago, d_ic being the hop
    count: gradient play with delays, x_i(k+1) = x_i(k) − η ∂J_i/∂x_i(x_1(k − d_i1), …, x_N(k − d_iN)).

    Args:
        observation: of R players.
        drift: displacements of the others' estimates by :func:`copies`, shape (R, n).
        step: η, one number for all or one per player, shape (R, 1).

    Returns:
        Inputs, shape (R, n).
    """
    return per_step(drift - step * observation.gradient, observation)


class RoutedUnknown(Law):
    """Copies and a gradient step, :func:`routed_inputs`; own links show the sources, :func:`contacts`.

    Args:
        layout: of the environment.
        step: η > 0.

    Raises:
        ValueError: for a step that is not positive.
    """

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
        super().__init__(layout)
        self.step = require_positive("step", step)
        self._parts = Parts(self._shapes())

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of the memory."""
        links = dict.fromkeys(("live", "heard"), (self.layout.slots,))
        return contact_parts(self.layout) | links | {"drift": (self.layout.dimension,), "steps": (1,)}

    def initial_memory(self, rows: int) -> FloatArray:
        """No contact and no step done, shape (R, size)."""
        parts = self._parts.zeros(rows)
        parts["seen"] += np.inf
        return self._parts.join(parts)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        drift, parts = self.copied(observation, self._parts.split(memory), moves=True)
        return routed_inputs(observation, drift, self.step), self._parts.join(parts)

    def copied(
        self, observation: Observation, parts: dict[str, FloatArray], *, moves: BoolArray | bool
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Displacements of the others' estimates, shape (R, n), and the parts of the memory for the next step.

        Args:
            observation: of R players.
            parts: of the memory by name.
            moves: whether the others' estimates move in this step, shape (R, 1).
        """
        player, live = observation.player, observation.weights > 0
        leaders = self.layout.neighbour_components[player]
        sources, fresh = contacts(observation, parts, parts["drift"], leaders)
        drift = np.where(moves, copies(observation, sources & ~self.layout.own_mask[player][:, None]), 0.0)
        fresh |= {"live": live.astype(np.float64), "heard": np.maximum(parts["heard"], live)}
        fresh |= {"drift": within_reach(drift, observation, self.layout), "steps": parts["steps"] + 1}
        return drift, fresh
