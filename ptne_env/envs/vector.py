"""The vector environment: B environments of N players in one call, arrays in and out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ptne_env.arrays import BoolArray, Float32Array, FloatArray, IntArray, as_plain, require_count, require_mask
from ptne_env.catalogue import get_scenario
from ptne_env.envs.core import ResetResult, Simulation, StepResult, player_encoder
from ptne_env.observation import ActionMode, GraphKnowledge, Interface, InterfaceKind, ObservationLayout
from ptne_env.random_streams import require_seed
from ptne_env.scenario import Scenario
from ptne_env.world import RANGE_LIMIT, World

BLOCK_SIZE = 2048
"""Largest number of environments in a block: beyond it the calls of a block cost little beside its arithmetic."""

BLOCK_ENTRIES = 300_000
"""Largest number of observed entries in a block, so that its arrays fit into a core's cache."""


class VectorStep(NamedTuple):
    """The result of :meth:`VectorParallelEnv.step`. Arrays are C-contiguous and owned by the caller.

    Attributes:
        observations: shape (B, N, size), float32.
        rewards: shape (B, N), float64.
        terminated: shape (B,).
        truncated: shape (B,).
        infos: ``diverged`` (B,), ``clipped`` (B, N), ``reward_terms`` by name (B, N), and ``is_success`` (B,), which is
            False for an environment that goes on.
    """

    observations: Float32Array
    rewards: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    infos: dict[str, Any]


