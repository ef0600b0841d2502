"""Cells as environments: every component of every player's estimates, in several worlds side by side.

A *cell* is a pair (player, component). A :class:`CellBatch` plays episodes of one world in which the fixed estimation
of :class:`~ptne_env.field.laws.gated.GatedLaw` runs, and in which gates are given from outside. :class:`CellVecEnv` shows
several of them to Stable-Baselines3 as one environment with a member per cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from ptne_env.field.laws.gated import CellEvidence, CellGates, GatedLaw, SlotEvidence, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, HIGH, LOW, SLOT_FEATURES, bounded, features
from ptne_env.perception.encoder import make_encoder
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, require_count
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import distances, dynamics
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

CELL_GATES, SLOT_GATES = len(CellGates._fields), len(SlotGates._fields)

_CELL_HIGH, _SLOT_HIGH = (np.array([HIGH[name] for name in gates._fields]) for gates in (CellGates, SlotGates))


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
        self.state = dynamics.draw_initial_state(self.world, [RandomStreams.from_seed(seed) for seed in seeds])
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
        self._found, cells, slots = self._law.perceive(self._observation, self._memory)
        self.evidence = cells, slots

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
        """Answers (C, 10) and (C, D, 3) of any range, as gates within their bounds, (R, n) and (R, D, n)."""
        slot = slot.reshape(self.cells, self.layout.slots, SLOT_GATES)
        return bounded(cell, slot, (self._rows, self.layout.dimension))

    def as_answers(self, gates: CellGates, slot_gates: SlotGates) -> tuple[Float32Array, Float32Array]:
        """The inverse of :meth:`as_gates`: (C, 10) and (C, D, 3), float32."""
        n, slots = self.layout.dimension, self.layout.slots
        mine = np.stack([np.broadcast_to(gate, (self._rows, n)) for gate in gates], axis=-1)
        theirs = np.stack([np.broadcast_to(gate, (self._rows, slots, n)) for gate in slot_gates], axis=-1)
        theirs = theirs.swapaxes(1, 2).reshape(self.cells, slots, -1)
        return mine.reshape(self.cells, -1).astype(np.float32), theirs.astype(np.float32)


class CellVecEnv(VecEnv):
    """Several worlds side by side, with a member for every cell of every episode.

    An observation is the features of the cell, then those of its slots, slot by slot, and zeros for the slots that only
    other worlds have: they are dead. An action is the gates of the cell, then those of each slot. The reward is the
    digits that the player's estimates gained in the step, mixed with the team's mean.

    Episodes of a place start and end together. Then the place starts new ones, with new games, perhaps in another of
    its worlds. One member of the place reports the mean digits that were gained, as ``episode`` in its infos.

    Args:
        places: the worlds of every place, which are drawn anew with every episode.
        episodes: side by side in every place.
        team: share of the team's mean in the reward, in [0, 1].

    Attributes:
        playing: the episodes of every place.
        members: of every place.
        slots: D of observations and actions, the largest of all worlds.

    Raises:
        ValueError: when there is no place, or the worlds of a place differ in their number of cells.
    """

    def __init__(self, places: Sequence[Sequence[Scenario]], episodes: int = 4, team: float = 0.5) -> None:
        self.places = [[CellBatch(scenario, episodes) for scenario in worlds] for worlds in places]
        if not self.places or not all(self.places):
            raise ValueError("cells need at least one place, and every place at least one world")
        for batches in self.places:
            if len({batch.cells for batch in batches}) > 1:
                raise ValueError(
                    "worlds of a place must have the same number of cells (players × components), got "
                    + ", ".join(f"{batch.world.scenario.name}: {batch.cells // episodes}" for batch in batches)
                )
        self.slots = max(batch.layout.slots for batches in self.places for batch in batches)
        self._team, self.playing = team, [batches[0] for batches in self.places]
        self._digits: list[FloatArray] = []
        self._first: list[float] = []
        sizes = [batches[0].cells for batches in self.places]
        self.members = [slice(*ends) for ends in pairwise(np.cumsum([0, *sizes]).tolist())]
        size = len(CELL_FEATURES) + self.slots * len(SLOT_FEATURES)
        high = np.concatenate([_CELL_HIGH, np.tile(_SLOT_HIGH, self.slots)]).astype(np.float32)
        self.render_mode: str | None = None
        self.seed(0)
        super().__init__(sum(sizes), spaces.Box(-np.inf, np.inf, (size,)), spaces.Box(np.float32(LOW), high))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed all episodes from the next reset on; every member reports the seed."""
        self._generator = np.random.default_rng(seed)
        return [seed] * getattr(self, "num_envs", 0)

    def reset(self) -> Float32Array:
        """Start all episodes; observations of shape (members, size)."""
        self._digits, self._first = [], []
        for place in range(len(self.places)):
            digits = self._start(place)
            self._digits.append(digits)
            self._first.append(float(digits.mean()))
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return self._observe()

    def _start(self, place: int) -> FloatArray:
        """Start episodes of a place; their digits."""
        batches = self.places[place]
        self.playing[place] = batch = batches[self._generator.integers(len(batches))]
        batch.start(self._generator.integers(2**62, size=batch.episodes).tolist())
        return batch.digits

    def _observe(self) -> Float32Array:
        observations = np.zeros((self.num_envs, *(self.observation_space.shape or ())), dtype=np.float32)
        for batch, members in zip(self.playing, self.members, strict=True):
            cell, slot = batch.features()
            flat = np.concatenate([cell, slot.reshape(batch.cells, -1)], axis=1)
            observations[members, : flat.shape[1]] = flat
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions, shape (members, action size)."""
        self._actions = actions

    def step_wait(self) -> tuple[Float32Array, Float32Array, BoolArray, list[dict[str, Any]]]:
        """Step all episodes, and start new ones in the places where they ended."""
        rewards = np.zeros(self.num_envs, dtype=np.float32)
        dones = np.zeros(self.num_envs, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        over = []
        for place, (batch, members) in enumerate(zip(self.playing, self.members, strict=True)):
            actions = self._actions[members]
            slot = actions[:, CELL_GATES : CELL_GATES + batch.layout.slots * SLOT_GATES]
            batch.step(*batch.as_gates(actions[:, :CELL_GATES], slot))
            digits = batch.digits
            gained, self._digits[place] = digits - self._digits[place], digits
            mixed = (1 - self._team) * gained + self._team * gained.mean(axis=0)
            rewards[members] = np.repeat(mixed.T.ravel(), batch.layout.dimension)
            if batch.is_over:
                dones[members] = True
                over.append(place)
        last = self._observe() if over else np.empty(0)
        for place in over:
            members = self.members[place]
            for member in range(members.start, members.stop):
                infos[member] = {"terminal_observation": last[member], "TimeLimit.truncated": False}
            steps = self.playing[place].world.clock.total_steps
            total = float(self._digits[place].mean()) - self._first[place]
            infos[members.start]["episode"] = {"r": total, "l": steps, "t": 0.0}
            self._digits[place] = self._start(place)
            self._first[place] = float(self._digits[place].mean())
        return self._observe(), rewards, dones, infos

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """The attribute of this object, once per requested member."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Members share one object, so an attribute is set for all of them or none.

        Raises:
            ValueError: when only some members are named.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError("the members share one object: an attribute is set for all of them or none")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method once; the answer for each requested member."""
        answer = getattr(self, method_name)(*method_args, **method_kwargs)
        return [answer] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: int | Iterable[int] | None = None) -> list[bool]:  # noqa: ARG002
        """No member is wrapped."""
        return [False] * len(list(self._get_indices(indices)))
