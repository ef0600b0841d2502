"""What is the next state? One pure transition for every batch size; the only place that advances time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptne_env import channel as channels
from ptne_env import counter_random
from ptne_env.arrays import Array, BoolArray, FloatArray, IntArray, frozen, replaced
from ptne_env.channel import LinkRandomness, Memory, Messages
from ptne_env.counter_random import CounterArray
from ptne_env.games import Game
from ptne_env.random_streams import RandomStreams
from ptne_env.scenario import Scenario
from ptne_env.switching import Schedule

RANGE_LIMIT = 5e5
"""An estimate or own gradient outside ±RANGE_LIMIT, or not finite, has diverged."""


@dataclass(frozen=True)
class EpisodeRandomness:
    """What B episodes have drawn besides game and start. Environments last; a field is ``None`` where nothing is drawn.

    Attributes:
        modes: active graph at each instant, shape (K+H+1, B), int16.
        age: time since the last switch over the mean dwell, clipped to 1, shape (K+H+1, B), float32.
        channel_keys: what the random numbers of the channel follow from, shape (B,).
        disturbance_keys: what those of the disturbance follow from, shape (B,).
    """

    modes: npt.NDArray[np.int16] | None
    age: npt.NDArray[np.float32] | None
    channel_keys: CounterArray
    disturbance_keys: CounterArray

    def merged(self, fresh: EpisodeRandomness, mask: BoolArray) -> EpisodeRandomness:
        """These episodes with those in ``mask`` (B,) replaced by those of ``fresh``, in order."""

        def both(old: Array | None, new: Array | None) -> Array | None:
            return old if old is None or new is None else replaced(old, new, mask)

        return EpisodeRandomness(
            both(self.modes, fresh.modes),
            both(self.age, fresh.age),
            replaced(self.channel_keys, fresh.channel_keys, mask),
            replaced(self.disturbance_keys, fresh.disturbance_keys, mask),
        )


class Received(NamedTuple):
    """What came through a channel that is not perfect.

    Attributes:
        messages: x^j as heard in each neighbour slot, shape (D, n, N, B).
        weights: a_ij that the receiver gives it, shape (D, N, B); 0 where it hears nothing.
        memory: of the channel.
    """

    messages: FloatArray
    weights: FloatArray
    memory: Memory


class State:
    """The state of B environments, and what follows from it before anybody acts. Environments last; never changed.

    Attributes:
        step: index of the coming step, 0..K+H, shape (B,), int64.
        game: the games being played, one for all or one per environment.
        estimates: x^i in column i, shape (n, N, B); the diagonal blocks are the strategies.
        own_gradients: ∂J_i/∂x_i(x^i), blocks stacked, shape (n, B).
        diverged: whether the environment has left the range; it stays where it is from then on. Shape (B,).
        any_diverged: whether any of them has.
        randomness: what the episodes have drawn besides game and start; ``None`` where a scenario draws nothing else.
        received: what came through the channel; ``None`` where it is perfect.
    """

    __slots__ = (
        "_instants",
        "_relative",
        "_weights",
        "_world",
        "any_diverged",
        "diverged",
        "estimates",
        "game",
        "own_gradients",
        "randomness",
        "received",
        "step",
    )

    def __init__(
        self,
        world: World,
        step: IntArray,
        game: Game,
        estimates: FloatArray,
        own_gradients: FloatArray,
        diverged: BoolArray,
        randomness: EpisodeRandomness | None = None,
        received: Received | None = None,
    ) -> None:
        self._world = world
        self._instants: IntArray | None = None
        self._relative: FloatArray | None = None
        self._weights: FloatArray | None = None
        self.step = step
        self.game = game
        self.estimates = estimates
        self.own_gradients = own_gradients
        self.diverged = diverged
        self.any_diverged = np.count_nonzero(diverged) > 0
        self.randomness = randomness
        self.received = received

    @property
    def batch_size(self) -> int:
        """B."""
        return self.estimates.shape[2]

    @property
    def instants(self) -> IntArray:
        """``step``, but one entry for environments in lockstep, the usual case: shape (1,) or (B,)."""
        if self._instants is None:
            step = self.step
            in_lockstep = step.size == 1 or np.count_nonzero(step != step[0]) == 0
            self._instants = step[:1] if in_lockstep else step
        return self._instants

    @property
    def mode(self) -> IntArray:
        """Index of the active graph, shape (B,), int64."""
        if self.randomness is None or self.randomness.modes is None:
            return self._world.modes[self.step]
        return self.randomness.modes[self.step, np.arange(self.step.size)].astype(np.int64)

    @property
    def time_since_switch(self) -> FloatArray:
        """Over the topology's mean dwell, clipped to 1, 0 for a fixed graph; shape (B,)."""
        if self.randomness is None or self.randomness.age is None:
            return self._world.time_since_switch[self.step]
        return self.randomness.age[self.step, np.arange(self.step.size)].astype(np.float64)

    @property
    def weights(self) -> FloatArray:
        """a_ij per neighbour slot as the receiver has it, (D, N, B), or (D, N, 1) where all environments agree."""
        if self._weights is None:
            self._weights = self._world.graph_weights(self) if self.received is None else self.received.weights
        return self._weights

    @property
    def messages(self) -> FloatArray:
        """The x^j heard in each neighbour slot, shape (D, n, N, B); of no meaning where the weight is 0."""
        return self._world.sent_messages(self.estimates) if self.received is None else self.received.messages

    @property
    def relative_estimates(self) -> FloatArray:
        """(x^j as received) − x^i per neighbour slot in float64, 0 where the link is down, shape (D, n, N, B)."""
        if self._relative is None:
            self._relative = self._world.relative_estimates(self)
        return self._relative

    @property
    def strategies(self) -> FloatArray:
        """The real strategies x, shape (n, B)."""
        return _rows(self.estimates).take(self._world.strategy_rows, axis=0)


