"""Encoders connect a layout to a running world: states to observations, actions to inputs, for every batch size."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptne_env.perception.observation import (
    INPUT_PER_ACTION,
    SMALLEST_SCALE,
    Interface,
    ObservationLayout,
)
from ptne_env.shared.arrays import Float32Array, FloatArray, IntArray
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

_PADDING = 16
"""Unused columns at the end of each row of a workspace, in batches of more environments than this."""

_WORKSPACES = 2
"""Observation workspaces of an encoder, one per batch size: a vector environment has blocks of two sizes."""


class NonFiniteActionError(ValueError):
    """An action holds NaN or infinity."""


class _Workspace(NamedTuple):
    """Memory in which an encoder assembles the observations of one batch size.

    Attributes:
        fields: views of each slice, environments last; ``everything`` is (B, N size).
        scratch: own gradients, then relative estimates in float64, (m + D n, N, B).
        relative: the view of ``scratch`` that holds the relative estimates, (D, n, N, B).
    """

    fields: dict[str, Float32Array]
    scratch: FloatArray
    relative: FloatArray


class Encoder(ABC):
    """Observations and inputs of one interface in one world. Make one with :func:`make_encoder`.

    Args:
        world: the world.
        interface: what is observed, and in which units and order.

    Attributes:
        world: as given.
        interface: as given.
        layout: of observations and actions; policies are built from it.
        clock_table: t/T, s, Θ_k, Δt_k/T and the time since the last switch as observed, float32, shape (5, 1,
            K+H+1), the same for all players.
        slot_order: the world's neighbour slot in each slot of the layout, shape (D, N); ``None`` for the same slots.
        gradient_rows: row of the own gradients in each place of a player's own block, shape (m, N).
        gradient_mask: False in padded places, shape (m, N, 1); ``None`` where no place is padded.
    """

    def __init__(self, world: World, interface: Interface) -> None:
        self.world = world
        self.interface = interface
        game, clock = world.game, world.clock
        # All environments at the same step share the clock and the time since the last switch.
        times = [clock.t / clock.deadline, clock.s, clock.theta, clock.dt / clock.deadline, world.time_since_switch]
        self.clock_table = np.stack(times)[:, None].astype(np.float32)
        self.slot_order = self._order_slots()
        largest_t, largest_s, largest_theta, largest_dt = self.clock_table[:4].max(axis=(1, 2)).tolist()
        self.layout = layout = ObservationLayout(
            interface=interface,
            action_dims=game.action_dims,
            neighbours=tuple(map(tuple, self._in_slots(world.neighbours).T.tolist())),
            input_limit=world.input_limit,
            message_range=world.message_range,
            deadline=clock.deadline,
            largest_weight=float(world.mode_weights.max()),
            largest_clock=(largest_t, largest_s, largest_theta, largest_dt),
        )
        self.clock_table[1] /= layout.units[1]
        own = layout.own_components.T
        self.gradient_rows = np.minimum(own, game.dimension - 1)
        self.gradient_mask = (own < game.dimension)[:, :, None] if (own == game.dimension).any() else None
        self._workspaces: dict[int, _Workspace] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles have no workspaces: their views of one buffer would become separate arrays."""
        return {**self.__dict__, "_workspaces": {}}

    def with_shared_tables(self) -> Encoder:
        """An encoder for other environments of the same world, with the same tables and workspaces."""
        result = copy.copy(self)
        result._workspaces = self._workspaces  # noqa: SLF001 - of the same class
        return result

    def observe(self, state: State, out: Float32Array | None = None) -> Float32Array:
        """Observations of all players, shape (B, N, size), float32, C-contiguous and owned by the caller.

        Args:
            state: the observed state.
            out: where to write, of that shape and C-contiguous; a new array if left out.
        """
        batch, world = dynamics.batch_size(state), self.world
        workspace = self._workspaces.get(batch) or self._prepare(batch)
        fields = workspace.fields
        link_weights = None if world.has_constant_weights else dynamics.weights(world, state)
        self._write_differences(workspace, state, link_weights)
        if link_weights is not None:
            fields["weights"][...] = self._in_slots(link_weights)
        fields["clock_and_age"][...] = self.clock_table.take(dynamics.shared_step(state), axis=2)
        if world.topology.is_random:
            fields["time_since_switch"][...] = dynamics.time_since_switch(world, state)
        if out is None:
            out = np.empty((batch, self.layout.num_players, self.layout.size), dtype=np.float32)
        np.copyto(out.reshape(batch, -1), fields["everything"])
        return out

    def clip(self, actions: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.floating], IntArray]:
        """Clip actions of any number of environments, shape (B, N, action size), to the action box.

        Returns:
            The actions, and the entries of each player's that were outside, shape (B, N).

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
        return self._inputs_from_actions(inputs, state)

    def decode(self, actions: npt.NDArray[np.floating], state: State) -> FloatArray:
        """:meth:`clip`, then :meth:`inputs`.

        Raises:
            NonFiniteActionError: when an action holds NaN or infinity.
        """
        return self.inputs(self.clip(actions)[0], state)

    @abstractmethod
    def _write_differences(self, workspace: _Workspace, state: State, link_weights: FloatArray | None) -> None:
        """Write own gradients, relative estimates and the slices that only this kind of interface has."""

    @abstractmethod
    def _inputs_from_actions(self, actions: FloatArray, state: State) -> FloatArray:
        """Inputs u (n, N, B) within the input limit, from actions (n, N, B), which may be overwritten."""

    def _order_slots(self) -> IntArray | None:
        """See :attr:`slot_order`."""
        return None

    def _in_slots(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values by the world's slots, shape (D, N, …), by the layout's slots."""
        return values if self.slot_order is None else values[self.slot_order, np.arange(self.world.game.num_players)]

    def _own_gradients(self, state: State) -> FloatArray:
        """Own gradients per player, padded with 0, shape (m, N, B)."""
        if self.gradient_mask is None and len(self.gradient_rows) == 1:
            return state.own_gradients[None]
        gradients = state.own_gradients.take(self.gradient_rows, axis=0)
        if self.gradient_mask is not None:
            gradients *= self.gradient_mask
        return gradients

    def _prepare(self, batch: int) -> _Workspace:
        """The workspace of a batch size. Slices that never change are written here."""
        layout, world = self.layout, self.world
        slots, n, players = layout.slots, layout.dimension, layout.num_players
        # Transposing rows whose length is a power of two uses the same few cache lines again and again; unused columns
        # avoid that.
        row = batch + _PADDING if batch > _PADDING else batch
        buffer = np.zeros((players, layout.size, row), dtype=np.float32)
        columns = buffer.transpose(1, 0, 2)[:, :, :batch]
        fields = {name: columns[part] for name, part in layout.slices.items()}
        fields["gradient_and_relative_estimates"] = columns[: layout.slices["relative_estimates"].stop]
        fields["relative_estimates"] = fields["relative_estimates"].reshape(slots, n, players, batch)
        fields["clock_and_age"] = columns[layout.slices["clock"].start : layout.slices["time_since_switch"].stop]
        fields["everything"] = buffer.reshape(-1, row)[:, :batch].T
        fields["player"][...] = np.eye(players, dtype=np.float32)[:, :, None]
        if world.has_constant_weights:
            fields["weights"][...] = self._in_slots(world.mode_weights)
        while len(self._workspaces) >= _WORKSPACES:
            self._workspaces.pop(next(iter(self._workspaces)))
        scratch = np.empty((len(self.gradient_rows) + slots * n, players, batch))
        relative = scratch[len(self.gradient_rows) :].reshape(slots, n, players, batch)
        self._workspaces[batch] = workspace = _Workspace(fields, scratch, relative)
        return workspace


