"""The simulation behind every adapter: B environments of one world and one interface, with rewards and endings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from inspect import Parameter, signature
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import InterfaceKind
from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray, as_plain, require_count
from ptne_env.shared.names import suggestion
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import distances, dynamics
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import Reward, RewardChoice
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World


class StepResult(NamedTuple):
    """The result of a step, whose arrays may be shared; entries as in :class:`~ptne_env.envs.vector.VectorStep`.

    Environments are last, (N, B) or (B,), except in ``clipped``, (B, N). ``terms`` holds each reward term, unweighted.
    """

    rewards: FloatArray
    terms: dict[str, FloatArray]
    terminated: BoolArray
    truncated: BoolArray
    diverged: BoolArray
    is_success: BoolArray
    clipped: IntArray


class EpisodeStart(NamedTuple):
    """Random generators of all environments, the state of those in ``mask`` (B,), which start, and the mask."""

    streams: list[RandomStreams]
    state: State
    mask: BoolArray


def override_fields(scenario: str | Scenario, overrides: Mapping[str, Any], make: Callable[..., Any]) -> Scenario:
    """Return the scenario of an environment, with the fields that were given to its constructor, ``make``.

    Raises:
        TypeError: for a keyword that is not a field, naming similar ones, or all where none is similar.
        ValueError: for an unknown name, or an invalid value.
    """
    own = [name for name, argument in signature(make).parameters.items() if argument.kind is not Parameter.VAR_KEYWORD]
    known = [*own, "players", *(field.name for field in fields(Scenario))]
    for keyword in overrides:
        if keyword not in known:  # TorchRL reads the first half of the message
            problem = f"the environment got an unexpected keyword argument {keyword!r}"
            raise TypeError(f"{problem}; {suggestion(keyword, known)}")
    return get_scenario(scenario, **overrides)


def player_encoder(world: World, interface: InterfaceKind | Interface | Mapping[str, Any]) -> Encoder:
    """Return the encoder of an environment, which shows no more than players see, for an interface or its JSON object.

    Raises:
        ValueError: for an unknown interface, and for one with a field that players lack, such as ``full``.
    """
    encoder = Encoder(world, Interface.from_dict(interface) if isinstance(interface, Mapping) else interface)
    if encoder.layout.interface.is_privileged:
        raise ValueError(
            f"{encoder.layout.interface} shows information that players lack, and is only for oracles in evaluations; "
            "choose 'scaled' or 'physical'"
        )
    return encoder


def require_options(options: Any, *known: str) -> Mapping[str, Any]:
    """Return the options of a reset, a dictionary with ``known`` keys; its key ``options`` is ignored.

    Raises:
        TypeError: when the options are not a dictionary.
        ValueError: for an unknown key.
    """
    if not isinstance(options, Mapping | None):
        raise TypeError(f"reset options are a dictionary, such as {{'estimates': table}}, got {options!r}")
    for key in options or ():
        if key not in (*known, "options"):  # which PettingZoo's conformance tests pass
            raise ValueError(f"unknown reset option {key!r}; choose from {', '.join(known)}")
    return options or {}


def read_estimates(layout: ObservationLayout, num_envs: int, estimates: npt.ArrayLike) -> FloatArray:
    """Return a caller's table of initial estimates as a read-only array of shape (n, N, B).

    The table has the shape (N, n), for all of B environments, or (B, N, n), row i being x^i(0).

    Raises:
        ValueError: for another shape, or for entries that are not numbers.
    """
    try:
        table = as_plain("initial estimates", estimates).astype(np.float64, casting="same_kind")
    except (TypeError, ValueError) as error:
        raise ValueError(f"initial estimates are an (N, n) or (B, N, n) table of numbers: {error}") from error
    shape = (num_envs, layout.num_players, layout.dimension)
    if table.shape not in (shape, shape[1:]):
        raise ValueError(f"initial estimates have the shape (N, n) = {shape[1:]} or {shape}, got {table.shape}")
    return np.broadcast_to(table, shape).transpose(2, 1, 0)


class Simulation:
    """B environments that are stepped together and reset one by one; arguments as in :class:`~ptne_env.NashSeekingEnv`.

    Attributes:
        encoder: the encoder of observations and actions.
        world: the world of the encoder, which is simulated.
        num_envs: B.
        max_cycles: the number of steps after which an episode is truncated, or ``None``.
        reward_names: the names of the reward terms in infos.

    Raises:
        ValueError: for an unknown reward or a count below 1.
    """

    def __init__(
        self, encoder: Encoder, *, reward: RewardChoice = "digits", max_cycles: int | None = None, num_envs: int = 1
    ) -> None:
        self.encoder, self.world = encoder, encoder.world
        self.num_envs = num_envs
        self.max_cycles = None if max_cycles is None else require_count("max_cycles", max_cycles, 1)
        self._reward = Reward(self.world, reward)
        self.reward_names = [f"reward_{name}" for name in self._reward.weights]
        self._never = np.zeros(self.num_envs, dtype=np.bool_)
        self._never.flags.writeable = False
        self._streams: list[RandomStreams] = []
        self.state: State | None = None

    @property
    def current(self) -> State:
        """The state now.

        Raises:
            RuntimeError: before the first reset.
        """
        if self.state is None:
            raise RuntimeError("the environment has no state yet: call reset() first")
        return self.state

    def set_state(self, state: State) -> None:
        """Continue from a state of as many environments; the random generators stay as they are.

        Raises:
            ValueError: as :func:`ptne_env.world.dynamics.restore`; the state stays as it was.
        """
        self.state = dynamics.restore(self.world, state, self.num_envs)
        self._reward.reset(self.state)

    @property
    def nash_equilibria(self) -> FloatArray:
        """The equilibria x* of the games that are played, shape (n, B).

        Raises:
            RuntimeError: before the first reset, where the scenario draws games.
        """
        game = self.world.game if self.state is None and not self.world.has_random_game else self.current.game
        return np.broadcast_to(game.nash_equilibria, (game.dimension, self.num_envs))

    def draw(
        self,
        seeds: Sequence[int | None] | None = None,
        mask: BoolArray | None = None,
        estimates: FloatArray | None = None,
    ) -> EpisodeStart:
        """Draw the start of episodes, which :meth:`begin` starts.

        Args:
            seeds: a seed per environment, or ``None`` to continue its generators. Only those in ``mask`` count.
            mask: whether each environment starts, shape (B,); all if left out.
            estimates: the initial estimates in place of drawn ones, shape (n, N, environments in ``mask``).

        Raises:
            ValueError: for an invalid seed or estimates, or a drawn game that is not strongly monotone.
        """
        mask = np.ones(self.num_envs, dtype=np.bool_) if mask is None else mask
        starting = np.flatnonzero(mask).tolist()
        seeds = seeds or [None] * self.num_envs
        streams = list(self._streams) or [RandomStreams.from_seed(seed) for seed in seeds]
        for index in starting:
            if seeds[index] is not None:
                streams[index] = RandomStreams.from_seed(seeds[index])
        if estimates is not None:  # they may be refused, and then nothing has been drawn
            streams = copy.deepcopy(streams)
        fresh = dynamics.draw_initial_state(self.world, [streams[index] for index in starting], estimates)
        return EpisodeStart(streams, fresh, mask)

    def begin(self, start: EpisodeStart) -> None:
        """Start the episodes that were drawn; the first start includes every environment."""
        self._streams, state, mask = start
        self.state = state if mask.all() else dynamics.merge(self.current, state, mask)
        self._reward.reset(self.state)

    def step(
        self, actions: npt.NDArray[np.floating], out: Float32Array, restart: EpisodeStart | None = None
    ) -> StepResult:
        """Hold all players' inputs for one step.

        Args:
            actions: the actions, shape (B, N, action size); entries beyond the limits are clipped and counted.
            out: the array for the observations, shape (B, N, size), float32 and C-contiguous.
            restart: the start of environments that start instead of moving, and whose rewards are 0.

        Raises:
            RuntimeError: before the first reset.
            NonFiniteActionError: when an action holds NaN or infinity; nothing is stepped.
        """
        before, (actions, clipped) = self.current, self.encoder.clip(actions)
        self.state = state = dynamics.step(self.world, before, self.encoder.inputs(actions, before))
        terms = self._reward.step(state)
        terminated, diverged = dynamics.is_over(self.world, state), state.diverged
        truncated = self._never if self.max_cycles is None else ~terminated & (state.step >= self.max_cycles)
        if restart is not None:
            self.begin(restart)
            moves = ~restart.mask
            terms = {name: np.where(moves, term, 0.0) for name, term in terms.items()}
            terminated, truncated, diverged = terminated & moves, truncated & moves, diverged & moves
        self.encoder.observe(self.state, out)
        total, is_success = self._reward.total(terms), self.is_success()
        return StepResult(total, terms, terminated, truncated, diverged, is_success, clipped)

    def observe(self, out: Float32Array | None = None) -> Float32Array:
        """Return the observations of all players, shape (B, N, size), float32, owned by the caller."""
        return self.encoder.observe(self.current, out)

    def is_success(self) -> BoolArray:
        """Return whether each environment is in range and all its estimates within 0.5 % of x*, shape (B,)."""
        return distances.is_success(self._reward.distances)