class World:
    """The transition x_{k+1} = x_k + Θ_k u_k with the switching graph and the clock, exact for the held input.

    Where a box confines the strategies, the players' own blocks of x_k + Θ_k u_k, and of x_0, are projected into it.

    Attributes:
        scenario: what it simulates.
        game: the game, or a typical member of the family; states hold the games that are played.
        topology, clock, channel, disturbance: the other parts, built.
        neighbours: player in each slot, shape (D, N); D is the largest degree in the union graph unless the scenario
            says otherwise, and a padded slot points at the player itself with weight 0.
        mode_weights: a_ij per slot and mode, shape (D, N, modes).
        modes: active mode at each instant, shape (K+H+1,); zeros where the topology is random and states have their own.
        time_since_switch: over the mean dwell, clipped to 1, 0 for a fixed graph; shape (K+H+1,); zeros likewise.
        theta: Θ_k of each step, shape (K+H+1,), or (N, K+H+1) where the players' clocks disagree.
        readings: t, s and Θ of each step by the players' clocks, shape (3, 1, K+H+1), or (3, N, K+H+1) where they
            disagree.
        has_constant_weights: whether weights are those of one graph, in every step and for everybody.
        strategy_rows: rows of estimates.reshape(n N, B) that are strategies, shape (n,).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.game = scenario.built_game
        self.topology = scenario.built_topology
        self.clock = scenario.built_clock
        self.channel = scenario.built_channel
        self.disturbance = scenario.built_disturbance
        self.has_constant_weights = self.topology.is_fixed and self.channel.is_perfect
        n, players = self.game.dimension, self.game.num_players

        union = self.topology.union.adjacency
        slots = scenario.slots or self.topology.union.largest_degree
        self.neighbours = np.tile(np.arange(players), (slots, 1))
        for player, row in enumerate(union):
            others = np.flatnonzero(row)
            self.neighbours[: others.size, player] = others
        everybody = np.arange(players)
        self.mode_weights = frozen(
            np.stack([graph.adjacency[everybody, self.neighbours] for graph in self.topology.graphs], axis=-1)
        )
        self._topology_times = self.clock.topology_times[self.topology.clock]
        if self.topology.is_random:
            schedule = Schedule(
                np.zeros(self._topology_times.size, dtype=np.int64), np.zeros(self._topology_times.size)
            )
        else:
            schedule = self.topology.schedule(self._topology_times)
        self.modes, self.time_since_switch = schedule.modes, schedule.time_since_switch
        shifts = scenario.clock_shifts if any(scenario.clock_shifts) else (0.0,)
        self.readings = frozen(np.stack([self.clock.shifted(shift) for shift in shifts], axis=1))
        self.theta = self.clock.theta if len(shifts) == 1 else self.readings[2]
        # Looking up an instant's successor costs one environment a quarter of computing it.
        instants, last = np.arange(self.clock.total_steps + 1), self.clock.total_steps
        self._next_step, self._finished = np.minimum(instants + 1, last), instants >= last

        components = np.arange(n)
        self._neighbour_rows = components[None, :, None] * players + self.neighbours[:, None, :]
        self.strategy_rows = components * players + self.game.owners

    @property
    def slots(self) -> int:
        """D, neighbour slots per player."""
        return self.neighbours.shape[0]

    def draw_game(self, sources: Sequence[RandomStreams]) -> Game:
        """The games of an episode, one environment per entry of ``sources``."""
        return self.scenario.built_family.draw([source.game for source in sources])

    def draw_randomness(self, sources: Sequence[RandomStreams]) -> EpisodeRandomness | None:
        """What else an episode draws, one environment per entry of ``sources``; ``None`` where there is nothing."""
        modes = age = None
        if self.topology.is_random:
            schedule = self.topology.draw(self._topology_times, [source.graph for source in sources])
            modes, age = schedule.modes.astype(np.int16), schedule.time_since_switch.astype(np.float32)
        elif not (self.channel.is_random or self.disturbance.is_random):
            return None
        keys = np.array(
            [[counter_random.draw_key(source.channel) for source in sources] for _ in range(2)], dtype=np.uint64
        )
        return EpisodeRandomness(modes, age, *keys)

    def draw_estimates(self, sources: Sequence[RandomStreams]) -> FloatArray:
        """Initial estimates, one environment per entry of ``sources``: shape (n, N, B)."""
        start = self.scenario.built_start
        players, dimension = self.game.num_players, self.game.dimension
        return np.stack([start.draw(players, dimension, source.start) for source in sources], axis=-1)

    def start(
        self, estimates: FloatArray, game: Game | None = None, randomness: EpisodeRandomness | None = None
    ) -> State:
        """The state at t = 0.

        Args:
            estimates: initial, shape (n, N, B); strategies outside the game's box are projected into it.
            game: what is played, one game or B; needed where the scenario draws games.
            randomness: what else is drawn, for B environments; needed where :meth:`draw_randomness` draws anything.

        Raises:
            ValueError: when a shape is wrong, an estimate is not finite or outside the range, or something that the
                scenario draws is missing.
        """
        expected = (self.game.dimension, self.game.num_players)
        if estimates.ndim != 3 or estimates.shape[:2] != expected:
            raise ValueError(f"initial estimates have the shape {(*expected, 'B')}, got {estimates.shape}")
        if not np.all(np.abs(estimates) <= RANGE_LIMIT):
            raise ValueError(f"initial estimates must be finite and within ±{RANGE_LIMIT:g}")
        batch = estimates.shape[2]
        if game is None:
            if self.scenario.has_random_game:
                raise ValueError(f"scenario {self.scenario.name!r} draws games: pass the ones to play, see draw_game()")
            game = self.game
        if game.batch_size not in (1, batch) or game.action_dims != self.game.action_dims:
            raise ValueError(f"{batch} environments need one game or {batch}, got {game.batch_size}")
        draws = self.topology.is_random or self.channel.is_random or self.disturbance.is_random
        if draws and (randomness is None or randomness.channel_keys.shape != (batch,)):
            raise ValueError(
                f"scenario {self.scenario.name!r} draws a topology, a channel or a disturbance: pass what {batch} "
                "environments have drawn, see draw_randomness()"
            )
        estimates = np.array(estimates, dtype=np.float64)  # a copy: the state is not the caller's
        self._confine(estimates, game)
        step, diverged = np.zeros(batch, dtype=np.int64), np.zeros(batch, dtype=np.bool_)
        return self._complete(estimates, game, step, diverged, randomness)

    def step(self, state: State, inputs: FloatArray) -> State:
        """The next state, from held inputs u of shape (n, N, B), finite. ``state`` is left as it was."""
        theta = self.theta[..., state.instants]
        if state.any_diverged:
            theta = np.where(state.diverged, 0.0, theta)
        estimates = theta * inputs
        estimates += state.estimates
        if not self.disturbance.is_absent:
            self._disturb(estimates, state)
        self._confine(estimates, state.game)
        memory = None if state.received is None else state.received.memory
        step = self._next_step[state.step]
        return self._complete(estimates, state.game, step, state.diverged, state.randomness, memory)

    def merge(self, state: State, fresh: State, mask: BoolArray) -> State:
        """``state`` with the environments in ``mask`` (B,) replaced by those of ``fresh``, in order."""
        received = None
        if state.received is not None and fresh.received is not None:
            received = Received(*channels.merged(state.received, fresh.received, mask))
        return State(
            self,
            replaced(state.step, fresh.step, mask),
            state.game.merged(fresh.game, mask),
            replaced(state.estimates, fresh.estimates, mask),
            replaced(state.own_gradients, fresh.own_gradients, mask),
            replaced(state.diverged, fresh.diverged, mask),
            state.randomness.merged(fresh.randomness, mask) if state.randomness and fresh.randomness else None,
            received,
        )

    def graph_weights(self, state: State) -> FloatArray:
        """a_ij of the active graph per neighbour slot, (D, N, B), or (D, N, 1) where all environments agree."""
        if self.mode_weights.shape[2] == 1:
            return self.mode_weights
        modes = state.mode if self.topology.is_random else self.modes[state.instants]
        return self.mode_weights.take(modes, axis=2)

    def sent_messages(self, estimates: FloatArray) -> FloatArray:
        """The x^j of the neighbour in each slot, shape (D, n, N, B)."""
        return _rows(estimates).take(self._neighbour_rows, axis=0)

    def relative_estimates(self, state: State, slots: slice = slice(None), out: FloatArray | None = None) -> FloatArray:
        """(x^j as received) − x^i per neighbour slot in float64, 0 where the link is down, shape (D, n, N, B).

        Args:
            state: whose estimates.
            slots: those of the D neighbour slots that are wanted; all if left out.
            out: where to write, C-contiguous; a new array if left out.
        """
        if state.received is None:
            rows = self._neighbour_rows[slots]
            relative = _rows(state.estimates).take(rows, axis=0, out=out, mode="clip")  # "raise" would copy once more
            relative -= state.estimates
        else:
            relative = np.subtract(state.received.messages[slots], state.estimates, out=out)
        if not self.has_constant_weights:
            relative *= (state.weights[slots] > 0)[:, None]
        return relative

    def is_over(self, state: State) -> BoolArray:
        """Whether each environment has reached its end or diverged, shape (B,)."""
        finished = self._finished[state.step]
        return finished | state.diverged if state.any_diverged else finished

    @staticmethod
    def distance_limit(game: Game) -> FloatArray:
        """The relative distance charged to a diverged environment, no less than any in range; shape (G,)."""
        return (RANGE_LIMIT * np.sqrt(game.dimension) + game.equilibrium_scale) / game.equilibrium_scale

    def _confine(self, estimates: FloatArray, game: Game) -> None:
        """Project the real strategies into the game's box, in place; what players think of others stays."""
        if game.has_bounds:
            own = np.arange(game.dimension), game.owners
            estimates[own] = game.project(estimates[own])

    def _complete(
        self,
        estimates: FloatArray,
        game: Game,
        step: IntArray,
        diverged: BoolArray,
        randomness: EpisodeRandomness | None = None,
        memory: Memory | None = None,
    ) -> State:
        if game.is_affine:
            gradients = game.own_gradients(estimates)
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # a diverging game may overflow; it is caught below
                gradients = game.own_gradients(estimates)
        if not (_in_range(estimates) and _in_range(gradients)):
            farthest = np.maximum(np.abs(estimates).max(axis=(0, 1)), np.abs(gradients).max(axis=0))
            diverged = diverged | ~(farthest <= RANGE_LIMIT)
            estimates = np.clip(np.nan_to_num(estimates, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)
            gradients = np.clip(np.nan_to_num(gradients, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)
        state = State(self, step, game, estimates, gradients, diverged, randomness)
        if not self.channel.is_perfect:
            state.received = self._transmit(state, memory)
        return state

    def _transmit(self, state: State, memory: Memory | None) -> Received:
        """What is heard in ``state``, whose channel remembers ``memory`` of the step before."""
        batch = state.batch_size
        keys = np.zeros(batch, dtype=np.uint64) if state.randomness is None else state.randomness.channel_keys
        weights = self.graph_weights(state)
        weights = np.broadcast_to(weights, (*weights.shape[:2], batch))
        randomness = LinkRandomness(keys, state.step, self.neighbours, self.game.dimension)
        sent = Messages(self.sent_messages(state.estimates), weights > 0, weights, state.estimates)
        received, memory = self.channel.transmit(sent, memory, randomness)
        values = received.values
        if not _in_range(values):  # noise may leave the range that observations are bounded by
            values = np.clip(values, -RANGE_LIMIT, RANGE_LIMIT)
        # Nobody hears anything on a link that is down, whatever has been on the way when it went down.
        return Received(values, received.weights * (received.live & sent.live), memory)

    def _disturb(self, estimates: FloatArray, state: State) -> None:
        """Add Δt w to the real strategies, in place."""
        early = state.instants < self.clock.steps
        if self.disturbance.after_deadline_only and early.all():
            return
        dt = self.clock.dt[state.instants]
        dt = np.where(state.diverged | (early & self.disturbance.after_deadline_only), 0.0, dt)
        keys = (
            np.zeros(state.batch_size, dtype=np.uint64)
            if state.randomness is None
            else state.randomness.disturbance_keys
        )
        _rows(estimates)[self.strategy_rows] += dt * self.disturbance.velocity(keys, state.step, self.game.dimension)


def _rows(estimates: FloatArray) -> FloatArray:
    return estimates.reshape(-1, estimates.shape[2])


def _in_range(array: FloatArray) -> bool:
    """Whether every entry is a number within ±RANGE_LIMIT."""
    flat = array.reshape(-1)
    # Σ x² ≤ limit² is enough, costs one pass and is False for NaN. (einsum and not dot: BLAS would wake its threads.)
    if np.einsum("i,i->", flat, flat) <= RANGE_LIMIT**2:
        return True
    return bool(np.maximum.reduce(flat) <= RANGE_LIMIT and np.minimum.reduce(flat) >= -RANGE_LIMIT)
