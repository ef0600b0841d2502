"""Routed play: estimates travel from the owner of a component to all other players, one link per step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.laws.base import Law, per_step
from ptne_env.laws.identification import Curvature, clip_to_reach, see_curvature
from ptne_env.laws.sources import Contacts, find_sources, initial_contacts, mean_difference
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive


class RoutedMemory(NamedTuple):
    """What R players remember."""

    contacts: Contacts  # with their neighbours
    drift: FloatArray  # the last moves of the others' estimates, shape (R, n)
    steps: FloatArray  # number of steps done, shape (R, 1)
    curvature: Curvature  # of the own costs


class RoutedUnknown(Law):
    """A law that copies estimates from the neighbours that have them first, and takes gradient steps.

    x^i_c ← mean of x^j_c over the live sources j of c, if there are any, and x^i_i ← x^i_i − η ∂J_i/∂x_i(x^i). A player
    has no source of its own components; :func:`~ptne_env.laws.sources.find_sources` finds those of
    others from the own links alone. On a fixed graph where the sources are the neighbours that are nearer to the owner
    of c, x^i_c is the owner's strategy d_ic steps ago, d_ic being the hop count. That is gradient play with delays,
    x_i(k+1) = x_i(k) − η ∂J_i/∂x_i(x_1(k − d_i1), …, x_N(k − d_iN)).

    The step is the smaller one of η and 1/L (:func:`~ptne_env.laws.identification.see_curvature`): gradient steps above
    2/L go too far.

    Args:
        layout: the layout of the environment.
        step: η > 0, the largest step.

    Raises:
        ValueError: for a step that is not positive.
    """

    def __init__(self, layout: ObservationLayout, step: float = 0.3) -> None:
        super().__init__(layout)
        self.step = require_positive("step", step)

    def initial_memory(self, rows: int) -> RoutedMemory:
        components, none = np.zeros((rows, self.layout.dimension)), np.zeros((rows, 1))
        contacts = initial_contacts(self.layout, rows)
        return RoutedMemory(contacts, components, none, Curvature(none, components, components))

    def inputs(self, observation: Observation, memory: RoutedMemory) -> tuple[FloatArray, RoutedMemory]:
        was, player = memory, observation.player
        leaders, is_own = self.layout.neighbour_components[player], self.layout.own_mask[player]
        sources, contacts = find_sources(observation, was.contacts, was.steps > 0, was.drift, leaders)
        drift = mean_difference(observation, sources & ~is_own[:, None])
        seen = see_curvature(was.curvature, observation, is_own)
        own = observation.gradient / np.maximum(1 / self.step, seen.largest)
        asked = clip_to_reach(drift, observation, self.layout)
        seen = seen._replace(moves=(drift - own) * observation.unit)
        return per_step(drift - own, observation), RoutedMemory(contacts, asked, was.steps + 1, seen)
