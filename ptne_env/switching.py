"""Switching topologies: which graph acts when, fixed, periodic or random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import networkx as nx
import numpy as np
import numpy.typing as npt

from ptne_env.arrays import FloatArray, IntArray, frozen, require_count, require_positive
from ptne_env.graphs import Graph, from_edges, union

TopologyClock: TypeAlias = Literal["physical", "transformed"]
JointConnectivity: TypeAlias = Literal["always", "almost surely", "never"]
"""Whether the graphs are jointly connected: within every window of a fixed length (``always``, Assumption 2 of the
paper); with probability 1 from every instant on, but within no window that could be named (``almost surely``, which
Assumption 2 does not cover); or ``never``."""

Dwells: TypeAlias = "float | tuple[float, float]"
"""A dwell time, or the range (shortest, longest) of which every dwell is drawn uniformly."""

_BOUNDARY_TOLERANCE = 1e-9
"""Fraction of a dwell within which an instant before a switch counts as the switch, against rounding of k·Δt."""


@dataclass(frozen=True)
class Schedule:
    """A topology sampled on the steps of an episode.

    Attributes:
        modes: index of the active graph at each instant, shape (instants,), or (instants, B) where episodes differ.
        age: time since the last switch over the mean dwell, clipped to [0, 1], 0 for a fixed graph; of the same shape.
    """

    modes: IntArray
    age: FloatArray


class SwitchingTopology:
    """A switching topology σ: a periodic sequence of graphs with a dwell time each; one graph is the fixed case.

    A topology dwells in the unit of its clock. On the ``physical`` clock (t, the paper's) only finitely many switches
    happen before the deadline; on the ``transformed`` clock (s) infinitely many do (docs/errata.md, 2).

    Args:
        graphs: the modes, in order, all on the same players.
        dwells: dwell time of each mode, in seconds of t or in units of s; ``None`` for one fixed graph.
        clock: ``"physical"`` or ``"transformed"``.

    Raises:
        ValueError: when numbers of graphs, dwells or players disagree, a dwell is not positive, or the clock is
            unknown.
    """

    def __init__(
        self, graphs: Sequence[Graph], dwells: Sequence[float] | None = None, clock: TopologyClock = "physical"
    ) -> None:
        if clock not in ("physical", "transformed"):
            raise ValueError(f"a topology's clock is 'physical' or 'transformed', got {clock!r}")
        if not graphs or len({graph.num_players for graph in graphs}) != 1:
            raise ValueError("a topology needs at least one graph, all with the same number of players")
        if dwells is None and len(graphs) > 1:
            raise ValueError("a topology with several graphs needs their dwell times")
        if dwells is not None and len(dwells) != len(graphs):
            raise ValueError(f"a topology needs one dwell time per graph, got {len(dwells)} for {len(graphs)} graphs")
        self.graphs = tuple(graphs)
        self.clock: TopologyClock = clock
        self.dwells = (
            tuple(require_positive("a dwell time", dwell) for dwell in dwells or ()) if len(graphs) > 1 else ()
        )

    @property
    def is_fixed(self) -> bool:
        """Whether the graph never changes."""
        return len(self.graphs) == 1

    @property
    def num_players(self) -> int:
        """N."""
        return self.graphs[0].num_players

    @cached_property
    def union(self) -> Graph:
        """The union of all modes."""
        return union(self.graphs)

    @property
    def is_random(self) -> bool:
        """Whether episodes draw their own schedules; then :meth:`draw` makes them, and :meth:`schedule` refuses."""
        return False

    @property
    def joint_connectivity(self) -> JointConnectivity:
        """Whether, and how surely, the graphs are jointly connected; a periodic topology's over one period."""
        return "always" if self.union.is_connected else "never"

    @property
    def is_jointly_connected(self) -> bool:
        """Assumption 2 of the paper (Assumption 1 when fixed): the union over windows of some length is connected.

        For a random topology also when that is only almost sure, see :attr:`joint_connectivity`.
        """
        return self.joint_connectivity != "never"

    @property
    def shortest_dwell(self) -> float:
        """The shortest time between switches, in the unit of the clock; infinite when fixed."""
        return min(self.dwells, default=float("inf"))

    @property
    def period(self) -> float:
        """Sum of the dwell times, in the unit of the clock; infinite when fixed."""
        return float(sum(self.dwells)) if self.dwells else float("inf")

    @property
    def mean_dwell(self) -> float:
        """Mean dwell time, in the unit of the clock; infinite when fixed."""
        return self.period / len(self.graphs)

    def schedule(self, instants: npt.ArrayLike) -> Schedule:
        """Sample the topology at ``instants`` (any shape) of its clock.

        Raises:
            ValueError: when an instant is negative.
        """
        times = np.asarray(instants, dtype=np.float64)
        if times.size and times.min() < 0:
            raise ValueError(f"a topology starts at 0, got the instant {times.min()}")
        if self.is_fixed:
            return Schedule(np.zeros(times.shape, dtype=np.int64), np.zeros(times.shape))
        ends = np.cumsum(self.dwells)
        phase = np.mod(times, self.period)
        slack = _BOUNDARY_TOLERANCE * min(self.dwells)
        wraps = phase >= self.period - slack
        phase = np.where(wraps, 0.0, phase)
        modes = np.searchsorted(ends, phase + slack, side="right").astype(np.int64)
        starts = np.concatenate([[0.0], ends[:-1]])
        age = np.clip((phase - starts[modes]) / self.mean_dwell, 0.0, 1.0)
        return Schedule(modes, age)

    def draw(self, instants: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Schedule:
        """Schedules of episodes, sampled at increasing ``instants`` (K,) of the clock: modes and ages of shape (K, B).

        Args:
            instants: of the clock, from 0 on.
            generators: one per episode; a topology that is not random draws nothing.

        Raises:
            ValueError: as :meth:`schedule`.
        """
        one, episodes = self.schedule(instants), len(generators)
        modes, age = np.repeat(one.modes[:, None], episodes, axis=1), np.repeat(one.age[:, None], episodes, axis=1)
        return Schedule(modes, age)

    def switches(self, start: float, end: float) -> FloatArray:
        """The switching instants in the open interval (start, end), in the unit of the clock."""
        if self.is_fixed:
            return np.empty(0)
        periods = np.arange(np.floor(start / self.period), np.floor(end / self.period) + 1)
        instants = (periods[:, None] * self.period + np.cumsum(self.dwells)).ravel()
        slack = _BOUNDARY_TOLERANCE * min(self.dwells)
        return instants[(instants > start + slack) & (instants < end - slack)]


class MarkovTopology(SwitchingTopology):
    """A topology that every episode draws: modes follow a Markov chain, and every dwell is drawn uniformly from a range.

    In mode m the topology dwells for U(shortest, longest) and then goes on to mode m' with probability
    ``transition[m][m']``; m' may be m again, which counts as a switch.

    Args:
        graphs: the modes, at least two, all on the same players.
        transition: row-stochastic matrix of shape (modes, modes), irreducible: every mode is reached from every other.
        dwells: a dwell time or a range (shortest, longest), for all modes.
        clock: ``"physical"`` or ``"transformed"``.
        first: the mode at the start; drawn uniformly if left out.

    Attributes:
        shortest, longest: range of the dwells, in the unit of the clock.
        transition: as given, read-only.

    Raises:
        ValueError: when these do not hold, or as :class:`SwitchingTopology`.
    """

    def __init__(
        self,
        graphs: Sequence[Graph],
        transition: npt.ArrayLike,
        dwells: Dwells,
        clock: TopologyClock = "physical",
        first: int | None = None,
    ) -> None:
        bounds = dwells if isinstance(dwells, Sequence) else (dwells, dwells)
        if len(bounds) != 2:
            raise ValueError(f"dwells are a time or a range (shortest, longest), got {dwells!r}")
        self.shortest, self.longest = (require_positive("a dwell time", bound) for bound in bounds)
        if self.shortest > self.longest:
            raise ValueError(f"the shortest dwell comes first, got the range {tuple(bounds)!r}")
        super().__init__(graphs, [(self.shortest + self.longest) / 2] * len(graphs), clock)
        modes = len(self.graphs)
        if modes < 2:
            raise ValueError("a random topology needs at least two graphs; use fixed() for one")
        self.transition = frozen(transition)
        rows = self.transition.shape == (modes, modes) and np.allclose(
            self.transition.sum(axis=1), 1, rtol=0, atol=1e-9
        )
        if not rows or self.transition.min() < 0:
            raise ValueError(f"transition is a {modes} × {modes} matrix of probabilities whose rows sum to 1")
        if not nx.is_strongly_connected(nx.from_numpy_array(self.transition > 0, create_using=nx.DiGraph)):
            raise ValueError(
                "the Markov chain is reducible: some mode is not reached from some other; give every mode a way to "
                "every other, or leave it out"
            )
        if first is not None and not 0 <= require_count("first", first, 0) < modes:
            raise ValueError(f"first is a mode 0..{modes - 1}, got {first}")
        self.first = first

    @property
    def is_random(self) -> bool:
        """True."""
        return True

    @property
    def joint_connectivity(self) -> JointConnectivity:
        """From the union of all modes, as the chain visits all of them infinitely often with probability 1.

        ``always`` is said where every mode is connected, or the order of the modes is certain. In between, chains whose
        every path happens to connect within some window are called ``almost surely`` too.
        """
        if not self.union.is_connected:
            return "never"
        certain = bool(np.all((self.transition == 0) | (self.transition == 1)))
        return "always" if certain or all(graph.is_connected for graph in self.graphs) else "almost surely"

    @property
    def shortest_dwell(self) -> float:
        """The shortest dwell that can be drawn."""
        return self.shortest

    def schedule(self, instants: npt.ArrayLike) -> Schedule:  # noqa: ARG002 - the signature is the interface
        """Not to be had without a draw.

        Raises:
            ValueError: always.
        """
        raise ValueError("this topology is random and has no schedule of its own: draw one per episode, see draw()")

    def switches(self, start: float, end: float) -> FloatArray:  # noqa: ARG002 - the signature is the interface
        """Not to be had without a draw.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "this topology is random and has no switching instants of its own: draw a schedule, see draw()"
        )

    def draw(self, instants: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Schedule:
        """A schedule per generator, sampled at increasing ``instants`` (K,) of the clock: modes and ages (K, B).

        Raises:
            ValueError: when an instant is negative.
        """
        times = np.asarray(instants, dtype=np.float64)
        if times.size and times.min() < 0:
            raise ValueError(f"a topology starts at 0, got the instant {times.min()}")
        # As many dwells as there can be, so that what is drawn depends on the episode's length alone.
        count = int(np.max(times, initial=0.0) / self.shortest) + 2
        choices, unit = np.stack([generator.random((2, count)) for generator in generators], axis=-1)
        ends = np.cumsum(self.shortest + (self.longest - self.shortest) * unit, axis=0)
        ladder = np.cumsum(self.transition, axis=1)
        ladder[:, -1] = 1.0
        if self.first is None:
            mode = (choices[0] * len(self.graphs)).astype(np.int64)
        else:
            mode = np.full(len(generators), self.first)

        slack = _BOUNDARY_TOLERANCE * self.shortest
        modes = np.broadcast_to(mode, (times.size, mode.size)).copy()
        starts = np.zeros(modes.shape)
        for dwell, end in enumerate(ends[:-1], 1):
            first = int(np.searchsorted(times, end.min() - slack))
            if first == times.size:
                break
            mode = (choices[dwell] >= ladder[mode].T).sum(axis=0)
            begun = times[first:, None] >= end - slack
            np.copyto(modes[first:], mode, where=begun)
            np.copyto(starts[first:], end, where=begun)
        age = np.clip((times[:, None] - starts) / self.mean_dwell, 0.0, 1.0)
        return Schedule(modes, age)


class EpisodeTopology(SwitchingTopology):
    """A topology that draws one graph for a whole episode, uniformly from a pool, and never switches within it.

    Args:
        graphs: the pool, at least two, all on the same players.

    Raises:
        ValueError: for fewer graphs, or graphs on different players.
    """

    def __init__(self, graphs: Sequence[Graph]) -> None:
        if len(graphs) < 2:
            raise ValueError("a topology that draws its graph needs at least two; use fixed() for one")
        super().__init__(graphs, [1.0] * len(graphs))
        self.dwells = ()

    @property
    def is_random(self) -> bool:
        """True."""
        return True

    @property
    def joint_connectivity(self) -> JointConnectivity:
        """``always`` where every graph of the pool is connected; an episode that draws another never connects."""
        return "always" if all(graph.is_connected for graph in self.graphs) else "never"

    @property
    def mean_dwell(self) -> float:
        """Infinite."""
        return float("inf")

    def schedule(self, instants: npt.ArrayLike) -> Schedule:  # noqa: ARG002 - the signature is the interface
        """Not to be had without a draw.

        Raises:
            ValueError: always.
        """
        raise ValueError("this topology is random and has no schedule of its own: draw one per episode, see draw()")

    def switches(self, start: float, end: float) -> FloatArray:  # noqa: ARG002 - the signature is the interface
        """None."""
        return np.empty(0)

    def draw(self, instants: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Schedule:
        """A graph per generator, at all ``instants`` (K,): modes and ages, which are 0, of shape (K, B)."""
        shape = (np.size(instants), len(generators))
        modes = np.array([generator.integers(len(self.graphs)) for generator in generators], dtype=np.int64)
        return Schedule(np.broadcast_to(modes, shape).copy(), np.zeros(shape))


def fixed(graph: Graph) -> SwitchingTopology:
    """The topology that never switches."""
    return SwitchingTopology([graph])


def periodic(graphs: Sequence[Graph], dwells: Sequence[float], clock: TopologyClock = "physical") -> SwitchingTopology:
    """The topology that repeats ``graphs`` with their ``dwells``, in the unit of ``clock``."""
    return SwitchingTopology(graphs, dwells, clock)


def random_dwells(graphs: Sequence[Graph], dwells: Dwells, clock: TopologyClock = "physical") -> SwitchingTopology:
    """The topology that repeats ``graphs`` in their order, each for a time that is drawn from the range ``dwells``."""
    following = np.roll(np.eye(len(graphs)), 1, axis=1)
    return MarkovTopology(graphs, following, dwells, clock, first=0)


def markov(
    graphs: Sequence[Graph], transition: npt.ArrayLike, dwells: Dwells, clock: TopologyClock = "physical"
) -> SwitchingTopology:
    """The topology that after each dwell goes on to a graph that the row of ``transition`` draws."""
    return MarkovTopology(graphs, transition, dwells, clock)


def random_edges(
    graph: Graph, probability: float, dwells: Dwells, modes: int = 32, seed: int = 0, clock: TopologyClock = "physical"
) -> SwitchingTopology:
    """The topology that has each link of ``graph`` up or down at random in every dwell.

    Every dwell draws uniformly from a pool of ``modes`` graphs, in each of which every link is up with ``probability``
    independently. The pool is a function of the arguments, and so part of the scenario and the same in every episode.

    Args:
        graph: the links that there can be.
        probability: that a link is up, in (0, 1].
        dwells: a dwell time or a range (shortest, longest).
        modes: graphs in the pool, at least 2.
        seed: of the pool.
        clock: ``"physical"`` or ``"transformed"``.

    Raises:
        ValueError: when the probability is not in (0, 1], or as :class:`MarkovTopology`.
    """
    if require_positive("probability", probability) > 1:
        raise ValueError(f"probability must be a number between 0 and 1, got {probability!r}")
    count = require_count("modes", modes, 2)
    links = np.array(graph.edges).reshape(-1, 2)
    up = np.random.default_rng(require_count("seed", seed, 0)).random((count, len(links))) < probability
    pool = []
    for mask in up:
        adjacency = np.zeros_like(graph.adjacency)
        i, j = links[mask].T
        adjacency[i, j] = adjacency[j, i] = graph.adjacency[i, j]
        pool.append(Graph(adjacency))
    return MarkovTopology(pool, np.full((count, count), 1 / count), dwells, clock)


def random_graphs(players: int, probability: float, modes: int = 100, seed: int = 0) -> SwitchingTopology:
    """The topology that draws a connected random graph for every episode, which holds all through it.

    The pool is a function of the arguments, and so part of the scenario and the same in every episode: graphs of Erdős
    and Rényi, every pair of players being linked with ``probability``, of which the connected ones are kept.

    Args:
        players: N ≥ 2.
        probability: that a pair is linked, in (0, 1].
        modes: graphs in the pool, at least 2.
        seed: of the pool.

    Raises:
        ValueError: when the probability is not in (0, 1], or so small that hardly any graph is connected.
    """
    if require_positive("probability", probability) > 1:
        raise ValueError(f"probability must be a number between 0 and 1, got {probability!r}")
    count = require_count("modes", modes, 2)
    i, j = np.triu_indices(require_count("players", players, 2), 1)
    generator = np.random.default_rng(require_count("seed", seed, 0))
    pool: list[Graph] = []
    for _ in range(1000 * count):
        linked = generator.random(i.size) < probability
        graph = from_edges(players, zip(i[linked].tolist(), j[linked].tolist(), strict=True))
        if graph.is_connected:
            pool.append(graph)
        if len(pool) == count:
            return EpisodeTopology(pool)
    raise ValueError(f"hardly any graph of {players} players is connected with probability {probability}; raise it")


def paper_topology(dwell: float = 0.1, clock: TopologyClock = "physical") -> SwitchingTopology:
    """The paper's eq. SwitchingSignal: four disconnected modes of ``dwell`` each, Γ = 4·dwell = 0.4 s.

    The paper's figure of the modes is lost; ours are the pairs {12, 34}, {23, 45}, {34, 51}, {45, 12} of edges of
    the 5-cycle (players 1..5), whose union is the cycle.
    """
    pairs = [[(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)]]
    return SwitchingTopology([from_edges(5, pair) for pair in pairs], [dwell] * 4, clock)