class VectorParallelEnv:
    """B environments × N players.

    No environment resets itself: an environment that is over starts again with ``reset(mask=...)`` before the next
    step. Each environment equals a :class:`~ptne_env.NashSeekingEnv` of the same seed, bit for bit.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B.
        interface, action_mode, action_scale, own_payoff, graph_knowledge, reward, max_cycles: as in
            :func:`ptne_env.parallel_env`.
        **overrides: fields of the scenario to change.

    Attributes:
        scenario: the physics.
        num_envs: B.
        num_players: N.
        single_observation_space: of one player.
        single_action_space: of one player.

    Raises:
        ValueError: for an unknown name or field, or an invalid value.
    """

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        interface: InterfaceKind = "physical",
        action_mode: ActionMode = "input",
        action_scale: float = 5.0,
        own_payoff: bool = False,
        graph_knowledge: GraphKnowledge = "links",
        reward: str | Mapping[str, float] = "digits",
        max_cycles: int | None = None,
        **overrides: Any,
    ) -> None:
        self.scenario = get_scenario(scenario, **overrides)
        self.num_envs = require_count("num_envs", num_envs, 1)

        seen = Interface(interface, action_mode, action_scale, own_payoff, graph_knowledge=graph_knowledge)
        encoder = player_encoder(World(self.scenario), seen)
        self.layout: ObservationLayout = encoder.layout
        self.num_players = self.layout.num_players
        largest = max(1, min(BLOCK_SIZE, BLOCK_ENTRIES // (self.num_players * self.layout.size)))
        size = -(-self.num_envs // -(-self.num_envs // largest))  # blocks of about the same size
        starts = range(0, self.num_envs, size)
        self._slices = [slice(start, min(start + size, self.num_envs)) for start in starts]
        self._blocks = [
            Simulation(
                encoder.with_shared_tables(),
                reward=reward,
                max_cycles=max_cycles,
                num_envs=part.stop - part.start,
            )
            for part in self._slices
        ]
        self.single_observation_space: spaces.Box = self.layout.observation_space()
        self.single_action_space: spaces.Box = self.layout.action_space()
        self._over = np.ones(self.num_envs, dtype=np.bool_)

    @property
    def max_cycles(self) -> int | None:
        """Steps after which an episode is truncated; may be set at any time."""
        return self._blocks[0].max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        for block in self._blocks:
            block.max_cycles = value

    def reset(
        self,
        seed: int | Sequence[int | None] | None = None,
        mask: npt.ArrayLike | None = None,
        estimates: npt.ArrayLike | None = None,
    ) -> Float32Array:
        """Start episodes.

        Args:
            seed: one per environment, or S for S, S + 1, …; ``None`` continues the present generators.
            mask: whether each environment starts afresh, shape (B,), bool; all if left out.
            estimates: initial estimates instead of drawn ones, shape (N, n) for all or (B, N, n), row i being x^i(0).

        Returns:
            Observations of all environments, shape (B, N, size), float32, owned by the caller.

        Raises:
            ValueError: for an invalid seed, a wrong number of seeds, a mask of another shape or dtype, a mask that
                leaves some out of the first reset, or estimates of another shape or out of range; no environment is
                touched.
        """
        seeds = self._seeds(seed)
        everyone = np.ones(self.num_envs, dtype=np.bool_)
        chosen = everyone if mask is None else require_mask("a reset mask", mask, self.num_envs)
        if self._blocks[0].state is None and not chosen.all():
            raise ValueError("the first reset() starts every environment: leave out the mask")
        given = None if estimates is None else self._estimates(estimates)
        observations = self._empty_observations()
        drawn = self._draw(chosen, seeds, given)  # refusals come before any block has started
        for block, part, start in zip(self._blocks, self._slices, drawn, strict=True):
            if start is not None:
                block.begin(start)
            block.observe(observations[part])
        self._over = self._over & ~chosen
        return observations

    def step(self, actions: npt.NDArray[np.floating], restart: BoolArray | None = None) -> VectorStep:
        """Hold all players' inputs for one step.

        Args:
            actions: finite floats of shape (B, N, action size); entries outside the box are clipped and counted.
            restart: environments that start afresh in this step instead of moving, shape (B,): their actions are
                ignored, their observations are the first ones and their rewards 0. None if left out.

        Raises:
            RuntimeError: when an environment is over, or was never reset.
            ValueError: when the actions have another shape or dtype, or are masked or not finite, or ``restart`` is no
                mask; no environment is stepped.
        """
        if restart is not None:
            restart = require_mask("a restart mask", restart, self.num_envs)
        halted = self._over if restart is None else self._over & ~restart
        if halted.any():
            over = np.flatnonzero(halted)
            raise RuntimeError(
                f"{over.size} of {self.num_envs} environments are over or not started (the first is {over[0]}): call "
                "reset(mask=...) before step()"
            )
        actions = as_plain("actions", actions)
        shape = (self.num_envs, self.num_players, self.layout.action_size)
        if actions.shape != shape or actions.dtype.kind != "f":
            raise ValueError(f"actions are floats of shape {shape}, got {actions.dtype} of shape {actions.shape}")
        actions, clipped = self._blocks[0].encoder.clip(
            actions
        )  # refuses non-finite numbers before any block has moved
        drawn: Sequence[ResetResult | None] = [None] * len(self._blocks)
        if restart is not None:
            clipped[restart] = 0
            drawn = self._draw(restart)
        observations = self._empty_observations()
        outcomes = [
            block.step(actions[part], start, observations[part])
            for block, part, start in zip(self._blocks, self._slices, drawn, strict=True)
        ]
        return self._assemble(observations, outcomes, clipped)

    def _draw(
        self, chosen: BoolArray, seeds: list[int | None] | None = None, estimates: FloatArray | None = None
    ) -> list[ResetResult | None]:
        """The start of the chosen environments, block by block; ``None`` for a block that has none."""
        return [
            block.draw(
                None if seeds is None else seeds[part],
                chosen[part],
                None if estimates is None else estimates[:, :, part][:, :, chosen[part]],
            )
            if chosen[part].any()
            else None
            for block, part in zip(self._blocks, self._slices, strict=True)
        ]

    def _assemble(self, observations: Float32Array, outcomes: list[StepResult], clipped: IntArray) -> VectorStep:
        terminated = np.concatenate([outcome.terminated for outcome in outcomes])
        truncated = np.concatenate([outcome.truncated for outcome in outcomes])
        self._over = terminated | truncated
        success = np.zeros(self.num_envs, dtype=np.bool_)
        if self._over.any():
            for block, part in zip(self._blocks, self._slices, strict=True):
                success[part] = self._over[part] & block.succeeded()
        terms = {name: self._by_env([outcome.terms[name].T for outcome in outcomes]) for name in outcomes[0].terms}
        infos = {
            "diverged": np.concatenate([block.current.diverged for block in self._blocks]),
            "clipped": clipped,
            "reward_terms": terms,
            "is_success": success,
        }
        first = next(iter(terms))
        if outcomes[0].rewards is outcomes[0].terms[first]:  # one term of weight 1, the usual case: transposed already
            rewards = terms[first].copy()
        else:
            rewards = self._by_env([outcome.rewards.T for outcome in outcomes])
        return VectorStep(observations, rewards, terminated, truncated, infos)

    def _by_env(self, parts: list[FloatArray]) -> FloatArray:
        """The blocks' arrays in one, shape (B, N), C-contiguous whatever the parts are."""
        return np.concatenate(parts, out=np.empty((self.num_envs, self.num_players)))

    def _empty_observations(self) -> Float32Array:
        return np.empty((self.num_envs, self.num_players, self.layout.size), dtype=np.float32)

    def _estimates(self, estimates: npt.ArrayLike) -> FloatArray:
        """Initial estimates with environments last, (n, N, B)."""
        try:
            table = as_plain("initial estimates", estimates).astype(np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"initial estimates are an (N, n) or (B, N, n) table of numbers: {error}") from error
        shape = (self.num_envs, self.num_players, self.layout.dimension)
        if table.shape not in (shape, shape[1:]):
            raise ValueError(f"initial estimates have the shape (N, n) = {shape[1:]} or {shape}, got {table.shape}")
        if not np.all(np.abs(table) <= RANGE_LIMIT):
            raise ValueError(f"initial estimates must be finite and within ±{RANGE_LIMIT:g}")
        return np.moveaxis(np.broadcast_to(table, shape), 0, 2).swapaxes(0, 1)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (str, bytes, bytearray, memoryview)):
            raise ValueError(f"seeds are a whole number or {self.num_envs} of them, got {type(seed).__name__} {seed!r}")
        if not isinstance(seed, (Sequence, np.ndarray)):
            first = require_seed(seed)
            return [first + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{self.num_envs} environments need as many seeds, got {len(seed)}")
        return [None if each is None else require_seed(each) for each in seed]