class PhysicalEncoder(Encoder):
    """The interface ``physical``: natural units, player order, actions are inputs."""

    def _write_differences(self, workspace: _Workspace, state: State, link_weights: FloatArray | None) -> None:
        fields, relative = workspace.fields, workspace.relative
        fields["own_estimate"][...] = state.estimates
        fields["own_gradient"][...] = self._own_gradients(state)
        fields["relative_estimates"][...] = dynamics.relative_estimates(self.world, state, link_weights, out=relative)

    def _inputs_from_actions(self, actions: FloatArray, state: State) -> FloatArray:  # noqa: ARG002 - the other kind needs it
        return actions  # the action box is the input limit


class FullEncoder(PhysicalEncoder):
    """The interface ``full``: ``physical``, and information that players lack; for oracles."""

    def _write_differences(self, workspace: _Workspace, state: State, link_weights: FloatArray | None) -> None:
        super()._write_differences(workspace, state, link_weights)
        equilibria = state.game.nash_equilibria[:, None]
        workspace.fields["relative_equilibrium"][...] = equilibria - state.estimates


class ScaledEncoder(Encoder):
    """The interface ``scaled``: differences and actions in units of σ_i, components and slots in ego order.

    σ_i = max(‖own gradient‖_∞, max over live links ‖x^j − x^i‖_∞, 1e-30).
    """

    def __init__(self, world: World, interface: Interface) -> None:
        super().__init__(world, interface)
        self._order = world.order_components(self.layout.ego_order)
        # Rows of an (n N, B) array in ego order, in the order of the players' components.
        self._player_rows = self.layout.ego_place.T * self.layout.num_players + np.arange(self.layout.num_players)
        self._scale_of: tuple[State, FloatArray] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles forget the state that was observed last, and its scale."""
        return {**super().__getstate__(), "_scale_of": None}

    def _write_differences(self, workspace: _Workspace, state: State, link_weights: FloatArray | None) -> None:
        differences, scale = self._differences(state, link_weights, workspace.scratch)
        self._scale_of = (state, scale)
        differences *= 1 / scale  # in float64, and cast in a second pass: faster than numpy's casting output
        workspace.fields["gradient_and_relative_estimates"][...] = differences
        workspace.fields["log_scale"][...] = np.log10(scale) / self.layout.units[0]

    def _inputs_from_actions(self, actions: FloatArray, state: State) -> FloatArray:
        if self._scale_of is None or self._scale_of[0] is not state:
            self._scale_of = (state, self._differences(state)[1])
        actions *= INPUT_PER_ACTION * self._scale_of[1]
        inputs = actions.reshape(-1, dynamics.batch_size(state)).take(self._player_rows, axis=0)
        limit = self.layout.input_limit
        np.minimum(inputs, limit, out=inputs)  # np.clip does the same, but for one environment its wrapper costs more
        return np.maximum(inputs, -limit, out=inputs)

    def _differences(
        self, state: State, link_weights: FloatArray | None = None, out: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Own gradients, then x^j − x^i in ego order, (m + D n, N, B), and the scale σ_i, (N, B)."""
        layout, own, batch = self.layout, len(self.gradient_rows), dynamics.batch_size(state)
        shape = layout.slots, layout.dimension, layout.num_players, batch
        differences = np.empty((own + shape[0] * shape[1], *shape[2:])) if out is None else out
        differences[:own] = self._own_gradients(state)
        relative = differences[own:].reshape(shape)
        dynamics.relative_estimates(self.world, state, link_weights, order=self._order, out=relative)
        by_slot = relative.swapaxes(1, 2)
        by_slot[...] = self._in_slots(by_slot)
        scale = np.maximum.reduce(np.abs(differences), axis=0)
        return differences, np.maximum(scale, SMALLEST_SCALE, out=scale)

    def _order_slots(self) -> IntArray:
        neighbours, players = self.world.neighbours, self.world.game.num_players
        distance = (neighbours - np.arange(players)) % players
        return np.argsort(np.where(distance == 0, players, distance), axis=0, kind="stable")  # padded slots are last


_ENCODERS: Mapping[str, type[Encoder]] = {"scaled": ScaledEncoder, "physical": PhysicalEncoder, "full": FullEncoder}


def make_encoder(world: World, interface: Interface) -> Encoder:
    """The encoder of an interface's kind."""
    return _ENCODERS[interface.kind](world, interface)
