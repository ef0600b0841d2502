"""How does a policy see and act? Observation layouts, units, order of components and action modes.

A *layout* is what a policy knows about its observations: named slices, the neighbours in its slots, units and limits.
A *port* connects one layout to a running world: it turns states into observations and actions into inputs.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ptne_env.arrays import BoolArray, Float32Array, FloatArray, IntArray, require_positive
from ptne_env.dynamics import RANGE_LIMIT, Dynamics, State

InterfaceKind: TypeAlias = Literal["physical", "local", "full"]
ActionMode: TypeAlias = Literal["input", "gains"]

OBSERVATION_BOUND = 1e6
"""Box bound of every observed entry that carries units."""

SMALLEST_SCALE = 1e-30
"""The scale σ_i of the ``local`` interface is at least this, so that a player at rest divides by something."""

GAIN_OCTAVES = 3.0
"""In action mode ``gains`` an action of ±1 multiplies or divides a gain by 2^3."""

_PADDING = 16
"""Columns by which the rows of an observation workspace are longer than a batch that is larger than that."""

_SCRATCH_ENTRIES = 32_768
"""Numbers in the float64 scratch of a workspace, or one neighbour slot if that is more: it stays in a core's cache."""

_WORKSPACES = 2
"""Observation workspaces that a port keeps, one per batch size: a vector environment has blocks of two sizes."""

CONSENSUS_GAIN = 2.0
"""In action mode ``gains`` the action 0 means gradient gain 1 and this consensus gain, the paper's κ."""


@dataclass(frozen=True)
class Interface:
    """How a policy sees and acts. A policy carries its own; the physics does not depend on it.

    Attributes:
        kind: ``"physical"`` (natural units, player order), ``"local"`` (scale-free, ego order) or ``"full"``
            (``physical`` and what no player can see; for oracles only).
        action_mode: ``"input"`` (an action is the input u^i) or ``"gains"`` (two numbers per player).
        action_scale: under ``local``, an action of 1 is this many times σ_i.
        own_payoff: whether a player sees its own cost J_i at the real strategies.
        neighbour_errors: whether it sees its neighbours' consensus errors, which are two links away; oracles only.
        best_response: whether it sees everybody's best response to the real strategies; oracles only.

    Raises:
        ValueError: for an unknown kind or action mode, a scale that is not positive, or an oracle's slice in an
            interface that is not ``full``.
    """

    kind: InterfaceKind = "physical"
    action_mode: ActionMode = "input"
    action_scale: float = 5.0
    own_payoff: bool = False
    neighbour_errors: bool = False
    best_response: bool = False

    def __post_init__(self) -> None:
        if self.kind not in get_args(InterfaceKind):
            raise ValueError(f"unknown interface {self.kind!r}; choose from {', '.join(get_args(InterfaceKind))}")
        if self.action_mode not in get_args(ActionMode):
            raise ValueError(f"unknown action mode {self.action_mode!r}; choose from {', '.join(get_args(ActionMode))}")
        require_positive("action_scale", self.action_scale)
        for name in ("neighbour_errors", "best_response"):
            if getattr(self, name) and self.kind != "full":
                raise ValueError(f"{name} is for oracles: it needs the interface 'full', got {self.kind!r}")


