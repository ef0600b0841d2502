"""The fields of an observation, one entry each. Layouts, encoders, the world on JAX and documents read this table.

A new field is one entry more. Interfaces that name no fields stay as they are, and a policy that is to see the new one
names it: ``Interface("scaled", fields=(*Interface("scaled").fields, "degree"))``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

InterfaceKind: TypeAlias = Literal["scaled", "physical", "full"]

OBSERVATION_BOUND = 1e6
"""Box bound of every observed entry that carries units."""

SMALLEST_SCALE = 1e-30
"""Under ``scaled`` the scale σ_i is at least this, so that a player at rest divides by a positive number."""

LOG_SCALE_UNIT = 10.0
"""The logarithm of the scale is divided by this, so that it is of order one."""

_ALL: tuple[InterfaceKind, ...] = get_args(InterfaceKind)


def _natural(_: Any) -> tuple[float, float]:
    return -OBSERVATION_BOUND, OBSERVATION_BOUND


def _differences(layout: Any) -> tuple[float, float]:
    return (-1.0, 1.0) if layout.is_scaled else _natural(layout)


@dataclass(frozen=True)
class Field:
    """A field of the observation, for numpy and JAX alike.

    Attributes:
        name: of the slice in layouts.
        size: number of entries, a product such as ``"D n"`` of numbers and of N players, n components, D neighbour
            slots and m, the largest n_i.
        value: computes the entries from a :class:`~ptne_env.perception.encoder.View`, with the library of its arrays:
            shape (size, N, B), of which N and B may be 1 where all players or environments have the same.
        content: what it is, in Markdown, for ``docs/environment.md``.
        bounds: lowest and highest entries, from an :class:`~ptne_env.perception.observation.ObservationLayout`.
        kinds: the interfaces that have it by default, and no other may have it; if none does, all may.
        is_privileged: whether players lack this information; then it is for oracles only.
        follows_state: whether it depends on more than the step, in a :class:`~ptne_env.world.world.World`. If not,
            numpy computes it once.
    """

    name: str
    size: str
    value: Callable[[Any], Any]
    content: str
    bounds: Callable[[Any], Any] = _natural
    kinds: tuple[InterfaceKind, ...] = ()
    is_privileged: bool = False
    follows_state: Callable[[Any], bool] = lambda _: True


# fmt: off
FIELDS: dict[str, Field] = {field.name: field for field in (
    Field("own_gradient", "m", attrgetter("own_gradients"),
          r"$\partial J_i/\partial x_i$ at the player's own estimate, padded with 0 to the largest $n_i$",
          _differences, _ALL),
    Field("own_estimate", "n", attrgetter("state.estimates"), "$x^i$", _natural, ("physical", "full")),
    Field("relative_estimates", "D n", attrgetter("relative_estimates"),
          "$x^j - x^i$ per neighbour slot, $x^j$ as the channel delivers it; 0 where the link is down",
          _differences, _ALL),
    Field("weights", "D", attrgetter("weights"),
          "$a_{ij}$ per neighbour slot; 0 where the link is down, or the message is lost",
          lambda layout: (0.0, layout.largest_weight), _ALL,
          follows_state=lambda world: not world.has_constant_weights),
    Field("log_scale", "1", lambda view: view.xp.log10(view.scale)[None] / LOG_SCALE_UNIT,
          r"a tenth of $\log_{10} \sigma_i$",
          lambda _: np.log10([SMALLEST_SCALE, OBSERVATION_BOUND]) / LOG_SCALE_UNIT, ("scaled",)),
    Field("clock", "4", lambda view: view.times / view.layout.time_units.astype(np.float32)[:, None, None],
          r"$t/T$, $s$ (over the largest $s$ under `scaled`), $\Theta_k$, $\Delta t_k/T$",
          lambda layout: (0.0, np.array(layout.largest_clock) / layout.time_units), _ALL,
          follows_state=lambda _: False),
    Field("time_since_switch", "1", attrgetter("time_since_switch"),
          "in units of the mean dwell, clipped to 1; 0 for a fixed graph",
          lambda _: (0.0, 1.0), _ALL, follows_state=lambda world: world.topology.is_random),
    Field("player", "N", lambda view: np.eye(view.layout.num_players)[:, :, None], "one-hot",
          lambda _: (0.0, 1.0), _ALL, follows_state=lambda _: False),
    Field("relative_equilibrium", "n", lambda view: view.state.game.nash_equilibria[:, None] - view.state.estimates,
          r"$x^\ast - x^i$", _natural, ("full",), is_privileged=True),
)}
# fmt: on
"""All fields by name, in the order of observations."""
