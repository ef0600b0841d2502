"""The vector environment: B environments of N players in one call, arrays in and out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ptne_env.envs.simulation import EpisodeStart, Simulation, override_fields, player_encoder, read_estimates
from ptne_env.perception.fields import InterfaceKind
from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, as_plain, require_count, require_mask
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import RewardChoice
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

BLOCK_SIZE = 2048
"""Largest number of environments in a block; with more of them, calls cost little beside the arithmetic."""

BLOCK_ENTRIES = 300_000
"""Largest number of observed entries in a block, whose arrays then fit into the cache of a core."""


class VectorStep(NamedTuple):
    """The result of :meth:`VectorParallelEnv.step`, in C-contiguous arrays that the caller owns.

    Attributes:
        observations: the observations, shape (B, N, size), float32.
        rewards: the rewards, shape (B, N), float64.
        terminated: whether each episode has ended, shape (B,).
        truncated: whether ``max_cycles`` cuts each episode, shape (B,).
        infos: ``diverged`` (B,), bool; ``clipped`` (B, N), int64, the number of entries beyond the limits;
            ``is_success`` (B,), bool, whether the relative distance of all estimates is now at most 0.5 %; and each
            reward term, unweighted, such as ``reward_digits`` (B, N), float64.
    """

    observations: Float32Array
    rewards: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    infos: dict[str, Any]


class VectorParallelEnv:
    """B environments of N players each.

    No environment resets itself: one that is over must be started again with ``reset(mask=...)`` before the next step.
    Each environment equals a :class:`~ptne_env.NashSeekingEnv` of the same seed, bit for bit.

    Args:
        scenario: a name, as for :func:`ptne_env.get_scenario`, or a scenario.
        num_envs: B.
        interface, reward, max_cycles: as in :func:`ptne_env.parallel_env`.
        **overrides: fields of the scenario to change.

    Attributes:
        scenario: the physics.
        num_envs: B.
        num_players: N.
        layout: the layout of observations and actions.
        reward_names: the names of the reward terms in infos.
        over: whether each environment must start again before the next step, shape (B,), never changed in place.
        single_observation_space: the space of one player's observation.
        single_action_space: the space of one player's action.

    Raises:
        TypeError, ValueError: as :func:`ptne_env.parallel_env`.
    """

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        interface: InterfaceKind | Interface = "scaled",
        reward: RewardChoice = "digits",
        max_cycles: int | None = None,
        **overrides: Any,
    ) -> None:
        self.scenario = override_fields(scenario, overrides, VectorParallelEnv)
        self.num_envs = require_count("num_envs", num_envs, 1)
        encoder = player_encoder(World(self.scenario), interface)
        self.layout: ObservationLayout = encoder.layout
        self.num_players = self.layout.num_players
        largest = max(1, min(BLOCK_SIZE, BLOCK_ENTRIES // (self.num_players * self.layout.size)))
        size = -(-self.num_envs // -(-self.num_envs // largest))  # blocks of about the same size
        starts = range(0, self.num_envs, size)
        self._slices = [slice(start, min(start + size, self.num_envs)) for start in starts]
        self._blocks = [
            Simulation(
                encoder.with_shared_tables(), reward=reward, max_cycles=max_cycles, num_envs=part.stop - part.start
            )
            for part in self._slices
        ]
        self.reward_names = self._blocks[0].reward_names
        self.single_observation_space: spaces.Box = self.layout.observation_space()
        self.single_action_space: spaces.Box = self.layout.action_space()
        self.over = np.ones(self.num_envs, dtype=np.bool_)

    @property
    def max_cycles(self) -> int | None:
        """The number of steps after which an episode is truncated, or ``None``."""
        return self._blocks[0].max_cycles

    @property
    def estimates(self) -> FloatArray:
        """The estimates of all players now, shape (B, N, n), row i of an environment being x^i."""
        return self._by_env([block.current.estimates for block in self._blocks])

    @property
    def strategies(self) -> FloatArray:
        """The strategies x now, shape (B, n)."""
        return self._by_env([dynamics.strategies(block.current) for block in self._blocks])

    @property
    def nash_equilibria(self) -> FloatArray:
        """The equilibria x* of the games that are played, shape (B, n).

        Raises:
            RuntimeError: before the first reset, where the scenario draws games.
        """
        return self._by_env([block.nash_equilibria for block in self._blocks])

    @property
    def time(self) -> FloatArray:
        """The time t now of each environment, in seconds, shape (B,)."""
        return self._by_env([block.world.clock.t[block.current.step] for block in self._blocks])

    def get_state(self) -> State:
        """Return the state now, environments last, in arrays of its own; as in :class:`~ptne_env.NashSeekingEnv`.

        Raises:
            RuntimeError: before the first reset.
        """
        return dynamics.concatenate([block.current for block in self._blocks])

    def set_state(self, state: State) -> None:
        """Continue all episodes from a state of B environments; as in :class:`~ptne_env.NashSeekingEnv`.

        Raises:
            ValueError: as :func:`ptne_env.world.dynamics.restore`; no environment is touched.
        """
        restored = dynamics.restore(self._blocks[0].world, state, self.num_envs)
        for block, part in zip(self._blocks, self._slices, strict=True):
            block.set_state(dynamics.select(restored, part))
        self.over = dynamics.is_over(self._blocks[0].world, restored)

    def reset(
        self,
        seed: int | Sequence[int | None] | None = None,
        mask: npt.ArrayLike | None = None,
        estimates: npt.ArrayLike | None = None,
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: a seed per environment, or S for S, S + 1, …; ``None`` continues the generators.
            mask: whether each environment starts, shape (B,), bool; all if left out.
            estimates: the initial estimates in place of drawn ones, shape (N, n) for all environments or (B, N, n), row
                i being x^i(0).

        Returns:
            The observations of all environments, shape (B, N, size), float32, owned by the caller, and the infos of
            :class:`VectorStep` as if all had just started.

        Raises:
            ValueError: for an invalid seed, a wrong number of seeds, a mask of another shape or dtype, a mask that
                leaves some out of the first reset, or estimates of another shape or out of range; no environment is
                touched.
        """
        seeds = self._seeds(seed)
        everyone = np.ones(self.num_envs, dtype=np.bool_)
        starts = everyone if mask is None else require_mask("a reset mask", mask, self.num_envs)
        if self._blocks[0].state is None and not starts.all():
            raise ValueError("the first reset() starts every environment: leave out the mask")
        drawn = self._draw(
            starts, seeds, None if estimates is None else read_estimates(self.layout, self.num_envs, estimates)
        )
        observations = self._new_observations()
        for block, part, start in zip(self._blocks, self._slices, drawn, strict=True):
            if start is not None:  # refusals came before any block has started
                block.begin(start)
            block.observe(observations[part])
        self.over = self.over & ~starts
        return observations, self._first_infos()

    def step(self, actions: npt.NDArray[np.floating], restart: BoolArray | None = None) -> VectorStep:
        """Hold all players' inputs for one step.

        Args:
            actions: finite numbers of shape (B, N, action size); entries beyond the limits are clipped and counted.
            restart: whether each environment starts in this step instead of moving, shape (B,). Such an environment may
                be over; its actions are ignored, and its rewards are 0.

        Raises:
            RuntimeError: when an environment that is over, or has not started, is not in ``restart``.
            ValueError: for actions of another shape or dtype, a masked array, non-finite actions, or another kind of
                mask; no environment is stepped.
        """
        if restart is not None:
            restart = require_mask("a restart mask", restart, self.num_envs).copy()
        halted = self.over if restart is None else self.over & ~restart
        if np.count_nonzero(halted):  # which takes a fifth of the time of any()
            over = np.flatnonzero(halted)
            raise RuntimeError(
                f"{over.size} of {self.num_envs} environments are over or not started (the first is {over[0]}): call "
                "reset() for them before the next step"
            )
        actions = as_plain("actions", actions)
        shape = (self.num_envs, self.num_players, self.layout.action_size)
        if actions.shape != shape or actions.dtype.kind not in "fiu":
            raise ValueError(f"actions are numbers of shape {shape}, got {actions.dtype} of shape {actions.shape}")
        if actions.dtype.kind != "f":
            actions = actions.astype(np.float64)
        if not np.isfinite(actions).all():  # before any block has moved
            env, player, _ = np.argwhere(~np.isfinite(actions))[0]
            raise ValueError(
                f"actions must be numbers without NaN or infinity; that of player_{player} in environment {env} is not"
            )
        drawn: Sequence[EpisodeStart | None] = [None] * len(self._blocks) if restart is None else self._draw(restart)
        observations = self._new_observations()
        outcomes = [
            block.step(actions[part], observations[part], start)
            for block, part, start in zip(self._blocks, self._slices, drawn, strict=True)
        ]
        rewards, terms, *arrays = zip(*outcomes, strict=True)
        terminated, truncated, diverged, is_success, clipped = map(np.concatenate, arrays)
        self.over = terminated | truncated
        if restart is not None:
            clipped[restart] = 0
        infos = {"diverged": diverged, "clipped": clipped, "is_success": is_success}
        for name, term in zip(self.reward_names, terms[0], strict=True):
            infos[name] = self._by_env([block[term] for block in terms])
        return VectorStep(observations, self._by_env(rewards), terminated, truncated, infos)

    def _first_infos(self) -> dict[str, Any]:
        """Return the infos of :class:`VectorStep` for environments that have just started."""
        batch, players = self.num_envs, self.num_players
        return {
            "diverged": np.zeros(batch, dtype=np.bool_),
            "clipped": np.zeros((batch, players), dtype=np.int64),
            "is_success": np.concatenate([block.is_success() for block in self._blocks]),
            **{name: np.zeros((batch, players)) for name in self.reward_names},
        }

    def _new_observations(self) -> Float32Array:
        return np.empty((self.num_envs, self.num_players, self.layout.size), dtype=np.float32)

    def _draw(
        self, starts: BoolArray, seeds: list[int | None] | None = None, estimates: FloatArray | None = None
    ) -> list[EpisodeStart | None]:
        """Draw the start of environments, block by block; ``None`` for a block in which none starts."""
        return [
            block.draw(
                None if seeds is None else seeds[part],
                starts[part],
                None if estimates is None else estimates[:, :, part][:, :, starts[part]],
            )
            if starts[part].any()
            else None
            for block, part in zip(self._blocks, self._slices, strict=True)
        ]

    def _by_env(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return the blocks' arrays, environments last, as one C-contiguous array with the axes in reverse order."""
        result = np.empty((self.num_envs, *parts[0].shape[-2::-1]))
        np.concatenate([part.T for part in parts], out=result)
        return result

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (str, bytes, bytearray, memoryview)):
            raise ValueError(f"seeds are a whole number or {self.num_envs} of them, got {type(seed).__name__} {seed!r}")
        if not isinstance(seed, (Sequence, np.ndarray)):
            first = require_count("a seed", seed, 0)
            return [first + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{self.num_envs} environments need as many seeds, got {len(seed)}")
        return [None if own is None else require_count("a seed", own, 0) for own in seed]
