"""The encoder connects an observation layout to a running world: states to observations, actions to inputs."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ptne_env.arrays import Float32Array, FloatArray, IntArray
from ptne_env.dynamics import RANGE_LIMIT, State, World
from ptne_env.observation import CONSENSUS_GAIN, GAIN_OCTAVES, OBSERVATION_BOUND, Interface, ObservationLayout

SMALLEST_SCALE = 1e-30
"""The scale σ_i of the ``local`` interface is at least this, so that a player at rest divides by something."""

_PADDING = 16
"""Columns by which the rows of an observation workspace are longer than a batch that is larger than that."""

_SCRATCH_ENTRIES = 32_768
"""Numbers in the float64 scratch of a workspace, or one neighbour slot if that is more: it stays in a core's cache."""

_WORKSPACES = 2
"""Observation workspaces that a encoder keeps, one per batch size: a vector environment has blocks of two sizes."""


class NonFiniteActionError(ValueError):
    """An action holds NaN or infinity."""


class Clipped(NamedTuple):
    """Finite actions within the action box.

    Attributes:
        actions: shape (B, N, action size).
        clipped: entries of each player's action that were outside the box, shape (B, N).
    """

    actions: npt.NDArray[np.floating]
    clipped: IntArray


class Decoded(NamedTuple):
    """What a encoder made of actions.

    Attributes:
        inputs: u within the input limit, shape (n, N, B).
        clipped: entries of each player's action outside the box, shape (B, N).
    """

    inputs: FloatArray
    clipped: IntArray


@dataclass
class _Workspace:
    """Where a encoder puts observations of one batch size together.

    Attributes:
        fields: views of each part, environments last, and of everything as (B, N size).
        relative: relative estimates of some neighbour slots at a time: the slots, their part of the fields, and a
            float64 scratch of that shape (slots, n, N, B), which the others use too.
        instant: whose clock stands in the fields, where all environments share one.
    """

    fields: dict[str, Float32Array]
    relative: list[tuple[slice, Float32Array, FloatArray]]
    instant: int | None = None