class Reading(NamedTuple):
    """Observations of R players, read back into float64 and player order. Gradients and estimates are in ``unit``.

    Attributes:
        player: who observes, shape (R,).
        gradient: R_i^T ∂J_i/∂x_i(x^i), zero outside the own block, shape (R, n).
        relative_estimates: x^j − x^i per neighbour slot, shape (R, D, n).
        weights: a_ij per neighbour slot, shape (R, D).
        unit: what 1 of the above is in natural units, shape (R, 1); 1 under ``physical``, σ_i under ``local``.
        theta: Θ_k of the coming step, shape (R, 1).
        dt: Δt_k of the coming step in seconds, shape (R, 1).
        relative_strategies: x − x^i, shape (R, n); empty (R, 0) unless the interface is ``full``.
        pseudo_gradient: F(x), or in a box (x − Π(x − Θ F(x)))/Θ, the way that is open; shape (R, n), and empty (R, 0)
            unless the interface is ``full``.
        own_estimate: x^i in natural units, shape (R, n); empty (R, 0) under ``local``.
        own_payoff: J_i(x) in natural units, shape (R, 1); empty (R, 0) unless the interface has it.
        neighbour_errors: Σ_l a_jl (x^j − x^l) of the neighbour j in each slot, shape (R, D, n); empty (R, 0, n) unless
            the interface has it.
        best_response: y − x with y_i the best response of player i to x, shape (R, n); empty (R, 0) unless the
            interface has it.
    """

    player: IntArray
    gradient: FloatArray
    relative_estimates: FloatArray
    weights: FloatArray
    unit: FloatArray
    theta: FloatArray
    dt: FloatArray
    relative_strategies: FloatArray
    pseudo_gradient: FloatArray
    own_estimate: FloatArray
    own_payoff: FloatArray
    neighbour_errors: FloatArray
    best_response: FloatArray


