"""The simulation behind every adapter: B environments of one world and one interface, with rewards and endings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from inspect import Parameter, signature
from time import perf_counter
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from ptne_env.perception.encoder import Clipped, Encoder, make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray, require_count
from ptne_env.shared.names import suggestion
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import distances, dynamics, fused
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import Reward
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import RANGE_LIMIT, World


class StepResult(NamedTuple):
    """The result of a step, to be read before the next step. Environments last where there are players too.

    Attributes:
        rewards: weighted sum of the terms, shape (N, B).
        terms: each reward term, unweighted, shape (N, B).
        terminated: shape (B,).
        truncated: shape (B,).
        diverged: whether each environment is out of range, shape (B,).
        is_success: whether all estimates of each environment are within 0.5 % of the equilibrium, shape (B,).
        is_observed: whether the observations were written too, as a compiled step does.
        clipped: entries of each player's action that were outside the box, shape (B, N); ``None`` for none.
    """

    rewards: FloatArray
    terms: dict[str, FloatArray]
    terminated: BoolArray
    truncated: BoolArray
    diverged: BoolArray
    is_success: BoolArray
    is_observed: bool
    clipped: IntArray | None = None


class ResetResult(NamedTuple):
    """The draws with which episodes start.

    Attributes:
        streams: the random generators of all environments.
        state: of the environments that start.
        mask: whether each environment starts, shape (B,).
    """

    streams: list[RandomStreams]
    state: State
    mask: BoolArray


def changed_scenario(scenario: str | Scenario, changes: Mapping[str, Any], made: Callable[..., Any]) -> Scenario:
    """The scenario of an environment, with the fields changed that its constructor was given.

    Args:
        scenario: a name of the catalogue or a scenario.
        changes: keyword arguments of the constructor that are not its own.
        made: the constructor.

    Raises:
        TypeError: for a keyword that is no field, with those that are like it, or all where none is.
        ValueError: for an unknown name, or an invalid value.
    """
    own = [name for name, each in signature(made).parameters.items() if each.kind is not Parameter.VAR_KEYWORD]
    known = [*own, *(field.name for field in fields(Scenario))]
    for keyword in changes:
        if keyword not in known:  # TorchRL reads the first half of the message
            problem = f"{made.__name__}() got an unexpected keyword argument {keyword!r}"
            raise TypeError(f"{problem}; {suggestion(keyword, known)}")
    return get_scenario(scenario, **changes)


def player_encoder(world: World, interface: Interface) -> Encoder:
    """The encoder of an environment, which shows no more than players see.

    Raises:
        ValueError: for the interface ``full``.
    """
    if interface.kind == "full":
        raise ValueError(
            "the interface 'full' shows information that players lack and is for oracles in evaluations only; choose "
            "'scaled' or 'physical'"
        )
    return make_encoder(world, interface)


class Duplicable:
    """A copy of an environment steps on its own: ``copy.copy`` gives the same as ``copy.deepcopy``."""

    def __copy__(self) -> Self:
        """An environment in the same state, with which this one shares nothing."""
        return copy.deepcopy(self)


class Simulation:
    """B environments that are stepped together and reset one by one.

    Args:
        encoder: of observations and actions; its world is simulated.
        reward: a term's name, or weights by name.
        max_cycles: steps after which an episode is truncated, or ``None``.
        num_envs: B.

    Attributes:
        encoder: as given.
        world: of the encoder.
        reward_names: the names of the reward terms in infos.
        has_plain_reward: whether the reward is one term, of weight 1.

    Raises:
        ValueError: for an unknown reward or a count below 1.
    """

    def __init__(
        self,
        encoder: Encoder,
        *,
        reward: str | Mapping[str, float] = "digits",
        max_cycles: int | None = None,
        num_envs: int = 1,
    ) -> None:
        self.encoder, self.world = encoder, encoder.world
        self.num_envs = require_count("num_envs", num_envs, 1)
        self.max_cycles = None if max_cycles is None else require_count("max_cycles", max_cycles, 1)
        self._reward = Reward(self.world, reward)
        self.has_plain_reward = self._reward.is_plain
        self.reward_names = [f"reward_{name}" for name in self._reward.weights]
        self._fused = fused.FusedStep(encoder, self.num_envs) if fused.qualifies(encoder, self.num_envs) else None
        self._never = np.zeros(self.num_envs, dtype=np.bool_)
        self._never.flags.writeable = False
        self._streams: list[RandomStreams] = []
        self._state: State | None = None  # and after a compiled step, which keeps the state

    @property
    def state(self) -> State | None:
        """Of all environments; ``None`` before the first reset."""
        if self._state is None and self._fused is not None:
            self._state = self._fused.hand_over()
        return self._state

    @property
    def current(self) -> State:
        """The state.

        Raises:
            RuntimeError: before the first reset.
        """
        state = self.state
        if state is None:
            raise RuntimeError("the environment has no state yet: call reset() first")
        return state

    def set_state(self, state: State) -> None:
        """Continue from ``state``, of as many environments; the random generators stay as they are.

        Raises:
            ValueError: as :func:`ptne_env.world.dynamics.require_state`; the state stays as it was.
        """
        dynamics.require_state(self.world, state, self.num_envs)
        self._state = state
        self._reward.reset(state)

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
        """Draw the start of episodes; none has started yet.

        Args:
            seeds: one per environment; ``None`` continues the present generators. Only those in ``mask`` count.
            mask: whether each environment starts afresh, shape (B,); all if left out.
            estimates: initial estimates instead of drawn ones, shape (n, N, environments in mask).

        Raises:
            ValueError: for an invalid seed or estimates, or a drawn game that is not strongly monotone.
        """
        if self.state is None and mask is not None and not mask.all():
            raise ValueError("the first reset() starts every environment: leave out the mask")
        chosen = np.arange(self.num_envs) if mask is None else np.flatnonzero(mask)
        streams = self._seeded(chosen, seeds or [None] * self.num_envs)
        if estimates is not None:  # they may be refused, and then nothing has been drawn
            streams = copy.deepcopy(streams)
        fresh = dynamics.draw_initial_state(self.world, [streams[index] for index in chosen], estimates)
        if fresh.any_diverged:
            raise ValueError(f"own gradients at the initial estimates must be within ±{RANGE_LIMIT:g}: start closer")
        return ResetResult(streams, fresh, np.ones(self.num_envs, dtype=np.bool_) if mask is None else mask)

    def begin(self, drawn: ResetResult) -> State:
        """Start the episodes that were drawn."""
        self._streams, state, mask = drawn
        if not mask.all():
            state = dynamics.merge(self.current, state, mask)
        self._state = state
        self._reward.reset(state)
        return state

    def _seeded(self, chosen: IntArray, seeds: Sequence[int | None]) -> list[RandomStreams]:
        """The generators of all environments, new ones for those among ``chosen`` that have a seed."""
        if len(seeds) != self.num_envs:
            raise ValueError(f"{self.num_envs} environments need as many seeds, got {len(seeds)}")
        streams = list(self._streams) or [RandomStreams.from_seed(seed) for seed in seeds]
        for index in chosen.tolist():
            if seeds[index] is not None:
                streams[index] = RandomStreams.from_seed(seeds[index])
        return streams

    @property
    def is_compiled(self) -> bool:
        """Whether the next step will be compiled, if all environments are in range."""
        return self._fused is not None and fused.kernels() is not None

    def clip(self, actions: npt.NDArray[np.floating]) -> Clipped:
        """Clip actions; as :meth:`Encoder.clip`, of any number of environments."""
        if self._fused is not None and self._fused.accepts(actions):
            return Clipped(actions, np.zeros(actions.shape[:2], dtype=np.int64))
        return self.encoder.clip(actions)

    def step(
        self,
        actions: npt.NDArray[np.floating],
        restart: ResetResult | None = None,
        out: Float32Array | None = None,
        *,
        has_constants: bool = False,
        are_inside: bool = True,
    ) -> StepResult:
        """Hold all players' inputs for one step.

        Args:
            actions: shape (B, N, action size).
            restart: the start of environments that start afresh instead of moving: their rewards are 0.
            out: where a compiled step writes the observations, (B, N, size) and C-contiguous; numpy makes the step if
                it is left out.
            has_constants: whether ``out`` has held observations of this simulation before.
            are_inside: whether the actions are known to be finite and within the action box (see :meth:`clip`); they
                are clipped otherwise.

        Raises:
            RuntimeError: before the first reset.
            NonFiniteActionError: when an action that has to be clipped holds NaN or infinity; nothing is stepped.
        """
        compiled, moved, clipped = self._fused, None, None
        if compiled is not None and out is not None:
            moved = compiled.move(self._state, actions, out, has_constants=has_constants, are_inside=are_inside)
        if moved is None and not are_inside:
            actions, clipped = self.encoder.clip(actions)
            if compiled is not None and out is not None:
                moved = compiled.move(self._state, actions, out, has_constants=has_constants)
        if moved is None:
            began, before = perf_counter(), self.current
            self._state = state = dynamics.step(self.world, before, self.encoder.inputs(actions, before))
            terms = self._reward.step(state)
            instants, terminated, diverged = state.step, dynamics.is_over(self.world, state), state.diverged
            if compiled is not None and not fused.spend(perf_counter() - began):
                self._fused = None
        else:
            self._state = None
            instants, distance, terminated = moved
            diverged = self._never
            terms = self._reward.advance(distance, self.current if self._reward.needs_state else None)
        truncated = self._never if self.max_cycles is None else ~terminated & (instants >= self.max_cycles)
        if restart is not None:
            self.begin(restart)
            moves = ~restart.mask
            terms = {name: np.where(moves, term, 0.0) for name, term in terms.items()}
            terminated, truncated, diverged = terminated & moves, truncated & moves, diverged & moves
        is_observed = moved is not None and restart is None
        total, is_success = self._reward.total(terms), self.succeeded()
        return StepResult(total, terms, terminated, truncated, diverged, is_success, is_observed, clipped)

    def observe(self, out: Float32Array | None = None) -> Float32Array:
        """Observations of all players, shape (B, N, size), float32, owned by the caller."""
        return self.encoder.observe(self.current, out)

    def succeeded(self) -> BoolArray:
        """Whether each environment is within 0.5 % of the equilibrium in all estimates and in range, shape (B,)."""
        return distances.succeeded(self._reward.distances)