class Encoder:
    """Where policies plug into a world: states to observations, actions to inputs, for every batch size.

    Args:
        world: the world.
        interface: units, order and action mode.

    Raises:
        ValueError: when the interface shows best responses and the game has none.
    """

    def __init__(self, world: World, interface: Interface) -> None:
        self.world = world
        self.interface = interface
        game, clock = world.game, world.clock
        if interface.best_response and not game.has_best_response:
            raise ValueError(f"best_response cannot be observed: {type(game).__name__} has none everywhere")
        self.layout = layout = ObservationLayout(
            interface=interface,
            action_dims=game.action_dims,
            neighbours=tuple(tuple(int(j) for j in column) for column in world.neighbours.T),
            input_limit=world.scenario.input_limit,
            deadline=clock.deadline,
        )
        n, players, slots = game.dimension, game.num_players, world.slots
        # What every observation of an instant shares: the clock and the age of the graph; (5, 1 or N, K+H+1).
        t, s, theta = world.readings
        shared = [np.broadcast_to(row, t.shape) for row in (clock.dt / clock.deadline, world.time_since_switch)]
        self._clock_table = np.stack([t / clock.deadline, s, theta, *shared]).astype(np.float32)
        self._workspaces: dict[int, _Workspace] = {}
        self._scaled: tuple[State, FloatArray] | None = None
        # Row of own_gradients in each place of a player's own block, shape (m, N); padding is masked out.
        own = layout.own_components.T
        self._gradient_rows = np.minimum(own, n - 1)
        self._gradient_mask = (own < n)[:, :, None] if (own == n).any() else None
        # Rows of a (n N, B) array: in ego order from player order, and back.
        everybody = np.arange(players)
        self._ego_rows = layout.ego_order.T * players + everybody
        self._player_rows = layout.ego_place.T * players + everybody
        self._ego_neighbour_rows = layout.ego_order.T[None] * players + world.neighbours[:, None, :]
        self._own_rows = np.arange(n), game.owners
        self._slots = (slots, n, players)

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles go without the workspace, whose parts are views of one buffer and would come apart."""
        return {**self.__dict__, "_workspaces": {}, "_scaled": None}

    def twin(self) -> Encoder:
        """A encoder for other environments of the same world, with the same tables and workspaces: those stay in cache."""
        result = copy.copy(self)
        result._workspaces = self._workspaces  # noqa: SLF001 - of the same class
        return result

    def observation_space(self) -> spaces.Box:
        """A new Box for one player's observation, float32."""
        layout = self.layout
        low = np.full(layout.size, -OBSERVATION_BOUND, dtype=np.float32)
        high = np.full(layout.size, OBSERVATION_BOUND, dtype=np.float32)

        def bound(name: str, lowest: npt.ArrayLike, highest: npt.ArrayLike) -> None:
            low[layout.slices[name]], high[layout.slices[name]] = lowest, highest

        bound("weights", 0.0, self.world.mode_weights.max() * self.world.channel.largest_weight_factor)
        bound("clock", 0.0, self._clock_table[:4].max(axis=(1, 2)))
        bound("time_since_switch", 0.0, 1.0)
        bound("player", 0.0, 1.0)
        if self.interface.kind == "local":
            bound("own_gradient", -1.0, 1.0)
            bound("relative_estimates", -1.0, 1.0)
            bound("log_scale", np.log10(SMALLEST_SCALE), np.log10(2 * RANGE_LIMIT))
        return spaces.Box(low, high, dtype=np.float32)

    def action_space(self) -> spaces.Box:
        """A new Box for one player's action, float32, symmetric about 0."""
        bound = self.layout.action_bound
        return spaces.Box(-bound, bound, (self.layout.action_size,), dtype=np.float32)

    def observe(self, state: State, out: Float32Array | None = None) -> Float32Array:
        """Everybody's observations, shape (B, N, size), float32, C-contiguous and owned by the caller.

        Args:
            state: what is observed.
            out: where to write, of that shape and C-contiguous; a new array if left out.
        """
        batch = state.estimates.shape[2]
        workspace = self._workspaces.get(batch) or self._prepare(batch)
        fields, instants = workspace.fields, state.instants
        if self.interface.kind == "local":
            differences, scale = self._ego_differences(state)
            self._scaled = (state, scale)
            differences *= 1 / scale  # in float64, and cast in a second pass: faster than numpy's casting output
            fields["differences"][...] = differences
            fields["log_scale"][...] = np.log10(scale)
        else:
            fields["own_estimate"][...] = state.estimates
            fields["own_gradient"][...] = self._own_gradients(state)
            for slots, shown, scratch in workspace.relative:
                shown[...] = self.world.relative_estimates(state, slots, scratch)
        if not self.world.has_constant_weights:
            fields["weights"][...] = state.weights
        instant = instants.item() if instants.size == 1 else None
        if instant is None or instant != workspace.instant:  # blocks of a vector environment are often in lockstep
            fields["clock"][...] = self._clock_table.take(instants, axis=2)
            workspace.instant = instant
        if self.world.topology.is_random:
            fields["time_since_switch"][...] = state.time_since_switch
        if self.interface.kind == "full":
            strategies = state.strategies
            fields["relative_strategies"][...] = strategies[:, None, :] - state.estimates
            with np.errstate(over="ignore"):
                pseudo_gradient = state.game.pseudo_gradient(strategies)
            if state.game.has_bounds:
                theta = self.world.clock.theta[state.instants]
                theta = np.where(theta > 0, theta, 1.0)  # at the end, from where nobody moves
                pseudo_gradient = (strategies - state.game.project(strategies - theta * pseudo_gradient)) / theta
            pseudo_gradient = np.clip(pseudo_gradient, -OBSERVATION_BOUND, OBSERVATION_BOUND)
            fields["pseudo_gradient"][...] = pseudo_gradient[:, None]
        self._observe_extras(state, fields)
        if out is None:
            out = np.empty((batch, self.layout.num_players, self.layout.size), dtype=np.float32)
        np.copyto(out.reshape(batch, -1), fields["everything"])
        return out

    def clip(self, actions: npt.NDArray[np.floating]) -> Clipped:
        """Clip actions of any number of environments, shape (B, N, action size), to the action box, and count.

        Raises:
            NonFiniteActionError: when an action holds NaN or infinity.
        """
        bound = self.layout.action_bound
        highest, lowest = np.maximum.reduce(actions, axis=None), np.minimum.reduce(actions, axis=None)
        if highest <= bound and lowest >= -bound:
            return Clipped(actions, np.zeros(actions.shape[:2], dtype=np.int64))
        if not np.isfinite(actions).all():
            raise NonFiniteActionError("actions must be numbers without NaN or infinity")
        return Clipped(np.clip(actions, -bound, bound), (np.abs(actions) > bound).sum(axis=2))

    def inputs(self, actions: npt.NDArray[np.floating], state: State) -> FloatArray:
        """Turn clipped actions (B, N, action size) into inputs u within the input limit, shape (n, N, B).

        Actions are rounded to float32, as the space declares.
        """
        fields = np.empty(actions.shape[::-1])
        fields[...] = actions.astype(np.float32, copy=False).T
        if self.interface.action_mode == "gains":
            inputs = self._inputs_from_gains(fields, state)
        elif self.interface.kind == "local":
            fields *= self.interface.action_scale * self._scale(state)
            inputs = fields.reshape(-1, state.batch_size).take(self._player_rows, axis=0)
        else:
            return fields  # the action box is the input limit
        limit = self.layout.input_limit
        np.minimum(inputs, limit, out=inputs)  # np.clip does the same, but for one environment its wrapper costs more
        return np.maximum(inputs, -limit, out=inputs)

    def decode(self, actions: npt.NDArray[np.floating], state: State) -> Decoded:
        """:meth:`clip` and :meth:`inputs` in one.

        Raises:
            NonFiniteActionError: when an action holds NaN or infinity.
        """
        inside, clipped = self.clip(actions)
        return Decoded(self.inputs(inside, state), clipped)

    def _inputs_from_gains(self, gains: FloatArray, state: State) -> FloatArray:
        gradient_gain, consensus_gain = np.exp2(GAIN_OCTAVES * gains)
        inputs = np.einsum("dib,dcib->cib", state.weights, state.relative_estimates)
        inputs *= CONSENSUS_GAIN * consensus_gain
        inputs[self._own_rows] -= gradient_gain[state.game.owners] * state.own_gradients
        return inputs

    def _prepare(self, batch: int) -> _Workspace:
        """The workspace of a batch size. Parts that never change are written here."""
        layout = self.layout
        # Rows of a power-of-two length fall on the same cache lines when they are transposed; padding parts them.
        row = batch + _PADDING if batch > _PADDING else batch
        buffer = np.zeros((layout.num_players, layout.size, row), dtype=np.float32)
        fields = buffer.transpose(1, 0, 2)[:, :, :batch]
        parts = {name: fields[part] for name, part in layout.slices.items()}
        parts["differences"] = fields[: layout.slices["relative_estimates"].stop]  # under "local" one block
        parts["relative_estimates"] = parts["relative_estimates"].reshape(*self._slots, batch)
        parts["clock"] = fields[layout.slices["clock"].start : layout.slices["time_since_switch"].stop]
        parts["player"][...] = np.eye(layout.num_players, dtype=np.float32)[:, :, None]
        parts["everything"] = buffer.reshape(-1, row)[:, :batch].T
        if self.world.has_constant_weights:
            parts["weights"][...] = self.world.mode_weights
        while len(self._workspaces) >= _WORKSPACES:
            self._workspaces.pop(next(iter(self._workspaces)))
        slots, n, players = self._slots
        scratch = np.empty((max(1, min(slots, _SCRATCH_ENTRIES // (n * players * batch))), n, players, batch))
        some = [slice(first, min(first + len(scratch), slots)) for first in range(0, slots, len(scratch))]
        relative = [(part, parts["relative_estimates"][part], scratch[: part.stop - part.start]) for part in some]
        self._workspaces[batch] = workspace = _Workspace(parts, relative)
        return workspace

    def _observe_extras(self, state: State, fields: dict[str, Float32Array]) -> None:
        """What only some interfaces show."""
        interface = self.interface
        if interface.own_payoff:
            with np.errstate(over="ignore", invalid="ignore"):  # a diverged game may overflow
                costs = state.game.costs(state.strategies)
            fields["own_payoff"][...] = np.clip(np.nan_to_num(costs), -OBSERVATION_BOUND, OBSERVATION_BOUND)
        if interface.neighbour_errors:
            errors = -np.einsum("dib,dcib->cib", state.weights, state.relative_estimates)
            seen = errors[:, self.world.neighbours].swapaxes(0, 1)
            fields["neighbour_errors"][...] = seen.reshape(fields["neighbour_errors"].shape)
        if interface.best_response:
            strategies = state.strategies
            response = state.game.best_response(strategies) - strategies
            fields["best_response"][...] = np.clip(response, -OBSERVATION_BOUND, OBSERVATION_BOUND)[:, None]

    def _own_gradients(self, state: State) -> FloatArray:
        """Own gradients per player, padded with 0, shape (m, N, B)."""
        if self._gradient_mask is None and len(self._gradient_rows) == 1:
            return state.own_gradients[None]
        gradients = state.own_gradients.take(self._gradient_rows, axis=0)
        if self._gradient_mask is not None:
            gradients *= self._gradient_mask
        return gradients

    def _ego_differences(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Own gradients, then x^j − x^i in ego order, (m + D n, N, B), and the scale σ_i, (N, B)."""
        gradients = self._own_gradients(state)
        own, (slots, n, players), batch = len(gradients), self._slots, state.batch_size
        differences = np.empty((own + slots * n, players, batch))
        differences[:own] = gradients
        relative = differences[own:].reshape(slots, n, players, batch)
        rows = state.estimates.reshape(-1, batch)
        if state.received is None:
            rows.take(self._ego_neighbour_rows, axis=0, out=relative, mode="clip")  # "raise" would copy once more
        else:
            messages = state.received.messages.reshape(slots, -1, batch)
            messages.take(self._ego_rows, axis=1, out=relative, mode="clip")
        relative -= rows.take(self._ego_rows, axis=0)
        if not self.world.has_constant_weights:
            relative *= (state.weights > 0)[:, None]
        scale = np.maximum.reduce(np.abs(differences), axis=0)
        return differences, np.maximum(scale, SMALLEST_SCALE, out=scale)

    def _scale(self, state: State) -> FloatArray:
        """σ_i = max(‖own gradient‖_∞, max over live links ‖x^j − x^i‖_∞, 1e-30), shape (N, B)."""
        if self._scaled is None or self._scaled[0] is not state:
            self._scaled = (state, self._ego_differences(state)[1])
        return self._scaled[1]