@dataclass(frozen=True)
class Layout:
    """What a policy knows about its observations and actions, which it was built for.

    An observation is a flat float32 vector of named slices, in the order of :attr:`slices`:

    ======================= ======== =======================================================================
    name                    size     content
    ======================= ======== =======================================================================
    ``own_gradient``        m        ∂J_i/∂x_i(x^i), padded with 0 to the largest n_i
    ``own_estimate``        n        x^i (not under ``local``)
    ``relative_estimates``  D n      x^j − x^i per neighbour slot, taken in float64; 0 where the link is down; x^j is
                                     what the channel delivers
    ``weights``             D        a_ij per neighbour slot; 0 where the link is down, or the message is lost
    ``log_scale``           1        log10 σ_i (only under ``local``)
    ``clock``               4        t/T, s, Θ_k, Δt_k/T, the first three by the player's own clock
    ``time_since_switch``   1        over the signal's mean dwell, clipped to 1; 0 for a fixed graph
    ``player``              N        one-hot
    ``relative_strategies`` n        x − x^i (only under ``full``)
    ``pseudo_gradient``     n        F(x) at the real strategies, as far as a box lets them move (only under ``full``)
    ``own_payoff``          1        J_i(x) at the real strategies, natural units (only with ``own_payoff``)
    ``neighbour_errors``    D n      Σ_l a_jl (x^j − x^l) per neighbour slot (only with ``neighbour_errors``)
    ``best_response``       n        best responses to x, minus x (only with ``best_response``)
    ======================= ======== =======================================================================

    Under ``local``, gradient and relative estimates are divided by σ_i = max(‖own gradient‖_∞, max over live links
    ‖x^j − x^i‖_∞, 1e-30), and components are in ego order: the own block first, then cyclically.

    Attributes:
        interface: units, order and action mode.
        action_dims: n_i of each player.
        neighbours: per player, the player in each of its D slots; a padded slot holds the player itself.
        input_limit: largest |u|.
        deadline: T in seconds.
    """

    interface: Interface
    action_dims: tuple[int, ...]
    neighbours: tuple[tuple[int, ...], ...]
    input_limit: float
    deadline: float

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
        n, slots, kind = self.dimension, self.slots, self.interface.kind
        sizes = {"own_gradient": max(self.action_dims)}
        if kind != "local":
            sizes["own_estimate"] = n
        sizes |= {"relative_estimates": slots * n, "weights": slots}
        if kind == "local":
            sizes["log_scale"] = 1
        sizes |= {"clock": 4, "time_since_switch": 1, "player": self.num_players}
        if kind == "full":
            sizes |= {"relative_strategies": n, "pseudo_gradient": n}
        extras = {"own_payoff": 1, "neighbour_errors": slots * n, "best_response": n}
        sizes |= {name: size for name, size in extras.items() if getattr(self.interface, name)}
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @cached_property
    def size(self) -> int:
        """Length of an observation."""
        return max(part.stop for part in self.slices.values())

    @cached_property
    def action_size(self) -> int:
        """Length of an action: n in mode ``input``, 2 in mode ``gains``."""
        return self.dimension if self.interface.action_mode == "input" else 2

    @cached_property
    def action_bound(self) -> float:
        """Actions live in the box [−bound, bound]: the input limit under ``physical``, else 1.

        The limit is rounded down to a float32, so that no action in the box exceeds it.
        """
        if self.interface.kind == "local" or self.interface.action_mode == "gains":
            return 1.0
        bound = np.float32(self.input_limit)
        return float(bound if float(bound) <= self.input_limit else np.nextafter(bound, np.float32(0)))

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
        """Which component stands at each place in a player's ego order, shape (N, n)."""
        return (self.own_components[:, :1] + np.arange(self.dimension)) % self.dimension

    @cached_property
    def ego_place(self) -> IntArray:
        """At which place of a player's ego order each component stands, shape (N, n); inverse of ``ego_order``."""
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

    def neighbour_estimates(self, observation: npt.NDArray[np.floating]) -> FloatArray:
        """The neighbours' estimates x^j per slot, (..., size) to (..., D, n), float64; a dead link repeats x^i.

        Raises:
            ValueError: under ``local``, where the own estimate is not observed.
        """
        own = np.asarray(self.select(observation, "own_estimate"), dtype=np.float64)
        relative = np.asarray(self.select(observation, "relative_estimates"), dtype=np.float64)
        return relative.reshape(*own.shape[:-1], self.slots, self.dimension) + own[..., None, :]

    def read(self, observation: npt.NDArray[np.floating]) -> Reading:
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
        values = {name: np.asarray(observation[:, part], dtype=np.float64) for name, part in self.slices.items()}
        player = values["player"].argmax(axis=1)
        own = np.zeros((rows, self.dimension + 1))  # one column more, into which padding falls
        np.put_along_axis(own, self.own_components[player], values["own_gradient"], axis=1)
        relative = values["relative_estimates"].reshape(rows, self.slots, self.dimension)
        unit = np.ones((rows, 1))
        if self.interface.kind == "local":
            relative = np.take_along_axis(relative, self.ego_place[player][:, None, :], axis=2)
            unit = 10.0 ** values["log_scale"]
        unseen = np.empty((rows, 0))
        return Reading(
            player=player,
            gradient=own[:, :-1],
            relative_estimates=relative,
            weights=values["weights"],
            unit=unit,
            theta=values["clock"][:, 2:3],
            dt=values["clock"][:, 3:4] * self.deadline,
            relative_strategies=values.get("relative_strategies", unseen),
            pseudo_gradient=values.get("pseudo_gradient", unseen),
            own_estimate=values.get("own_estimate", unseen),
            own_payoff=values.get("own_payoff", unseen),
            neighbour_errors=values.get("neighbour_errors", unseen).reshape(rows, -1, self.dimension),
            best_response=values.get("best_response", unseen),
        )

    def write(self, inputs: FloatArray, reading: Reading) -> Float32Array:
        """The actions that ask for ``inputs`` (R, n), given in the reading's unit and player order; (R, n) float32.

        Actions are clipped to the action box.
        """
        if self.interface.kind == "local":
            inputs = np.take_along_axis(inputs, self.ego_order[reading.player], axis=1) / self.interface.action_scale
        return np.clip(inputs, -self.action_bound, self.action_bound).astype(np.float32)


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
    """What a port made of actions.

    Attributes:
        inputs: u within the input limit, shape (n, N, B).
        clipped: entries of each player's action outside the box, shape (B, N).
    """

    inputs: FloatArray
    clipped: IntArray


@dataclass
class _Workspace:
    """Where a port puts observations of one batch size together.

    Attributes:
        fields: views of each part, environments last, and of everything as (B, N size).
        relative: relative estimates of some neighbour slots at a time: the slots, their part of the fields, and a
            float64 scratch of that shape (slots, n, N, B), which the others use too.
        instant: whose clock stands in the fields, where all environments share one.
    """

    fields: dict[str, Float32Array]
    relative: list[tuple[slice, Float32Array, FloatArray]]
    instant: int | None = None


