"""Observations and actions: units, named slices, spaces, and how a policy reads and writes them.

A layout is all that a policy knows about the world. An :class:`~ptne_env.perception.encoder.Encoder` connects it to a
running one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray

InterfaceKind: TypeAlias = Literal["scaled", "physical", "full"]

OBSERVATION_BOUND = 1e6
"""Box bound of every observed entry that carries units."""

SMALLEST_SCALE = 1e-30
"""Under ``scaled`` the scale σ_i is at least this, so that a player at rest divides by a positive number."""

INPUT_PER_ACTION = 5 / 3
"""Under ``scaled`` an action of 1 is an input of this many σ_i. A Gaussian policy that starts with a standard deviation
of 1 then makes steps that are large enough to learn from, and small enough not to undo all progress."""

LOG_SCALE_UNIT = 10.0
"""Under ``scaled`` the logarithm of the scale is divided by this, so that it is of order one."""

_READ_APART = frozenset(("clock", "player", "time_since_switch"))
"""Slices of which :meth:`ObservationLayout.read` makes no float64 copy of their own."""


class LayoutError(ValueError):
    """A policy cannot act with a layout: it needs other observations or another game.

    In a comparison such a policy is not applicable to the scenario. Any other error is a failure of the policy there.
    """


@dataclass(frozen=True)
class Interface:
    """What a policy observes, and what its actions mean. Every policy has one, the physics none.

    Attributes:
        kind: ``"scaled"`` (scale-free numbers of order one, in ego order), ``"physical"`` (natural units, player order)
            or ``"full"`` (``physical`` and information that players lack; for oracles only).

    Raises:
        ValueError: for another kind.
    """

    kind: InterfaceKind = "scaled"

    def __post_init__(self) -> None:
        if self.kind not in get_args(InterfaceKind):
            raise ValueError(f"unknown interface {self.kind!r}; choose from {', '.join(get_args(InterfaceKind))}")


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

    An observation is a flat float32 vector of named slices, in the order of :attr:`slices`:

    ======================== ======== =======================================================================
    name                     size     content
    ======================== ======== =======================================================================
    ``own_gradient``         m        ∂J_i/∂x_i(x^i), padded with 0 to the largest n_i
    ``own_estimate``         n        x^i (not under ``scaled``)
    ``relative_estimates``   D n      x^j − x^i per neighbour slot, taken in float64; 0 where the link is down; x^j is
                                      what the channel delivers
    ``weights``              D        a_ij per neighbour slot; 0 where the link is down, or the message is lost
    ``log_scale``            1        log10 σ_i, over 10 (only under ``scaled``)
    ``clock``                4        t/T, s, Θ_k, Δt_k/T
    ``time_since_switch``    1        over the topology's mean dwell, clipped to 1; 0 for a fixed graph
    ``player``               N        one-hot
    ``relative_equilibrium`` n        x* − x^i (only under ``full``)
    ======================== ======== =======================================================================

    Under ``scaled``, gradient and relative estimates are divided by σ_i = max(‖own gradient‖_∞, max over live links
    ‖x^j − x^i‖_∞, 1e-30), components and neighbour slots are in ego order (the own ones first, then cyclically), s in
    ``clock`` is divided by its largest value, and actions are in the box ±1. So every entry is of order one, and the
    same place means the same relation for every player.

    Attributes:
        interface: units and order.
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
        n, slots, is_scaled = self.dimension, self.slots, self.interface.kind == "scaled"
        sizes = {"own_gradient": max(self.action_dims)}
        if not is_scaled:
            sizes["own_estimate"] = n
        sizes |= {"relative_estimates": slots * n, "weights": slots}
        if is_scaled:
            sizes["log_scale"] = 1
        sizes |= {"clock": 4, "time_since_switch": 1, "player": self.num_players}
        if self.interface.kind == "full":
            sizes["relative_equilibrium"] = n
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @cached_property
    def size(self) -> int:
        """Length of an observation."""
        return max(part.stop for part in self.slices.values())

    @property
    def action_size(self) -> int:
        """Length of an action, n."""
        return self.dimension

    @property
    def units(self) -> tuple[float, float]:
        """The units in which log10 σ_i and s are observed."""
        return (LOG_SCALE_UNIT, self.largest_clock[1] or 1.0) if self.interface.kind == "scaled" else (1.0, 1.0)

    @cached_property
    def action_bound(self) -> float:
        """Actions beyond ±bound are clipped: 1 under ``scaled``, else the input limit.

        The limit is rounded down to a float32, so that no action within it exceeds it.
        """
        if self.interface.kind == "scaled":
            return 1.0
        bound = np.float32(self.input_limit)
        return float(bound if float(bound) <= self.input_limit else np.nextafter(bound, np.float32(0)))

    def observation_space(self) -> spaces.Box:
        """A new Box for one player's observation, float32."""
        low = np.full(self.size, -OBSERVATION_BOUND, dtype=np.float32)
        high = np.full(self.size, OBSERVATION_BOUND, dtype=np.float32)
        log_unit, s_unit = self.units
        bounds: dict[str, tuple[npt.ArrayLike, npt.ArrayLike]] = {
            "weights": (0.0, self.largest_weight),
            "clock": (0.0, np.array(self.largest_clock) / [1.0, s_unit, 1.0, 1.0]),
            "time_since_switch": (0.0, 1.0),
            "player": (0.0, 1.0),
        }
        if self.interface.kind == "scaled":
            bounds["own_gradient"] = bounds["relative_estimates"] = (-1.0, 1.0)
            bounds["log_scale"] = (np.log10(SMALLEST_SCALE) / log_unit, np.log10(OBSERVATION_BOUND) / log_unit)
        for name, (lowest, highest) in bounds.items():
            low[self.slices[name]], high[self.slices[name]] = lowest, highest
        return spaces.Box(low, high, dtype=np.float32)

    def action_space(self) -> spaces.Box:
        """A new Box for one player's action, float32, within ± the action bound."""
        return spaces.Box(-self.action_bound, self.action_bound, (self.action_size,), dtype=np.float32)

    @cached_property
    def own_components(self) -> IntArray:
        """Components of each player's own block, padded with n to the largest n_i; shape (N, m)."""
        result = np.full((self.num_players, max(self.action_dims)), self.dimension, dtype=np.int64)
        offset = 0
        for player, dim in enumerate(self.action_dims):
            result[player, :dim] = np.arange(offset, offset + dim)
            offset += dim
        return result

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
        owners = np.repeat(np.arange(self.num_players), self.action_dims)
        neighbours = np.array(self.neighbours)
        own = neighbours == np.arange(self.num_players)[:, None]
        return (owners == neighbours[:, :, None]) & ~own[:, :, None]

    @cached_property
    def own_mask(self) -> BoolArray:
        """Whether component c is player i's own, shape (N, n)."""
        owners = np.repeat(np.arange(self.num_players), self.action_dims)
        return owners == np.arange(self.num_players)[:, None]

    def select(self, observation: npt.NDArray[np.floating], name: str) -> npt.NDArray[np.floating]:
        """The slice ``name`` of observations of shape (..., size), as a view.

        Raises:
            ValueError: when this layout has no such slice.
        """
        if name not in self.slices:
            raise ValueError(f"the {self.interface.kind!r} layout has no {name!r}; it has {', '.join(self.slices)}")
        return observation[..., self.slices[name]]

    def read(self, observation: npt.NDArray[np.floating]) -> Observation:
        """Read observations of R players, shape (R, size).

        Raises:
            ValueError: when the observations have another shape than this layout's.
        """
        if observation.ndim != 2 or observation.shape[1] != self.size:
            raise ValueError(
                f"this policy was built for observations of length {self.size} ({self.interface.kind!r} layout, "
                f"{self.num_players} players, {self.slots} neighbour slots), got the shape {observation.shape}"
            )
        rows = observation.shape[0]
        clock, is_player = (observation[:, self.slices[name]] for name in ("clock", "player"))
        values = {
            name: np.asarray(observation[:, part], dtype=np.float64)
            for name, part in self.slices.items()
            if name not in _READ_APART
        }
        player = is_player.argmax(axis=1)
        width = self.dimension + 1  # one column more, into which padding falls
        own = np.zeros(rows * width)
        own[self.own_components[player] + np.arange(0, rows * width, width)[:, None]] = values["own_gradient"]
        relative = values["relative_estimates"].reshape(rows, self.slots, self.dimension)
        unit = np.ones((rows, 1))
        log_unit, s_unit = self.units
        if self.interface.kind == "scaled":
            relative = np.take_along_axis(relative, self.ego_place[player][:, None, :], axis=2)
            unit = 10.0 ** (log_unit * values["log_scale"])
        unseen = np.empty((rows, 0))
        return Observation(
            player=player,
            gradient=own.reshape(rows, width)[:, :-1],
            relative_estimates=relative,
            weights=values["weights"],
            unit=unit,
            theta=np.asarray(clock[:, 2:3], dtype=np.float64),
            dt=np.asarray(clock[:, 3:4], dtype=np.float64) * self.deadline,
            elapsed=np.asarray(clock[:, :1], dtype=np.float64),
            transformed=s_unit * np.asarray(clock[:, 1:2], dtype=np.float64),
            relative_equilibrium=values.get("relative_equilibrium", unseen),
            own_estimate=values.get("own_estimate", unseen),
        )

    def write(self, inputs: FloatArray, observation: Observation) -> Float32Array:
        """The actions that ask for ``inputs`` (R, n), given in the observation's unit and player order; (R, n) float32.

        Actions are clipped to the action box.
        """
        if self.interface.kind == "scaled":
            ego = np.take_along_axis(inputs, self.ego_order[observation.player], axis=1)
            inputs = ego / INPUT_PER_ACTION
        return np.clip(inputs, -self.action_bound, self.action_bound).astype(np.float32)
