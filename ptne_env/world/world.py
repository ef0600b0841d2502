"""The world: the parts of a scenario, built and checked once, and the tables that every step reads."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import shortest_path

from ptne_env.games import Game, GameFamily, require_strong_monotonicity
from ptne_env.shared.arrays import FloatArray, IntArray, freeze, require_count, require_positive
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import FactorySpec
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world.channels import Chain, Channel, Range, require_messages
from ptne_env.world.clock import StepClock, TimeTransformation
from ptne_env.world.disturbances import Disturbance
from ptne_env.world.graphs import Graph
from ptne_env.world.scenario import Scenario
from ptne_env.world.starts import Start
from ptne_env.world.switching import SwitchingTopology, fixed

RANGE_LIMIT = 5e5
"""An estimate or own gradient that is outside ±RANGE_LIMIT, or not finite, has diverged."""

SHORTFALL_WARNING = 0.01
"""The fraction of T by which the last step of a scenario may end short of the deadline without a warning."""


class EpisodeRandomness(NamedTuple):
    """What B episodes draw besides their games and starts; a field is ``None`` where nothing is drawn.

    Attributes:
        modes: as in a :class:`~ptne_env.world.switching.Schedule`, shape (K+H+1, B), int16.
        time_since_switch: likewise, float32.
        channel_keys: the keys of the channel's random numbers, shape (B,).
        disturbance_keys: the keys of the disturbance's random numbers, shape (B,).
    """

    modes: npt.NDArray[np.int16] | None
    time_since_switch: npt.NDArray[np.float32] | None
    channel_keys: CounterArray
    disturbance_keys: CounterArray


class ComponentOrder(NamedTuple):
    """Rows of ``estimates.reshape(n N, B)`` that list the components of each player in some order.

    Attributes:
        own: the rows of the players' own estimates, shape (n, N).
        senders: the rows of the estimates of the neighbour in each slot, shape (D, n, N).
    """

    own: IntArray
    senders: IntArray


class World:
    """A scenario, built and checked. It is read-only, so that any number of environments share it.

    Attributes:
        scenario: names the parts.
        game_family: draws the game of an episode; a game itself where all episodes play one.
        game: the game, or a typical member of the family; states hold the games that are played.
        topology, start, clock, channel: the other parts.
        disturbance: of the velocities; ``None`` where there is none.
        message_range: R, to which the channel clips messages first; infinite where links have no range.
        neighbours: player that is heard in each slot, shape (D, N); D is the largest degree in the union graph unless
            the scenario gives it, and a padded slot holds the player itself with weight 0.
        mode_weights: a_ij per slot and mode, shape (D, N, modes).
        modes, time_since_switch: the :class:`~ptne_env.world.switching.Schedule`, shape (K+H+1,); zeros where every
            episode draws its own.
        has_constant_weights: whether every player has the weights of one graph in every step.
        component_order: components in the order of the game.

    Raises:
        ValueError: when a part cannot be built, a number is out of range, the game and the graphs disagree on the
            number of players, the graphs can never be (jointly) connected, a dwell is shorter than the longest step, or
            there are too few slots.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.input_limit = require_positive("input_limit", scenario.input_limit)
        deadline = require_positive("deadline", scenario.deadline, " (T, in seconds)")
        self.clock = StepClock(
            self._build(scenario.transformation, TimeTransformation, deadline=deadline),
            gain=scenario.gain,
            steps=scenario.steps,
            s_end=scenario.s_end,
            spacing=scenario.spacing,
            hold_steps=scenario.hold_steps,
        )
        self.game_family: Game | GameFamily = self._build(scenario.game, Game, GameFamily)
        self.game = self.game_family.representative
        links: Graph | SwitchingTopology = self._build(scenario.topology, SwitchingTopology, Graph)
        self.topology = fixed(links) if isinstance(links, Graph) else links
        self.start: Start = self._build(scenario.start, Start)
        self.channel: Channel = self._build(scenario.channel, Channel)
        self.message_range = np.inf
        if scenario.message_range is not None:
            self.message_range = require_positive("message_range", scenario.message_range)
            self.channel = Chain([Range(self.message_range), self.channel])
        disturbance = scenario.disturbance
        self.disturbance: Disturbance | None = None if disturbance is None else self._build(disturbance, Disturbance)
        self._check_topology()
        # A fixed start whose table has the wrong shape fails here and not at the first reset.
        self.start.draw(self.game.num_players, self.game.dimension, np.random.default_rng(0))
        self._tabulate_neighbours()
        require_messages(self.channel, self.neighbours, self.game.owners)
        self._tabulate_time()
        for doubt in self._doubts():
            warnings.warn(f"scenario {scenario.name!r}: {doubt}", stacklevel=2)

    @property
    def slots(self) -> int:
        """D, neighbour slots per player."""
        return self.neighbours.shape[0]

    @property
    def has_random_game(self) -> bool:
        """Whether episodes play different games."""
        return isinstance(self.game_family, GameFamily)

    @property
    def has_episode_randomness(self) -> bool:
        """Whether an episode draws anything besides its game and its start."""
        parts = (self.topology, self.channel, self.disturbance)
        return any(part.is_random for part in parts if part is not None)

    @property
    def is_random(self) -> bool:
        """Whether two episodes of the same policy differ by chance."""
        return self.has_random_game or self.start.is_random or self.has_episode_randomness

    def draw_game(self, streams: Sequence[RandomStreams]) -> Game:
        """Draw the games of an episode, one environment per entry of ``streams``.

        Raises:
            ValueError: when a drawn game is not strongly monotone, unless the family declares this.
        """
        family = self.game_family
        game = family.draw([stream.game for stream in streams])
        if isinstance(family, GameFamily) and family.is_strongly_monotone is None:
            require_strong_monotonicity(game)
        return game

    def draw_estimates(self, streams: Sequence[RandomStreams]) -> FloatArray:
        """Draw initial estimates, one environment per entry of ``streams``: shape (n, N, B)."""
        players, dimension = self.game.num_players, self.game.dimension
        return np.stack([self.start.draw(players, dimension, stream.start) for stream in streams], axis=-1)

    def draw_randomness(self, streams: Sequence[RandomStreams]) -> EpisodeRandomness | None:
        """Draw what an episode draws besides, one environment per entry of ``streams``; ``None`` for nothing."""
        if not self.has_episode_randomness:
            return None
        modes = age = None
        if self.topology.is_random:
            schedule = self.topology.draw(self._topology_times, [stream.graph for stream in streams])
            shape, graphs = (len(self._topology_times), len(streams)), len(self.topology.graphs)
            wrong = schedule.modes.min(initial=0) < 0 or schedule.modes.max(initial=0) >= graphs
            if wrong or not schedule.modes.shape == schedule.time_since_switch.shape == shape:
                raise ValueError(
                    f"{type(self.topology).__name__}.draw must return modes from 0 to {graphs - 1} and times since the "
                    f"switch, of shape {shape} (instants, environments), got the modes {schedule.modes!r}"
                )
            modes, age = schedule.modes.astype(np.int16), schedule.time_since_switch.astype(np.float32)
        keys = [[stream.channel.integers(0, 2**64, dtype=np.uint64) for stream in streams] for _ in range(2)]
        return EpisodeRandomness(modes, age, *np.array(keys, dtype=np.uint64))

    def order_components(self, order: IntArray) -> ComponentOrder:
        """Return the rows of estimates in another order: the component at each place of each player's, (N, n)."""
        first_rows = order.T * self.game.num_players
        return ComponentOrder(
            first_rows + np.arange(self.game.num_players), first_rows[None] + self.neighbours[:, None, :]
        )

    def _build(self, spec: FactorySpec, *kinds: type[Any], **extra: Any) -> Any:
        try:
            part = spec.build(**extra)
        except ValueError as error:
            if kinds == (TimeTransformation,) and isinstance(error.__cause__, TypeError):
                advice = "subclass TimeTransformation with time, derivative and inverse (docs/adding-parts.md)"
                raise ValueError(f"{error}; {advice}") from error
            raise
        if not isinstance(part, kinds):
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise ValueError(
                f"scenario {self.scenario.name!r}: {spec.target!r} built a {type(part).__name__} where a {wanted} is "
                "needed"
            )
        return part

    def _check_topology(self) -> None:
        name, topology = self.scenario.name, self.topology
        if topology.num_players != self.game.num_players:
            raise ValueError(
                f"scenario {name!r}: the game has {self.game.num_players} players, the graphs {topology.num_players}; "
                f"pass a topology= of {self.game.num_players} players, or a game= of {topology.num_players}"
            )
        if not topology.is_jointly_connected:
            graph = min((topology.union, *topology.graphs), key=lambda graph: graph.is_connected)
            connected = "strongly connected" if graph.is_directed else "connected"
            kind = f"graph is not {connected}" if topology.is_fixed else f"graphs are not jointly {connected} over time"
            listener, speaker = np.argwhere(np.isinf(shortest_path(graph.adjacency, unweighted=True)))[0]
            raise ValueError(
                f"scenario {name!r}: the {kind} (Assumptions 1 and 2), so no law can reach the equilibrium: nothing "
                f"that player {speaker} says reaches player {listener}; add links to {graph!r}"
            )
        if topology.is_fixed:
            return
        longest = float(np.diff(self.clock.topology_times[topology.clock]).max())
        if topology.shortest_dwell < longest * (1 - 1e-9):
            raise ValueError(
                f"scenario {name!r}: the shortest dwell, {topology.shortest_dwell:.4g} on the {topology.clock} clock, "
                f"is shorter than the longest step, {longest:.4g}, so graphs would be skipped; use more steps, another "
                "spacing or longer dwells"
            )

    def _doubts(self) -> Iterator[str]:
        """Yield why results may mean little: the last step ends early, or the paper's theorems do not hold."""
        if self.clock.shortfall > SHORTFALL_WARNING:
            short = f"{self.clock.shortfall:.2%}"
            yield f"the last step ends {short} of T short of the deadline; raise s_end to come closer"
        slope, deadline = float(self.clock.transformation.derivative(0.0)), self.clock.deadline
        if abs(slope - deadline) > 1e-9 * deadline:
            start = (
                "so the gain starts at c + 1/λ'(0); the loop in τ = s + c t, and what is proven of it, stay the same"
            )
            yield f"λ'(0) = {slope:.4g} is not T = {deadline:g}, as Lemma 1 of the paper asks, {start}"
        if self.game.is_affine and not self.has_random_game:  # families declare it, and samples decide elsewhere
            jacobian = self.game.jacobian(np.zeros((self.game.dimension, 1)))[..., 0]
            smallest = float(np.linalg.eigvalsh((jacobian + jacobian.T) / 2)[0])
            if smallest < -1e-9 * np.abs(jacobian).max():
                needed = "which the paper's theorems need: a law may fail; 'ptne certify' checks all they assume"
                yield f"F is not monotone (ε = {smallest:.3g}), {needed}"

    def _tabulate_neighbours(self) -> None:
        players, union = self.game.num_players, self.topology.union
        degree = union.largest_degree
        slots = degree if self.scenario.slots is None else require_count("slots", self.scenario.slots, 1)
        if slots < degree:
            raise ValueError(
                f"scenario {self.scenario.name!r}: a player has {degree} neighbours and slots is {slots}; raise it to "
                f"{degree} at least"
            )
        self.neighbours = np.tile(np.arange(players), (slots, 1))
        for player, row in enumerate(union.adjacency):
            others = np.flatnonzero(row)
            self.neighbours[: others.size, player] = others
        self.mode_weights = freeze(
            np.stack([graph.adjacency[np.arange(players), self.neighbours] for graph in self.topology.graphs], axis=-1)
        )
        self.has_constant_weights = self.topology.is_fixed and self.channel.is_perfect
        self.component_order = self.order_components(np.tile(np.arange(self.game.dimension), (players, 1)))

    def _tabulate_time(self) -> None:
        times = self._topology_times = self.clock.topology_times[self.topology.clock]
        if self.topology.is_random:
            self.modes, self.time_since_switch = np.zeros(times.size, dtype=np.int64), np.zeros(times.size)
        else:
            self.modes, self.time_since_switch = self.topology.schedule(times)
        # Looking up an instant's successor costs one environment a quarter of computing it.
        instants, last = np.arange(self.clock.total_steps + 1), self.clock.total_steps
        self.next_step, self.is_last_step = np.minimum(instants + 1, last), instants >= last