class Port:
    """Where policies plug into a world: states to observations, actions to inputs, for every batch size.

    Args:
        dynamics: the world.
        interface: units, order and action mode.

    Raises:
        ValueError: when the interface shows best responses and the game has none.
    """

    def __init__(self, dynamics: Dynamics, interface: Interface) -> None:
        self.dynamics = dynamics
        self.interface = interface
        game, clock = dynamics.game, dynamics.clock
        if interface.best_response and not game.has_best_response:
            raise ValueError(f"best_response cannot be observed: {type(game).__name__} has none everywhere")
        self.layout = layout = Layout(
            interface=interface,
            action_dims=game.action_dims,
            neighbours=tuple(tuple(int(j) for j in column) for column in dynamics.neighbours.T),
            input_limit=dynamics.scenario.input_limit,
            deadline=clock.deadline,
        )
        n, players, slots = game.dimension, game.num_players, dynamics.slots
        # What every observation of an instant shares: the clock and the age of the graph; (5, 1 or N, K+H+1).
        t, s, theta = dynamics.readings
        shared = [np.broadcast_to(row, t.shape) for row in (clock.dt / clock.deadline, dynamics.time_since_switch)]
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
        self._ego_neighbour_rows = layout.ego_order.T[None] * players + dynamics.neighbours[:, None, :]
        self._own_rows = np.arange(n), game.owners
        self._slots = (slots, n, players)

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles go without the workspace, whose parts are views of one buffer and would come apart."""
        return {**self.__dict__, "_workspaces": {}, "_scaled": None}

    def twin(self) -> Port:
        """A port for other environments of the same world, with the same tables and workspaces: those stay in cache."""
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

        bound("weights", 0.0, self.dynamics.mode_weights.max() * self.dynamics.channel.largest_weight_factor)
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
                shown[...] = self.dynamics.relative_estimates(state, slots, scratch)
        if not self.dynamics.has_constant_weights:
            fields["weights"][...] = state.weights
        instant = instants.item() if instants.size == 1 else None
        if instant is None or instant != workspace.instant:  # blocks of a vector environment are often in lockstep
            fields["clock"][...] = self._clock_table.take(instants, axis=2)
            workspace.instant = instant
        if self.dynamics.signal.is_random:
            fields["time_since_switch"][...] = state.time_since_switch
        if self.interface.kind == "full":
            strategies = state.strategies
            fields["relative_strategies"][...] = strategies[:, None, :] - state.estimates
            with np.errstate(over="ignore"):
                pseudo_gradient = state.game.pseudo_gradient(strategies)
            if state.game.has_bounds:
                theta = self.dynamics.clock.theta[state.instants]
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
        if self.dynamics.has_constant_weights:
            parts["weights"][...] = self.dynamics.mode_weights
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
            seen = errors[:, self.dynamics.neighbours].swapaxes(0, 1)
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
        if state.heard is None:
            rows.take(self._ego_neighbour_rows, axis=0, out=relative, mode="clip")  # "raise" would copy once more
        else:
            messages = state.heard.messages.reshape(slots, -1, batch)
            messages.take(self._ego_rows, axis=1, out=relative, mode="clip")
        relative -= rows.take(self._ego_rows, axis=0)
        if not self.dynamics.has_constant_weights:
            relative *= (state.weights > 0)[:, None]
        scale = np.maximum.reduce(np.abs(differences), axis=0)
        return differences, np.maximum(scale, SMALLEST_SCALE, out=scale)

    def _scale(self, state: State) -> FloatArray:
        """σ_i = max(‖own gradient‖_∞, max over live links ‖x^j − x^i‖_∞, 1e-30), shape (N, B)."""
        if self._scaled is None or self._scaled[0] is not state:
            self._scaled = (state, self._ego_differences(state)[1])
        return self._scaled[1]
