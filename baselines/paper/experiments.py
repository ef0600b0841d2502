"""The paper's experiments (section V), each run once and shared by the table, the claims and the figures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from baselines.paper.continuous import Run, exact_static, plain_timeline, prescribed_timeline, simulate
from ptne_env.games import EnergyGame, Game, NonQuadraticGame, QuadraticGame
from ptne_env.shared.arrays import FloatArray
from ptne_env.theory import MonotonicityConstants, closed_loop_matrix, gain_bound, monotonicity_constants
from ptne_env.world.clock import Exponential, TimeTransformation
from ptne_env.world.graphs import Graph, cycle, from_edges, path
from ptne_env.world.starts import PaperStart
from ptne_env.world.switching import SwitchingTopology, TopologyClock, fixed, paper_topology

DEADLINE = 1.2
"""T in seconds."""
GAIN = 20.0
"""c in 1/s."""
KAPPA = 2.0
"""κ of the static law."""
GAMMA = 0.1
"""γ_ij of the adaptive law; the paper gives none."""
INITIAL_GAIN = 0.5
"""κ_ij(0)."""
S_END = 60.0
"""End of the approach of T: e^{−60} T is ten digits below the resolution of float64 around T."""
HOLD = 0.4
"""Seconds shown after T."""
DWELLS: dict[TopologyClock, float] = {"physical": 0.1, "transformed": 0.25}
"""Dwell time of a mode on each clock: Γ/4 of the paper in seconds, and ours in units of s."""
PERIODS = (0.8, 0.4, 0.2, 0.1)
"""Periods Γ in seconds that erratum 2 compares."""
ROTATION = 10.0
"""Size of the skew-symmetric part of F in the counterexamples of erratum 2."""
SMALL_GAMMA = 0.01
"""γ_ij in the counterexamples of erratum 2."""


class Experiments:
    """Lazily integrated runs of the paper's two examples, on the 5-cycle or the paper's switching topology.

    Attributes:
        energy: Example 1.
        non_quadratic: Example 2, in the corrected variant, which has the printed equilibrium.
        ring: the fixed graph of our choice.
        transformation: the paper's λ.
        start: x^i(0), shape (5, 5), row i being player i's.
    """

    def __init__(self) -> None:
        self.energy = EnergyGame()
        self.non_quadratic = NonQuadraticGame("corrected")
        self.ring = fixed(cycle(5))
        self.transformation: TimeTransformation = Exponential(DEADLINE)
        self.start: FloatArray = PaperStart().draw(5, 5, np.random.default_rng(0)).T

    @cached_property
    def constants(self) -> MonotonicityConstants:
        """ε and ι of Example 1."""
        return monotonicity_constants(self.energy)

    @cached_property
    def gain_bound(self) -> float:
        """The κ that Theorem 1's gain condition requires on the fixed graph."""
        return self.required_gain(self.ring.graphs[0].algebraic_connectivity)

    def required_gain(self, connectivity: float) -> float:
        """(ι²/ε + ι)/λ2 of Example 1 on a graph with this λ2."""
        return gain_bound(self.constants, connectivity)

    def loop_matrix(self, kappa: float) -> FloatArray:
        """M of the static law on Example 1 and the fixed graph, shape (25, 25)."""
        return closed_loop_matrix(self.energy, self.ring.graphs[0], kappa)

    def exact_approach(self, kappa: float, *, s_end: float, samples: int, gain: float = GAIN) -> Run:
        """The static law on Example 1 up to s_end, by matrix exponentials."""
        timeline = prescribed_timeline(self.ring, self.transformation, gain, s_end=s_end, samples=samples)
        return exact_static(self.energy, self.ring, self.start, timeline, kappa=kappa)

    @cached_property
    def static(self) -> Run:
        """Theorem 1's law, κ = 2, on Example 1, with a hold phase, by matrix exponentials."""
        timeline = prescribed_timeline(self.ring, self.transformation, GAIN, s_end=S_END, hold=HOLD)
        return exact_static(self.energy, self.ring, self.start, timeline, kappa=KAPPA)

    @cached_property
    def corollary_one(self) -> Run:
        """Corollary 1's law, κ = 10, without the time gain."""
        return self._plain(10.0)

    @cached_property
    def gadjov_pavel(self) -> Run:
        """Gadjov and Pavel's algorithm, which is Corollary 1's at κ = 1."""
        return self._plain(1.0)

    @cached_property
    def adaptive(self) -> Run:
        """Theorem 3's law on Example 1, with a hold phase."""
        return self._adaptive(self.energy, self.ring)

    @cached_property
    def switching(self) -> dict[TopologyClock, Run]:
        """Theorem 4's law on Example 1, the topology dwelling in t (the paper's) or in s."""
        return {clock: self._adaptive(self.energy, paper_topology(DWELLS[clock], clock)) for clock in DWELLS}

    @cached_property
    def non_quadratic_switching(self) -> dict[TopologyClock, Run]:
        """Theorem 4's law on Example 2, the topology dwelling in t (the paper's) or in s."""
        return {clock: self._adaptive(self.non_quadratic, paper_topology(DWELLS[clock], clock)) for clock in DWELLS}

    @cached_property
    def by_period(self) -> dict[float, Run]:
        """Theorem 4's law on Example 1 by the period Γ in seconds of a topology that dwells in t."""
        topologies = {period: paper_topology(period / 4, "physical") for period in PERIODS}
        return {period: self._adaptive(self.energy, topology, 0.0, 501) for period, topology in topologies.items()}

    @cached_property
    def rotating(self) -> QuadraticGame:
        """Five players with F = (I + 10 K) x, K skew-symmetric, drawn with seed 0, and of norm 1: ε = 1."""
        drawn = np.random.default_rng(0).normal(size=(5, 5))
        skew = drawn - drawn.T
        return QuadraticGame(np.eye(5) + ROTATION * skew / np.linalg.norm(skew, 2), np.zeros(5))

    @cached_property
    def counterexamples(self) -> dict[str, Run]:
        """Theorem 4's law on strongly monotone games over topologies that dwell 0.25 in s, from estimates of 1.

        Two players who are linked in every other dwell, five over the paper's modes, and the same five over two cycles.
        """
        pair = QuadraticGame([[1.0, ROTATION], [-ROTATION, 1.0]], [0.0, 0.0])
        cycles = [cycle(5), from_edges(5, [(0, 2), (2, 4), (4, 1), (1, 3), (3, 0)])]
        return {
            "two players": self._rotate(pair, [from_edges(2, []), path(2)], 5.0),
            "five players": self._rotate(self.rotating, paper_topology().graphs, 12.0),
            "connected modes": self._rotate(self.rotating, cycles, S_END),
        }

    def _rotate(self, game: Game, modes: Sequence[Graph], s_end: float) -> Run:
        topology = SwitchingTopology(modes, [DWELLS["transformed"]] * len(modes), "transformed")
        timeline = prescribed_timeline(topology, self.transformation, GAIN, s_end=s_end, samples=501)
        start = np.ones((game.num_players, game.dimension))
        return simulate(game, topology, start, timeline, initial_gain=INITIAL_GAIN, gamma=SMALL_GAMMA)

    def _plain(self, kappa: float) -> Run:
        timeline = plain_timeline(self.ring, 30.0)
        return simulate(self.energy, self.ring, self.start, timeline, initial_gain=kappa)

    def _adaptive(self, game: Game, topology: SwitchingTopology, hold: float = HOLD, samples: int = 2001) -> Run:
        timeline = prescribed_timeline(topology, self.transformation, GAIN, s_end=S_END, hold=hold, samples=samples)
        return simulate(game, topology, self.start, timeline, initial_gain=INITIAL_GAIN, gamma=GAMMA)
