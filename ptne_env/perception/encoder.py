"""Encoders connect a layout to a running world: states to observations, actions to inputs, for every batch size."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from numpy.ma import MaskedArray

from ptne_env.perception.fields import FIELDS, SMALLEST_SCALE, InterfaceKind
from ptne_env.perception.observation import INPUT_PER_ACTION, Interface, ObservationLayout
from ptne_env.shared.arrays import Float32Array, FloatArray, IntArray, array_namespace
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

_NO_SCALE = np.ones((1, 1))
_NO_STATE: Any = None

_DIFFERENCES = "own_gradient", "relative_estimates"
"""Fields that are written in one pass under ``scaled``, where they are neighbours."""


class NonFiniteActionError(ValueError):
    """An action holds NaN or infinity."""


def find_action_fault(action: Any, shape: tuple[int, ...]) -> str | None:
    """Return what is wrong with an action of one player, or with those of several, or ``None``."""
    if isinstance(action, MaskedArray):
        return "is a masked array; expected a plain one"
    try:
        row = np.asarray(action)
    except ValueError:
        return f"is ragged; expected the shape {shape}"
    if row.dtype.kind not in "fiu":
        return f"has the dtype {row.dtype}; expected numbers, such as float32"
    if row.shape != shape:
        return f"has the shape {row.shape}; expected {shape}"
    return None if np.isfinite(row).all() else "is not finite; expected numbers without NaN or infinity"


@dataclass(slots=True)
class View:
    """B environments at one instant: what the fields of an observation are computed from.

    Attributes:
        xp: the library of all arrays, numpy or ``jax.numpy``.
        world: the world.
        layout: of the observation.
        state: the state.
        weights: a_ij in each slot of the layout, shape (D, N, B), or (D, N, 1) where all environments agree.
        own_gradients: ∂J_i/∂x_i(x^i) in the unit of the interface, padded with 0, shape (m, N, B).
        relative_estimates: x^j − x^i per slot, in the unit and order of the interface, shape (D n, N, B).
        scale: σ_i, shape (N, B); 1 in natural units, shape (1, 1).
        differences: under ``scaled``, own gradients, then relative estimates, in one array.
    """

    xp: Any
    world: World
    layout: ObservationLayout
    state: State
    weights: FloatArray
    own_gradients: FloatArray
    relative_estimates: FloatArray
    scale: FloatArray
    differences: FloatArray

    @property
    def times(self) -> Float32Array:
        """t/T, s, Θ_k and Δt_k/T, shape (4, 1, B)."""
        return _tabulate_clock(self.world)[:, None, self.state.step]

    @property
    def time_since_switch(self) -> Float32Array:
        """In units of the mean dwell, clipped to 1, shape (1, 1, B)."""
        return dynamics.time_since_switch(self.world, self.state)[None, None].astype(np.float32)


class _Workspace(NamedTuple):
    """Memory in which an encoder assembles the observations of one batch size.

    Attributes:
        everything: the observations, (B, N size).
        tables: where tables of parts go, and the tables.
        values: where other parts go, and the functions of a view that compute them.
        view: that each observation fills anew.
        by_slot: its relative estimates, (D, n, N, B).
    """

    everything: Float32Array
    tables: list[tuple[Float32Array, Any]]
    values: list[tuple[Float32Array, Any]]
    view: View
    by_slot: FloatArray


class Encoder:
    """Observations and inputs of one interface in one world.

    Attributes:
        world: the world.
        layout: of observations and actions; policies are built from it.
        parts: of the observation: where they are, and a table for each step, shape (size, N or 1, K+H+1), or for all,
            (size, N or 1, 1), or else the function of a :class:`View` that computes them. Neighbours are one part where
            that is possible, as few writes are fast.
    """

    def __init__(self, world: World, interface: InterfaceKind | Interface = "scaled") -> None:
        self.world, game = world, world.game
        interface = interface if isinstance(interface, Interface) else Interface(interface)
        self._slot_order = _ego_slots(world) if interface.units == "scaled" else None
        largest_t, largest_s, largest_theta, largest_dt = _tabulate_clock(world).max(axis=1).tolist()
        self.layout = layout = ObservationLayout(
            interface=interface,
            action_dims=game.action_dims,
            neighbours=tuple(map(tuple, self._in_slots(world.neighbours).T.tolist())),
            input_limit=world.input_limit,
            message_range=world.message_range,
            deadline=world.clock.deadline,
            largest_weight=float(world.mode_weights.max()),
            largest_clock=(largest_t, largest_s, largest_theta, largest_dt),
        )
        own = layout.own_components.T
        self._gradient_rows = np.minimum(own, game.dimension - 1)
        self._gradient_mask = (own < game.dimension)[:, :, None] if (own == game.dimension).any() else None
        self._has_single_components = max(game.action_dims) == 1
        self._order = world.order_components(layout.ego_order) if layout.is_scaled else None
        # Rows of an (n N, B) array in ego order, in the order of the players' components.
        self._player_rows = layout.ego_place.T * layout.num_players + np.arange(layout.num_players)
        self._constant_weights = self._in_slots(world.mode_weights)  # where they are
        self.parts = self._list_parts()
        self._scale_of: tuple[State | None, FloatArray] = None, _NO_SCALE
        self._workspaces: dict[int, _Workspace] = {}

    def __reduce__(self) -> tuple[type[Encoder], tuple[World, Interface]]:
        """Copies and pickles are made anew: views of one buffer would become arrays, and functions have no pickles."""
        return Encoder, (self.world, self.layout.interface)

    def with_shared_tables(self) -> Encoder:
        """An encoder for other environments of the same world, with the same tables and workspaces."""
        result = Encoder.__new__(Encoder)
        vars(result).update(vars(self))
        return result

    def observe(self, state: State, out: Float32Array | None = None) -> Float32Array:
        """Observations of all players, (B, N, size), float32, C-contiguous, in ``out`` or in an array of the caller."""
        batch = state.estimates.shape[2]
        workspace = self._workspaces.get(batch) or self._prepare(batch)
        view, world, links = workspace.view, self.world, None
        view.state = state
        if not world.has_constant_weights:
            links = dynamics.weights(world, state)
            view.weights = self._in_slots(links)
        relative = dynamics.relative_estimates(world, state, links, order=self._order, out=workspace.by_slot)
        if self._order is None:
            view.own_gradients = self._own_gradients(state)
        else:
            differences, by_slot = view.differences, relative.swapaxes(1, 2)
            by_slot[...] = self._in_slots(by_slot)
            view.own_gradients[...] = self._own_gradients(state)
            scale = np.maximum.reduce(np.abs(differences), axis=0)
            view.scale = np.maximum(scale, SMALLEST_SCALE, out=scale)
            self._scale_of = state, scale
            differences *= 1 / scale  # in float64, and cast in a second pass: faster than numpy's casting output
        for place, table in workspace.tables:
            place[...] = table.take(dynamics.shared_step(state), axis=2)
        for place, value in workspace.values:
            place[...] = value(view)
        view.state = _NO_STATE  # which may be freed
        if out is None:
            out = np.empty((batch, self.layout.num_players, self.layout.size), dtype=np.float32)
        np.copyto(out.reshape(batch, -1), workspace.everything)
        return out

    def look(self, world: World, state: State) -> View:
        """Return the view of a state in the encoder's world, or in its twin on JAX."""
        xp = array_namespace(state.estimates)
        links = None if world.has_constant_weights else dynamics.weights(world, state)
        weights = self._constant_weights if links is None else self._in_slots(links)
        gradients = self._own_gradients(state)
        relative = dynamics.relative_estimates(world, state, links, order=self._order)
        relative = self._in_slots(relative.swapaxes(1, 2)).swapaxes(1, 2).reshape(-1, *gradients.shape[1:])
        differences, scale, own = xp.concatenate([gradients, relative]), _NO_SCALE, len(gradients)
        if self._order is not None:
            scale = xp.maximum(xp.abs(differences).max(0), SMALLEST_SCALE)
            differences = differences * (1 / scale)
        return View(xp, world, self.layout, state, weights, differences[:own], differences[own:], scale, differences)

    def clip(self, actions: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.floating], IntArray]:
        """Clip actions, shape (B, N, action size), and count the entries of each player's that were outside, (B, N).

        Raises:
            NonFiniteActionError: when an action holds NaN or infinity.
        """
        bound = self.layout.action_bound
        highest, lowest = np.maximum.reduce(actions, axis=None), np.minimum.reduce(actions, axis=None)
        if highest <= bound and lowest >= -bound:
            return actions, np.zeros(actions.shape[:2], dtype=np.int64)
        if not np.isfinite(actions).all():
            raise NonFiniteActionError("actions must be numbers without NaN or infinity")
        return np.clip(actions, -bound, bound), (np.abs(actions) > bound).sum(axis=2)

    def inputs(self, actions: npt.NDArray[np.floating], state: State) -> FloatArray:
        """Turn clipped actions (B, N, action size) into inputs u within the input limit, shape (n, N, B).

        Actions are rounded to float32, as the space declares.
        """
        inputs = np.empty(actions.shape[::-1])
        inputs[...] = actions.astype(np.float32, copy=False).T
        if self._order is None:
            return inputs  # the action box is the input limit
        observed, scale = self._scale_of
        if observed is not state:
            scale = self.look(self.world, state).scale
            self._scale_of = state, scale
        inputs *= INPUT_PER_ACTION * scale
        inputs = inputs.reshape(-1, len(actions)).take(self._player_rows, axis=0)
        limit = self.layout.input_limit
        np.minimum(inputs, limit, out=inputs)  # np.clip does the same, but for one environment its wrapper costs more
        return np.maximum(inputs, -limit, out=inputs)

    def decode(self, actions: npt.NDArray[np.floating], state: State) -> FloatArray:
        """:meth:`clip`, which may raise ``NonFiniteActionError``, then :meth:`inputs`."""
        return self.inputs(self.clip(actions)[0], state)

    def _in_slots(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values by the world's slots, shape (D, N, …), by the layout's slots."""
        return values if self._slot_order is None else values[self._slot_order, np.arange(self.world.game.num_players)]

    def _own_gradients(self, state: State) -> FloatArray:
        """Own gradients per player, padded with 0, shape (m, N, B)."""
        if self._has_single_components:
            return state.own_gradients[None]
        gradients = state.own_gradients.take(self._gradient_rows, axis=0)
        return gradients if self._gradient_mask is None else gradients * self._gradient_mask

    def _list_parts(self) -> list[tuple[slice, Any]]:
        """See :attr:`parts`."""
        slices, absent = self.layout.slices, cast("Any", None)
        state = State(np.arange(self.world.clock.total_steps + 1), self.world.game, *[absent] * 3)
        view = View(np, self.world, self.layout, state, self._constant_weights, *[absent] * 4)
        tables = {name: FIELDS[name].value(view) for name in slices if not FIELDS[name].follows_state(self.world)}

        def group(name: str) -> Any:
            is_difference = self.layout.is_scaled and name in _DIFFERENCES
            return tables[name].shape[1:] if name in tables else is_difference or name

        def part(*names: str) -> tuple[slice, Any]:
            where = slice(slices[names[0]].start, slices[names[-1]].stop)
            if names[0] in tables:
                return where, np.concatenate([tables[name] for name in names])
            return where, attrgetter("differences") if names == _DIFFERENCES else FIELDS[names[0]].value

        return [part(*names) for _, names in groupby(slices, group)]

    def _prepare(self, batch: int) -> _Workspace:
        """The workspace of a batch size. Parts that never change are written here."""
        players, size = self.layout.num_players, self.layout.size
        # Transposing rows whose length is a power of two uses the same few cache lines again and again; 16 unused
        # columns avoid that.
        row = batch + 16 if batch > 16 else batch
        buffer = np.zeros((players, size, row), dtype=np.float32)
        columns = buffer.transpose(1, 0, 2)[:, :, :batch]
        own, n = len(self._gradient_rows), self.layout.dimension
        whole = np.empty((own + self.layout.slots * n, players, batch))
        arrays = self._constant_weights, whole[:own], whole[own:], _NO_SCALE, whole
        view = View(np, self.world, self.layout, _NO_STATE, *arrays)
        by_slot = whole[own:].reshape(-1, n, players, batch)
        workspace = _Workspace(buffer.reshape(-1, row)[:, :batch].T, [], [], view, by_slot)
        for where, content in self.parts:
            if callable(content):
                workspace.values.append((columns[where], content))
            elif content.shape[2] > 1:
                workspace.tables.append((columns[where], content))
            else:
                columns[where] = content
        while len(self._workspaces) > 1:  # one per batch size: a vector environment has blocks of two sizes
            self._workspaces.pop(next(iter(self._workspaces)))
        self._workspaces[batch] = workspace
        return workspace


def _tabulate_clock(world: World) -> Float32Array:
    """t/T, s, Θ_k and Δt_k/T in every step, shape (4, K+H+1)."""
    clock = world.clock
    return np.stack([clock.t / clock.deadline, clock.s, clock.theta, clock.dt / clock.deadline]).astype(np.float32)


def _ego_slots(world: World) -> IntArray:
    """The world's neighbour slot at each place of a player's ego order, shape (D, N); padded slots are last."""
    players = world.game.num_players
    distance = (world.neighbours - np.arange(players)) % players
    return np.argsort(np.where(distance == 0, players, distance), axis=0, kind="stable")
