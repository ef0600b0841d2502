"""What every adapter steps: B environments of one scenario behind one interface, with rewards and endings."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptne_env import distances, theory
from ptne_env.arrays import BoolArray, Float32Array, FloatArray, IntArray, require_count
from ptne_env.dynamics import RANGE_LIMIT, State, World
from ptne_env.encoder import Encoder
from ptne_env.observation import Interface
from ptne_env.random_streams import RandomStreams
from ptne_env.rewards import Reward
from ptne_env.scenario import Scenario


class StepResult(NamedTuple):
    """What a step did. Environments last where there are players too.

    Attributes:
        rewards: weighted sum of the terms, shape (N, B).
        terms: each reward term, unweighted, shape (N, B).
        terminated: shape (B,).
        truncated: shape (B,).
    """

    rewards: FloatArray
    terms: dict[str, FloatArray]
    terminated: BoolArray
    truncated: BoolArray


class ResetResult(NamedTuple):
    """What episodes start with.

    Attributes:
        sources: the generators of all environments.
        state: of those that start.
        mask: which they are, shape (B,).
    """

    sources: list[RandomStreams]
    state: State
    mask: BoolArray


class Simulation:
    """B environments that are stepped together and reset one by one.

    Args:
        scenario: the physics.
        interface: how players see and act; not ``full``.
        reward: a term's name, or weights by name.
        max_cycles: steps after which an episode is truncated, or ``None``.
        num_envs: B.
        twin: a simulation of the same scenario and interface, whose tables this one uses instead of building its own.

    Attributes:
        state: of all environments; ``None`` before the first reset.

    Raises:
        ValueError: for the interface ``full``, an unknown reward or a count below 1.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        interface: Interface,
        reward: str | Mapping[str, float] = "digits",
        max_cycles: int | None = None,
        num_envs: int = 1,
        twin: Simulation | None = None,
    ) -> None:
        if interface.kind == "full":
            raise ValueError(
                "the interface 'full' shows what no player can see and is for oracles in evaluations only; choose "
                "'physical' or 'local'"
            )
        self.num_envs = require_count("num_envs", num_envs, 1)
        self.max_cycles = None if max_cycles is None else require_count("max_cycles", max_cycles, 1)
        self.world: World = twin.world if twin else World(scenario)
        self.encoder: Encoder = twin.encoder.twin() if twin else Encoder(self.world, interface)
        self._reward = Reward(self.world, reward)
        self._sources: list[RandomStreams] = []
        self.state: State | None = None

    @property
    def current(self) -> State:
        """The state.

        Raises:
            RuntimeError: before the first reset.
        """
        if self.state is None:
            raise RuntimeError("the environment has no state yet: call reset() first")
        return self.state

    def reset(
        self,
        seeds: Sequence[int | None] | None = None,
        mask: BoolArray | None = None,
        estimates: FloatArray | None = None,
    ) -> State:
        """Start episodes: :meth:`draw` and :meth:`begin`.

        Raises:
            ValueError: as :meth:`draw`; the state stays as it was.
        """
        return self.begin(self.draw(seeds, mask, estimates))

    def draw(
        self,
        seeds: Sequence[int | None] | None = None,
        mask: BoolArray | None = None,
        estimates: FloatArray | None = None,
    ) -> ResetResult:
        """What episodes start with; nothing has started yet.

        Args:
            seeds: one per environment; ``None`` goes on with the generators there are. Only those in ``mask`` count.
            mask: which environments start afresh, shape (B,); all if left out.
            estimates: initial estimates instead of drawn ones, shape (n, N, environments in mask).

        Raises:
            ValueError: for an invalid seed or estimates, or a drawn game that is not strongly monotone.
        """
        if self.state is None and mask is not None and not mask.all():
            raise ValueError("the first reset() starts every environment: leave out the mask")
        chosen = np.arange(self.num_envs) if mask is None else np.flatnonzero(mask)
        sources = self._seeded(chosen, seeds or [None] * self.num_envs)
        if estimates is not None:  # they may be refused, and then nothing has been drawn
            sources = copy.deepcopy(sources)
        drawn = [sources[index] for index in chosen]
        game = self.world.draw_game(drawn)
        if self.world.scenario.has_random_game:
            theory.require_strong_monotonicity(game)
        if estimates is None:
            estimates = self.world.draw_estimates(drawn)
        fresh = self.world.start(estimates, game, self.world.draw_randomness(drawn))
        if fresh.any_diverged:
            raise ValueError(f"own gradients at the initial estimates must be within ±{RANGE_LIMIT:g}: start closer")
        return ResetResult(sources, fresh, np.ones(self.num_envs, dtype=np.bool_) if mask is None else mask)

    def begin(self, beginning: ResetResult) -> State:
        """Start the episodes that were drawn."""
        self._sources, state, mask = beginning
        if not mask.all():
            state = self.world.merge(self.current, state, mask)
        self.state = state
        self._reward.reset(state)
        return state

    def _seeded(self, chosen: IntArray, seeds: Sequence[int | None]) -> list[RandomStreams]:
        """The generators of all environments, new ones for those among ``chosen`` that have a seed."""
        if len(seeds) != self.num_envs:
            raise ValueError(f"{self.num_envs} environments need as many seeds, got {len(seeds)}")
        sources = list(self._sources) or [RandomStreams.from_seed(seed) for seed in seeds]
        for index in chosen.tolist():
            if seeds[index] is not None:
                sources[index] = RandomStreams.from_seed(seeds[index])
        return sources

    def step(self, actions: npt.NDArray[np.floating], restart: ResetResult | None = None) -> StepResult:
        """Hold everybody's inputs for one step.

        Args:
            actions: finite and within the action box (see :meth:`Encoder.clip`), shape (B, N, action size).
            restart: what environments that start afresh instead of moving start with: their rewards are 0.

        Raises:
            RuntimeError: before the first reset.
        """
        state = self.world.step(self.current, self.encoder.inputs(actions, self.current))
        terms = self._reward.step(state)
        self.state = state
        terminated = self.world.is_over(state)
        if self.max_cycles is None:
            truncated = np.zeros(self.num_envs, dtype=np.bool_)
        else:
            truncated = ~terminated & (state.step >= self.max_cycles)
        if restart is not None:
            self.begin(restart)
            terms = {name: np.where(restart.mask, 0.0, term) for name, term in terms.items()}
            terminated, truncated = terminated & ~restart.mask, truncated & ~restart.mask
        return StepResult(self._reward.total(terms), terms, terminated, truncated)

    def observe(self, out: Float32Array | None = None) -> Float32Array:
        """Everybody's observations, shape (B, N, size), float32, owned by the caller."""
        return self.encoder.observe(self.current, out)

    def succeeded(self) -> BoolArray:
        """Whether each environment is within 0.5 % of the equilibrium in all estimates and in range, shape (B,)."""
        state = self.current
        error = distances.estimate_distance(state.estimates, state.game)
        return (error <= distances.SUCCESS_DISTANCE) & ~state.diverged
