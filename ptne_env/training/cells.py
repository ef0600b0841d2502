"""Cells as environments: every component of every player's estimates, in several worlds side by side.

A *cell* is a pair (player, component). A :class:`CellBatch` plays episodes of one world in which the fixed estimation
of :class:`~ptne_env.laws.gated.GatedLaw` runs, and in which gates are given from outside. :class:`CellVecEnv` shows
several of them to Stable-Baselines3 as one environment with a member per cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from ptne_env import distances, dynamics
from ptne_env.arrays import BoolArray, Float32Array, FloatArray, ordered_sum, require_count
from ptne_env.encoder import make_encoder
from ptne_env.laws.gated import CellEvidence, CellGates, GatedLaw, SlotEvidence, SlotGates
from ptne_env.policies.size_free import CELL_BOUNDS, CELL_FEATURES, SLOT_BOUNDS, SLOT_FEATURES, features
from ptne_env.random_streams import RandomStreams
from ptne_env.scenario import Scenario
from ptne_env.world import World

CELL_GATES, SLOT_GATES = len(CellGates._fields), len(SlotGates._fields)


class _Estimation(GatedLaw):
    """The fixed estimation alone; gates are given to :meth:`GatedLaw.follow`."""

    def gates(self, cells: CellEvidence, slots: SlotEvidence) -> tuple[CellGates, SlotGates]:
        raise NotImplementedError("gates are given from outside")


class CellBatch:
    """B episodes of one world in lockstep, whose gates are given from outside.

    Rows are players, episode by episode: row b N + i is player i of episode b. Cells are rows times components.

    Args:
        scenario: of the world.
        episodes: B.

    Attributes:
        world: of the scenario.
        layout: of the observations of the estimation.
        episodes: B.
        cells: their number B N n.
        state: of all episodes.
        evidence: on cells and messages, of the present step.

    Raises:
        ValueError: when B is below 1.
        LayoutError: when players of the scenario have no interface ``physical``.
    """

    state: dynamics.State
    evidence: tuple[CellEvidence, SlotEvidence]

    def __init__(self, scenario: Scenario, episodes: int) -> None:
        self.world, self.episodes = World(scenario), require_count("episodes", episodes, 1)
        self._encoder = make_encoder(self.world, GatedLaw.interface)
        self.layout = self._encoder.layout
        self._law = _Estimation(self.layout)
        self._rows = self.episodes * self.layout.num_players
        self.cells = self._rows * self.layout.dimension

    def start(self, seeds: Sequence[int]) -> None:
        """Start episodes, one seed each; several may share a seed."""
        drawn = {seed: RandomStreams.from_seed(seed) for seed in seeds}
        if len(drawn) < len(seeds):  # streams are used up by drawing
            streams = [RandomStreams.from_seed(seed) for seed in seeds]
        else:
            streams = list(drawn.values())
        self.state = dynamics.draw_initial_state(self.world, streams)
        self._memory = self._law.initial_memory(self._rows)
        self._perceive()

    def step(self, gates: CellGates, slot_gates: SlotGates) -> None:
        """Hold the inputs that gates give, arrays (R, n) and (R, D, n), for one step."""
        inputs, self._memory = self._law.follow(self._observation, self._memory, self._found, gates, slot_gates)
        actions = self.layout.write(inputs, self._observation).reshape(self.episodes, self.layout.num_players, -1)
        self.state = dynamics.step(self.world, self.state, self._encoder.decode(actions, self.state))
        self._perceive()

    def _perceive(self) -> None:
        self._observation = self.layout.read(self._encoder.observe(self.state).reshape(self._rows, -1))
        self._found, *evidence = self._law.perceive(self._observation, self._memory)
        self.evidence = (evidence[0], evidence[1])

    @property
    def is_over(self) -> bool:
        """Whether all episodes have ended. Those that left the range rest until then."""
        return bool(dynamics.is_over(self.world, self.state).all())

    @property
    def digits(self) -> FloatArray:
        """−log10 of every player's relative distance to the equilibrium, shape (N, B); of the limit out of range."""
        distance = distances.player_distances(self.state.estimates, self.state.game)
        if self.state.any_diverged:
            distance = np.where(self.state.diverged, dynamics.distance_limit(self.state.game), distance)
        return distances.digits(distance)

    def features(self) -> tuple[Float32Array, Float32Array]:
        """Features of cells (C, F) and of their slots (C, D, S)."""
        cell, slot = features(*self.evidence)
        return cell.reshape(self.cells, -1), slot.reshape(self.cells, self.layout.slots, -1)

    def as_gates(self, cell: np.ndarray, slot: np.ndarray) -> tuple[CellGates, SlotGates]:
        """Answers (C, 9) and (C, D, 3) of any range, as gates within their bounds, (R, n) and (R, D, n)."""
        n, slots = self.layout.dimension, self.layout.slots
        mine = np.clip(cell.astype(np.float64), *np.transpose(CELL_BOUNDS)).reshape(self._rows, n, -1)
        theirs = np.clip(slot.astype(np.float64), *np.transpose(SLOT_BOUNDS)).reshape(self._rows, n, slots, -1)
        return CellGates(*np.moveaxis(mine, -1, 0)), SlotGates(*theirs.transpose(3, 0, 2, 1))

    def as_answers(self, gates: CellGates, slot_gates: SlotGates) -> tuple[Float32Array, Float32Array]:
        """The inverse of :meth:`as_gates`: (C, 9) and (C, D, 3), float32."""
        n, slots = self.layout.dimension, self.layout.slots
        mine = np.stack([np.broadcast_to(gate, (self._rows, n)) for gate in gates], axis=-1)
        theirs = np.stack([np.broadcast_to(gate, (self._rows, slots, n)) for gate in slot_gates], axis=-1)
        theirs = theirs.swapaxes(1, 2).reshape(self.cells, slots, -1)
        return mine.reshape(self.cells, -1).astype(np.float32), theirs.astype(np.float32)
