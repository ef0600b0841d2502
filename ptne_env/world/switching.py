"""Switching topologies: the graph that acts at each instant, fixed, periodic or random."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from ptne_env.shared.arrays import FloatArray, IntArray, require_count, require_positive, require_positive_probability
from ptne_env.shared.names import require_name
from ptne_env.shared.parts import Part
from ptne_env.world.graphs import Graph, as_graph, from_edges, union

TopologyClock: TypeAlias = Literal["physical", "transformed"]

Dwells: TypeAlias = "float | tuple[float, float]"
"""A dwell time, or the range (shortest, longest) from which every dwell is drawn uniformly."""

_BOUNDARY_TOLERANCE = 1e-9
"""An instant closer to the next switch than this fraction of a dwell counts as the switch, as k·Δt is rounded."""


class Schedule(NamedTuple):
    """A topology sampled on the steps of an episode.

    Attributes:
        modes: index of the active graph at each instant, shape (instants,), or (instants, B) where episodes differ.
        time_since_switch: time since the last switch over the mean dwell, clipped to [0, 1]; 0 for a fixed graph. Same
            shape.
    """

    modes: IntArray
    time_since_switch: FloatArray


class SwitchingTopology(Part):
    """A switching topology σ: a periodic sequence of graphs with a dwell time each; a single graph is the fixed case.

    Dwell times are in the unit of the topology's clock. On the ``physical`` clock (t, the paper's) only finitely many
    switches happen before the deadline; on the ``transformed`` clock (s) infinitely many do (docs/errata.md, 2).

    Attributes:
        graphs: the modes, in order, all on the same players; as arguments also what makes a :class:`Graph`.
        dwells: dwell time of each mode, in seconds of t or in units of s; none for one fixed graph.
        clock: ``"physical"`` or ``"transformed"``.

    Raises:
        ValueError: when numbers of graphs, dwells or players disagree, a dwell is not positive, or the clock is
            unknown.
    """

    is_random: ClassVar[bool] = False
    """Whether every episode draws its own schedule."""

    graphs: Sequence[Graph]
    dwells: float | Sequence[float] = ()
    clock: TopologyClock = "physical"

    def __post_init__(self) -> None:
        require_name("clock of a topology", self.clock, get_args(TopologyClock))
        vars(self)["graphs"] = tuple(map(as_graph, self.graphs))
        if not self.graphs or len({graph.num_players for graph in self.graphs}) != 1:
            raise ValueError("a topology needs at least one graph, all with the same number of players")
        if self.is_random and len(self.graphs) < 2:
            raise ValueError("a random topology needs at least two graphs; use fixed() for one")
        _ = self.mode_dwells

    @cached_property
    def mode_dwells(self) -> tuple[float, ...]:
        """Mean dwell time of each mode, in the unit of the clock; none where the graph never changes."""
        dwells, modes = self.dwells, len(self.graphs)
        if not isinstance(dwells, Sequence) or (len(dwells) != modes and (dwells or modes > 1)):
            raise ValueError(f"dwell times of a topology: one dwell time per graph, got {dwells!r} for {modes} graphs")
        return tuple(require_positive("a dwell time", dwell) for dwell in dwells) if modes > 1 else ()

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
    def is_jointly_connected(self) -> bool:
        """Assumption 2 of the paper (Assumption 1 when fixed); of a random topology over all time, almost surely."""
        return self.union.is_connected

    @property
    def shortest_dwell(self) -> float:
        """The shortest time between switches, in the unit of the clock; infinite when fixed."""
        return min(self.mode_dwells, default=float("inf"))

    @property
    def period(self) -> float:
        """Sum of the dwell times, in the unit of the clock; infinite when fixed."""
        return float(sum(self.mode_dwells)) or float("inf")

    @property
    def mean_dwell(self) -> float:
        """Mean dwell time, in the unit of the clock; infinite when fixed."""
        return self.period / len(self.graphs)

    def schedule(self, instants: npt.ArrayLike) -> Schedule:
        """Return the schedule at ``instants`` (any shape) of the topology's clock.

        Raises:
            ValueError: when an instant is negative, or every episode draws its own schedule.
        """
        self._require_certain("schedule")
        times = _instants(instants)
        if self.is_fixed:
            return Schedule(np.zeros(times.shape, dtype=np.int64), np.zeros(times.shape))
        ends, phase = np.cumsum(self.mode_dwells), np.mod(times, self.period)
        slack = _BOUNDARY_TOLERANCE * self.shortest_dwell
        phase = np.where(phase >= self.period - slack, 0.0, phase)
        modes = np.searchsorted(ends, phase + slack, side="right").astype(np.int64)
        starts = np.concatenate([[0.0], ends[:-1]])
        return Schedule(modes, np.clip((phase - starts[modes]) / self.mean_dwell, 0.0, 1.0))

    def draw(self, instants: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Schedule:
        """Draw the schedules of B episodes, one per generator, at increasing ``instants`` (K,) of the topology's clock.

        Their arrays have the shape (K, B). A topology that is not random draws nothing. Raises as :meth:`schedule`.
        """
        (modes, age), batch = self.schedule(instants), len(generators)
        return Schedule(np.tile(modes[:, None], batch), np.tile(age[:, None], batch))

    def switches(self, start: float, end: float) -> FloatArray:
        """Return the switching instants in (start, end), in the unit of the clock; raises as :meth:`schedule`."""
        self._require_certain("switching instants")
        if self.is_fixed:
            return np.empty(0)
        periods = np.arange(np.floor(start / self.period), np.floor(end / self.period) + 1)
        instants = (periods[:, None] * self.period + np.cumsum(self.mode_dwells)).ravel()
        slack = _BOUNDARY_TOLERANCE * self.shortest_dwell
        return instants[(instants > start + slack) & (instants < end - slack)]

    def _require_certain(self, wanted: str) -> None:
        if self.is_random:
            raise ValueError(
                f"this topology is random and has no {wanted} of its own: draw one per episode, see draw()"
            )


class RandomTopology(SwitchingTopology):
    """A topology that draws a graph uniformly from a pool for every dwell, and the dwell time uniformly from a range.

    The same graph may follow itself, which counts as a switch.

    Attributes:
        graphs: the pool, at least two, all on the same players.
        dwells: a dwell time or a range (shortest, longest).

    Raises:
        ValueError: as :class:`SwitchingTopology`, or for fewer graphs or a range that is empty.
    """

    is_random = True

    dwells: Dwells

    @cached_property
    def dwell_range(self) -> tuple[float, float]:
        """The shortest and the longest dwell."""
        bounds = self.dwells if isinstance(self.dwells, Sequence) else (self.dwells, self.dwells)
        if len(bounds) != 2:
            raise ValueError(f"dwells are a time or a range (shortest, longest), got {self.dwells!r}")
        shortest, longest = (require_positive("a dwell time", bound) for bound in bounds)
        if shortest > longest:
            raise ValueError(f"the shortest dwell comes first, got the range {tuple(bounds)!r}")
        return shortest, longest

    @cached_property
    def mode_dwells(self) -> tuple[float, ...]:
        """The mean of the range for each graph."""
        return (sum(self.dwell_range) / 2,) * len(self.graphs)

    @property
    def shortest_dwell(self) -> float:
        """The shortest dwell that can be drawn."""
        return self.dwell_range[0]

    def draw(self, instants: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Schedule:
        times, (shortest, longest) = _instants(instants), self.dwell_range
        # The largest possible number of dwells, so that the draws depend on the episode's length alone.
        count = int(np.max(times, initial=0.0) / shortest) + 2
        choices, unit = np.stack([generator.random((2, count)) for generator in generators], axis=-1)
        ends = np.cumsum(shortest + (longest - shortest) * unit, axis=0)
        drawn = (choices * len(self.graphs)).astype(np.int64)
        slack = _BOUNDARY_TOLERANCE * shortest
        modes = np.broadcast_to(drawn[0], (times.size, len(generators))).copy()
        starts = np.zeros(modes.shape)
        for dwell, end in enumerate(ends[:-1], 1):
            first = int(np.searchsorted(times, end.min() - slack))
            if first == times.size:
                break
            started = times[first:, None] >= end - slack
            np.copyto(modes[first:], drawn[dwell], where=started)
            np.copyto(starts[first:], end, where=started)
        return Schedule(modes, np.clip((times[:, None] - starts) / self.mean_dwell, 0.0, 1.0))


class EpisodeTopology(SwitchingTopology):
    """A topology that draws one graph for a whole episode, uniformly from a pool, and never switches within it.

    Attributes:
        graphs: the pool, at least two, all on the same players.
    """

    is_random = True
    mode_dwells = ()

    dwells: ClassVar[tuple[float, ...]] = ()  # type: ignore[misc]  # it has no switches, so it takes no such argument
    clock: ClassVar[TopologyClock] = "physical"  # type: ignore[misc]  # likewise

    @property
    def is_jointly_connected(self) -> bool:
        """Whether every graph of the pool is connected, and so every episode."""
        return all(graph.is_connected for graph in self.graphs)

    def draw(self, instants: npt.ArrayLike, generators: Sequence[np.random.Generator]) -> Schedule:
        shape = (np.size(instants), len(generators))
        modes = np.array([generator.integers(len(self.graphs)) for generator in generators], dtype=np.int64)
        return Schedule(np.broadcast_to(modes, shape).copy(), np.zeros(shape))


def fixed(graph: Graph) -> SwitchingTopology:
    """Return the topology that never switches."""
    return SwitchingTopology([graph])


def random_edges(
    graph: Graph, probability: float, dwells: Dwells, modes: int = 32, seed: int = 0, clock: TopologyClock = "physical"
) -> SwitchingTopology:
    """Return the topology in which each link of ``graph`` is up or down at random in every dwell.

    It is a :class:`RandomTopology` on a pool of ``modes`` ≥ 2 graphs, in each of which every link is up with
    ``probability`` in (0, 1], independently. The pool is a function of the arguments, ``seed`` among them, so it
    belongs to the scenario and is the same in every episode.

    Raises:
        ValueError: for a number out of range, or as :class:`RandomTopology`.
    """
    require_positive_probability("probability", probability)
    count = require_count("modes", modes, 2)
    i, j = np.nonzero(graph.adjacency if graph.is_directed else np.triu(graph.adjacency))
    generator = np.random.default_rng(require_count("seed", seed, 0))
    pool = np.zeros((count, *graph.adjacency.shape))
    pool[:, i, j] = graph.adjacency[i, j] * (generator.random((count, i.size)) < probability)
    return RandomTopology([Graph(up if graph.is_directed else up + up.T) for up in pool], dwells, clock)


def random_graphs(players: int, probability: float, modes: int = 100, seed: int = 0) -> SwitchingTopology:
    """Return the topology that draws a connected random graph for every episode and keeps it throughout.

    It is an :class:`EpisodeTopology` on a pool of ``modes`` ≥ 2 graphs: the connected ones among graphs of Erdős and
    Rényi, which link every pair of N ≥ 2 ``players`` with ``probability``. The pool is a function of the arguments,
    ``seed`` among them, so it belongs to the scenario and is the same in every episode.

    Raises:
        ValueError: when the probability is not in (0, 1], or so small that hardly any graph is connected.
    """
    require_positive_probability("probability", probability)
    count = require_count("modes", modes, 2)
    i, j = np.triu_indices(require_count("players", players, 2), 1)
    generator = np.random.default_rng(require_count("seed", seed, 0))
    pool: list[Graph] = []
    for _ in range(1000 * count):
        upper = np.zeros((players, players))
        upper[i, j] = generator.random(i.size) < probability
        graph = Graph(upper + upper.T)
        if graph.is_connected:
            pool.append(graph)
        if len(pool) == count:
            return EpisodeTopology(pool)
    raise ValueError(f"hardly any graph of {players} players is connected with probability {probability}; raise it")


def paper_topology(dwell: float = 0.1, clock: TopologyClock = "physical") -> SwitchingTopology:
    """Return the topology of the paper's eq. (50): four disconnected modes of ``dwell`` each, Γ = 4·dwell = 0.4 s.

    The paper's figure of the modes is not available; ours are the pairs {12, 34}, {23, 45}, {34, 51}, {45, 12} of edges
    of the 5-cycle (players 1..5), whose union is the cycle.
    """
    pairs = [[(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)]]
    return SwitchingTopology([from_edges(5, pair) for pair in pairs], [dwell] * 4, clock)


def _instants(instants: npt.ArrayLike) -> FloatArray:
    times = np.asarray(instants, dtype=np.float64)
    if times.size and times.min() < 0:
        raise ValueError(f"a topology starts at 0, got the instant {times.min()}")
    return times
