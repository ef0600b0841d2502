"""Observations and actions: interfaces, named slices, spaces, and how a policy reads and writes them.

A layout is all that a policy knows about the world. An :class:`~ptne_env.perception.encoder.Encoder` connects it to a
running one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, get_args

import numpy as np
from gymnasium import spaces

from ptne_env.perception.fields import FIELDS, LOG_SCALE_UNIT, InterfaceKind
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray, array_namespace, is_numpy
from ptne_env.shared.names import require_name

INPUT_PER_ACTION = 5 / 3
"""Under ``scaled`` an action of 1 is an input of this many σ_i. A Gaussian policy that starts with a standard deviation
of 1 then makes steps that are large enough to learn from, and small enough not to undo all progress."""


class LayoutError(ValueError):
    """A policy cannot act with a layout: it needs other observations or another game.

    In a comparison such a policy is not applicable to the scenario. Any other error is a failure of the policy there.
    """


@dataclass(frozen=True, repr=False)
class Interface:
    """What a policy observes, and what its actions mean. Every policy has one, the physics none.

    Attributes:
        units: ``"scaled"`` (scale-free numbers of order one, in ego order) or ``"physical"`` (natural units, player
            order). ``"full"`` stands for ``"physical"`` with information that players lack; it is for oracles only.
        fields: names of the observed :data:`~ptne_env.perception.fields.FIELDS`, which stand in the order of that
            table; the default ones of the units if left out.

    Raises:
        ValueError: for unknown units, or for a field that is unknown or not available in the units.
    """

    units: InterfaceKind = "scaled"
    fields: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_name("interface", self.units, get_args(InterfaceKind))
        given: Any = self.fields
        if isinstance(given, str):
            raise ValueError(f"fields must be a list of names, such as [{given!r}], got {given!r}")
        names = tuple(self.fields) or [name for name, field in FIELDS.items() if self.units in field.kinds]
        units: tuple[InterfaceKind, ...] = ("scaled",) if self.units == "scaled" else ("physical", "full")
        for name in names:
            kinds = FIELDS[require_name("field of the observation", name, FIELDS)].kinds
            if kinds and not set(kinds) & set(units):
                raise ValueError(f"{units[0]!r} has no field {name!r}, which is one of {', '.join(map(repr, kinds))}")
        object.__setattr__(self, "units", units[0])
        object.__setattr__(self, "fields", tuple(name for name in FIELDS if name in names))

    @property
    def is_privileged(self) -> bool:
        """Whether it shows information that players lack."""
        return any(FIELDS[name].is_privileged for name in self.fields)

    def to_dict(self) -> dict[str, Any]:
        """A JSON object: the kind, and the fields where they are not those of the kind."""
        kinds = [{"kind": kind} for kind in get_args(InterfaceKind) if self == Interface(kind)]
        return kinds[0] if kinds else {"kind": self.units, "fields": list(self.fields)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Interface:
        """The inverse of :meth:`to_dict`; ``ValueError``, ``TypeError`` or ``AttributeError`` for other data."""
        return cls(**{"units" if key == "kind" else key: value for key, value in data.items()})

    def __repr__(self) -> str:
        kind, *fields = self.to_dict().values()
        return f"Interface({kind!r}{f', fields={tuple(fields[0])}' if fields else ''})"


class Observation(NamedTuple):
    """Observations of R players, in float64 and player order. Gradients and estimates are in ``unit``.

    Attributes:
        player: index of the observing player, shape (R,).
        gradient: R_i^T ∂J_i/∂x_i(x^i), zero outside the own block, shape (R, n).
        relative_estimates: x^j − x^i per neighbour slot, shape (R, D, n).
        weights: a_ij per neighbour slot, shape (R, D).
        unit: natural units per unit of the above, shape (R, 1); σ_i under ``scaled``, else 1.
        theta: Θ_k of the coming step, shape (R, 1).
        dt: Δt_k of the coming step in seconds, shape (R, 1).
        elapsed: t/T by the player's clock, shape (R, 1).
        transformed: s by that clock, shape (R, 1).
        relative_equilibrium: x* − x^i, shape (R, n); empty (R, 0) unless the interface is ``full``.
        own_estimate: x^i in natural units, shape (R, n); empty (R, 0) under ``scaled``.
    """

    player: IntArray
    gradient: FloatArray
    relative_estimates: FloatArray
    weights: FloatArray
    unit: FloatArray
    theta: FloatArray
    dt: FloatArray
    elapsed: FloatArray
    transformed: FloatArray
    relative_equilibrium: FloatArray
    own_estimate: FloatArray


@dataclass(frozen=True)
class ObservationLayout:
    """The layout of observations and actions that a policy is built for.

    An observation is a flat float32 vector with a named slice per field of the interface, see :attr:`slices` and
    ``docs/environment.md``.

    Under ``scaled``, gradient and relative estimates are divided by σ_i = max(‖own gradient‖_∞, max over live links
    ‖x^j − x^i‖_∞, 1e-30), components and neighbour slots are in ego order (the own ones first, then cyclically), s in
    ``clock`` is divided by its largest value, and actions are in the box ±1. So every entry is of order one, and the
    same place means the same relation for every player.

    Attributes:
        interface: observed fields, and their units and order.
        action_dims: n_i of each player.
        neighbours: per player, the player in each of its D slots; a padded slot holds the player itself. A player knows
            its own row alone, and evaluation tries it: its decisions may depend on no other.
        input_limit: largest |u|.
        deadline: T in seconds.
        largest_weight: largest a_ij that a player can observe.
        largest_clock: largest t/T, s, Θ_k and Δt_k/T.
        message_range: R; messages are clipped to ±R before they are sent. Infinite where links have no range.
    """

    interface: Interface
    action_dims: tuple[int, ...]
    neighbours: tuple[tuple[int, ...], ...]
    input_limit: float
    deadline: float
    largest_weight: float
    largest_clock: tuple[float, float, float, float]
    message_range: float = np.inf

    @property
    def num_players(self) -> int:
        """N."""
        return len(self.action_dims)

    @cached_property
    def dimension(self) -> int:
        """n = Σ n_i."""
        return sum(self.action_dims)

    @property
    def slots(self) -> int:
        """D, neighbour slots per player."""
        return len(self.neighbours[0])

    @cached_property
    def slices(self) -> dict[str, slice]:
        """The named parts of an observation, in order."""
        symbols = {"N": self.num_players, "n": self.dimension, "D": self.slots, "m": max(self.action_dims)}
        slices, start = {}, 0
        for name in self.interface.fields:
            factors = FIELDS[name].size.split()
            stop = start + math.prod(symbols[factor] if factor in symbols else int(factor) for factor in factors)
            slices[name], start = slice(start, stop), stop
        return slices

    @cached_property
    def size(self) -> int:
        """Length of an observation."""
        return max(part.stop for part in self.slices.values())

    @property
    def action_size(self) -> int:
        """Length of an action, n."""
        return self.dimension

    @cached_property
    def time_units(self) -> FloatArray:
        """The units of the four entries of the field ``clock``; that of s is its largest value under ``scaled``."""
        return np.array([1.0, (self.largest_clock[1] or 1.0) if self.is_scaled else 1.0, 1.0, 1.0])

    @property
    def is_scaled(self) -> bool:
        """Whether differences and actions are in units of σ_i, and in ego order."""
        return self.interface.units == "scaled"

    @cached_property
    def action_bound(self) -> float:
        """Actions beyond ±bound are clipped: 1 under ``scaled``, else the input limit.

        The limit is rounded down to a float32, so that no action within it exceeds it.
        """
        if self.is_scaled:
            return 1.0
        bound = np.float32(self.input_limit)
        return float(bound if float(bound) <= self.input_limit else np.nextafter(bound, np.float32(0)))

    def observation_space(self) -> spaces.Box:
        """A new Box for one player's observation, float32."""
        low, high = np.empty((2, self.size), dtype=np.float32)
        for name, part in self.slices.items():
            low[part], high[part] = FIELDS[name].bounds(self)
        return spaces.Box(low, high, dtype=np.float32)

    def action_space(self) -> spaces.Box:
        """A new Box for one player's action, float32, within ± the action bound."""
        return spaces.Box(-self.action_bound, self.action_bound, (self.action_size,), dtype=np.float32)

    @cached_property
    def own_components(self) -> IntArray:
        """Components of each player's own block, padded with n to the largest n_i; shape (N, m)."""
        dims, places = np.array(self.action_dims)[:, None], np.arange(max(self.action_dims))
        return np.where(places < dims, np.cumsum(dims, axis=0) - dims + places, self.dimension)

    @cached_property
    def own_places(self) -> BoolArray:
        """Whether component c is at place p of player i's own block, shape (N, m, n)."""
        return self.own_components[:, :, None] == np.arange(self.dimension)

    @cached_property
    def ego_order(self) -> IntArray:
        """The component at each place of a player's ego order, shape (N, n)."""
        return (self.own_components[:, :1] + np.arange(self.dimension)) % self.dimension

    @cached_property
    def ego_place(self) -> IntArray:
        """The place of each component in a player's ego order, shape (N, n); inverse of ``ego_order``."""
        return np.argsort(self.ego_order, axis=1)

    @cached_property
    def neighbour_components(self) -> BoolArray:
        """Whether component c belongs to the neighbour in slot d of player i, shape (N, D, n)."""
        return self.own_mask[np.array(self.neighbours)] & self.filled_slots[:, :, None]

    @cached_property
    def filled_slots(self) -> BoolArray:
        """Whether slot d of player i is that of a neighbour, shape (N, D); empty slots come last."""
        return np.array(self.neighbours) != np.arange(self.num_players)[:, None]

    @cached_property
    def own_mask(self) -> BoolArray:
        """Whether component c is player i's own, shape (N, n)."""
        return np.logical_or.reduce(self.own_places, axis=1)

    def select(self, observation: Any, name: str) -> Any:
        """The slice ``name`` of observations of shape (..., size), of numpy or JAX; ``LayoutError`` if it has none."""
        if name not in self.slices:
            raise LayoutError(f"the layout of {self.interface} has no {name!r}; it has {', '.join(self.slices)}")
        return observation[..., self.slices[name]]

    def read(self, observation: Any) -> Observation:
        """Read observations of R players, shape (R, size), or of one player, shape (size,), of numpy or JAX.

        Raises:
            ValueError: when they have another shape than this layout's, or lack a field that is read.
        """
        if observation.shape[-1:] != (self.size,):
            raise ValueError(
                f"this policy was built for observations of length {self.size} ({self.interface}, {self.num_players} "
                f"players, {self.slots} neighbour slots), got the shape {observation.shape}"
            )
        xp, rows = array_namespace(observation), observation.shape[:-1]

        def part(name: str) -> Any:
            return xp.asarray(self.select(observation, name), dtype=np.float64)

        def optional(name: str) -> Any:
            return part(name) if name in self.slices else xp.empty((*rows, 0))

        is_player, clock = self.select(observation, "player"), part("clock")
        player = is_player.argmax(-1)
        of_player = player if is_numpy(observation) else is_player.astype(np.float64)  # as differences are: faster
        relative, unit = part("relative_estimates").reshape(*rows, self.slots, self.dimension), xp.ones((*rows, 1))
        if self.is_scaled:
            places = row_of(self.ego_place, of_player).astype(np.int64)
            relative = xp.take_along_axis(relative, places[..., None, :], axis=-1)
            unit = 10.0 ** (LOG_SCALE_UNIT * part("log_scale"))
        own = xp.where(row_of(self.own_places, of_player), part("own_gradient")[..., None], 0.0)
        return Observation(
            player=player,
            gradient=own.sum(-2),
            relative_estimates=relative,
            weights=part("weights"),
            unit=unit,
            theta=clock[..., 2:3],
            dt=clock[..., 3:4] * self.deadline,
            elapsed=clock[..., :1],
            transformed=clock[..., 1:2] * self.time_units[1],
            relative_equilibrium=optional("relative_equilibrium"),
            own_estimate=optional("own_estimate"),
        )

    def write(self, inputs: FloatArray, observation: Observation) -> Float32Array:
        """The actions that ask for ``inputs`` (R, n), given in the observation's unit and player order; (R, n) float32.

        Actions are clipped to the action box.
        """
        if self.is_scaled:
            inputs = np.take_along_axis(inputs, self.ego_order[observation.player], axis=1) / INPUT_PER_ACTION
        return np.clip(inputs, -self.action_bound, self.action_bound).astype(np.float32)


def row_of(table: Any, players: Any) -> Any:
    """Return the rows of a table (N, ...) of players: their indices (...), or one-hot rows (..., N) on JAX.

    JAX multiplies, which is faster than a look-up.
    """
    if is_numpy(players):
        return table.take(players, axis=0)  # faster than an index
    product = array_namespace(players).tensordot(players, table.astype(players.dtype), axes=1)
    return product.astype(table.dtype)
