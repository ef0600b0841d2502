"""The vector environment: B environments of N players in one call, arrays in and out."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from numpy.ma import MaskedArray

from ptne_env.envs.simulation import Duplicable, ResetResult, Simulation, StepResult, changed_scenario, player_encoder
from ptne_env.perception.observation import Interface, InterfaceKind, ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray, as_plain, require_count, require_mask
from ptne_env.shared.random_streams import require_seed
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import RANGE_LIMIT, World

BLOCK_SIZE = 2048
"""Largest number of environments in a block: beyond it the calls of a block cost little beside its arithmetic."""

BLOCK_ENTRIES = 300_000
"""Largest number of observed entries in a block, so that its arrays fit into a core's cache."""


_REMEMBERED_BUFFERS = 10_000
"""Largest number of buffers whose constant slices an environment remembers to have written."""


class VectorBuffers(NamedTuple):
    """Arrays of the caller that a step or reset writes; ``None`` for a new array. C-contiguous and apart in memory.

    Attributes:
        observations: shape (B, N, size), float32. Slices that never change (``player``) are written once, as long as
            the array, or the array that it is a view of, exists: nothing else may write into them, such as another
            environment whose buffers are in the same memory.
        rewards: shape (B, N), float64 or float32; a reset leaves them as they are.
        terminated: shape (B,), bool; likewise.
        truncated: shape (B,), bool; likewise.
    """

    observations: Float32Array | None = None
    rewards: FloatArray | Float32Array | None = None
    terminated: BoolArray | None = None
    truncated: BoolArray | None = None


class VectorStep(NamedTuple):
    """The result of :meth:`VectorParallelEnv.step`. Arrays are C-contiguous and owned by the caller.

    Attributes:
        observations: shape (B, N, size), float32.
        rewards: shape (B, N), float64, or as the caller's buffer.
        terminated: shape (B,).
        truncated: shape (B,).
        infos: ``diverged`` (B,), bool; ``clipped`` (B, N), int64, entries beyond the limits; ``is_success`` (B,), bool,
            whether the relative distance of all estimates is now at most 0.5 %; and each reward term, unweighted, such
            as ``reward_digits`` (B, N), float64.
    """

    observations: Float32Array
    rewards: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    infos: dict[str, Any]


class VectorParallelEnv(Duplicable):
    """B environments × N players.

    No environment resets itself: an environment that is over starts again with ``reset(mask=...)`` before the next
    step. Each environment equals a :class:`~ptne_env.NashSeekingEnv` of the same seed, bit for bit.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B.
        interface, reward, max_cycles: as in
            :func:`ptne_env.parallel_env`.
        threads: that step blocks of environments side by side; the numbers do not depend on it. A second thread pays
            from several thousand environments on.
        **overrides: fields of the scenario to change.

    Attributes:
        scenario: the physics.
        num_envs: B.
        threads: as given.
        num_players: N.
        reward_names: the names of the reward terms in infos.
        single_observation_space: of one player.
        single_action_space: of one player.

    Raises:
        TypeError: for an unknown keyword, naming similar ones, or all.
        ValueError: for an unknown name, or an invalid value.
    """

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        interface: InterfaceKind = "scaled",
        reward: str | Mapping[str, float] = "digits",
        max_cycles: int | None = None,
        threads: int = 1,
        **overrides: Any,
    ) -> None:
        self.scenario = changed_scenario(scenario, overrides, VectorParallelEnv)
        self.num_envs = require_count("num_envs", num_envs, 1)
        self.threads = require_count("threads", threads, 1)

        seen = Interface(interface)
        encoder = player_encoder(World(self.scenario), seen)
        self.layout: ObservationLayout = encoder.layout
        self.num_players = self.layout.num_players
        largest = max(1, min(BLOCK_SIZE, BLOCK_ENTRIES // (self.num_players * self.layout.size)))
        count = -(-self.num_envs // largest)
        count = -(-count // self.threads) * self.threads  # each thread has as many
        size = -(-self.num_envs // count)  # blocks of about the same size
        starts = range(0, self.num_envs, size)
        self._slices = [slice(start, min(start + size, self.num_envs)) for start in starts]
        self._blocks = [
            Simulation(
                encoder.with_shared_tables(own_workspaces=self.threads > 1),
                reward=reward,
                max_cycles=max_cycles,
                num_envs=part.stop - part.start,
            )
            for part in self._slices
        ]
        self.reward_names = self._blocks[0].reward_names
        self.single_observation_space: spaces.Box = self.layout.observation_space()
        self.single_action_space: spaces.Box = self.layout.action_space()
        self._over = np.ones(self.num_envs, dtype=np.bool_)
        single, double, flag = map(np.dtype, (np.float32, np.float64, np.bool_))
        batch, players = self.num_envs, self.num_players
        self._results: tuple[tuple[str, tuple[int, ...], tuple[np.dtype[Any], ...]], ...] = (
            ("out.observations", (batch, players, self.layout.size), (single,)),
            ("out.rewards", (batch, players), (double, single)),
            ("out.terminated", (batch,), (flag,)),
            ("out.truncated", (batch,), (flag,)),
        )
        self._pool: tuple[int, ThreadPoolExecutor] | None = None
        self._apart: VectorBuffers | None = None  # the last buffers, which are known to share no memory
        self._written: dict[int, weakref.ref[Float32Array]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles have no threads, and have not written into any buffer."""
        return {**self.__dict__, "_pool": None, "_apart": None, "_written": {}}

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
        out: VectorBuffers | None = None,
    ) -> Float32Array:
        """Start episodes.

        Args:
            seed: one per environment, or S for S, S + 1, …; ``None`` continues the present generators.
            mask: whether each environment starts afresh, shape (B,), bool; all if left out.
            estimates: initial estimates instead of drawn ones, shape (N, n) for all or (B, N, n), row i being x^i(0).
            out: the caller's buffers, of which ``observations`` is written; a new array if left out.

        Returns:
            Observations of all environments, shape (B, N, size), float32, owned by the caller.

        Raises:
            ValueError: for an invalid seed, a wrong number of seeds, a mask of another shape or dtype, a mask that
                leaves some out of the first reset, estimates of another shape or out of range, or buffers that do not
                fit; no environment is touched.
        """
        seeds = self._seeds(seed)
        everyone = np.ones(self.num_envs, dtype=np.bool_)
        chosen = everyone if mask is None else require_mask("a reset mask", mask, self.num_envs)
        if self._blocks[0].state is None and not chosen.all():
            raise ValueError("the first reset() starts every environment: leave out the mask")
        given = None if estimates is None else self._estimates(estimates)
        given_observations = self._checked(out).observations
        observations = self._new_observations() if given_observations is None else given_observations
        drawn = self._draw(chosen, seeds, given)  # refusals come before any block has started
        for block, part, start in zip(self._blocks, self._slices, drawn, strict=True):
            if start is not None:
                block.begin(start)
            block.observe(observations[part])
        self._over = self._over & ~chosen
        return observations

    def step(
        self,
        actions: npt.NDArray[np.floating],
        restart: BoolArray | None = None,
        out: VectorBuffers | None = None,
    ) -> VectorStep:
        """Hold all players' inputs for one step.

        Args:
            actions: finite numbers of shape (B, N, action size); entries beyond the limits are clipped and counted.
            restart: environments that start afresh in this step instead of moving, shape (B,): their actions are
                ignored and their rewards are 0; may be over.
            out: the caller's buffers; new arrays for those that are left out.

        Raises:
            RuntimeError: while an environment that is over, or has not started, is not in ``restart``.
            ValueError: for actions of another shape or dtype, a masked array, non-finite actions, or another kind of
                mask, or buffers of another shape, dtype or order, or that share memory; no environment is stepped.
        """
        if restart is not None:
            restart = require_mask("a restart mask", restart, self.num_envs).copy()
        halted = self._over if restart is None else self._over & ~restart
        if np.count_nonzero(halted):  # which takes a fifth of the time of any()
            over = np.flatnonzero(halted)
            raise RuntimeError(
                f"{over.size} of {self.num_envs} environments are over or not started (the first is {over[0]}): call "
                "reset(mask=...) before step()"
            )
        actions = as_plain("actions", actions)
        shape = (self.num_envs, self.num_players, self.layout.action_size)
        if actions.shape != shape or actions.dtype.kind not in "fiu":
            raise ValueError(f"actions are numbers of shape {shape}, got {actions.dtype} of shape {actions.shape}")
        if actions.dtype.kind != "f":
            actions = actions.astype(np.float64)
        given = self._checked(out)
        if out is not None and any(array is not None and np.may_share_memory(actions, array) for array in given):
            actions = actions.copy()
        actions, clipped = self._blocks[0].clip(actions)  # refuses non-finite numbers before any block has moved
        drawn: Sequence[ResetResult | None] = [None] * len(self._blocks)
        if restart is not None:
            clipped[restart] = 0
            drawn = self._draw(restart)
        outcomes, observations = self._move(actions, drawn, given.observations)
        rewards = self._by_env([outcome.rewards.T for outcome in outcomes], given.rewards)
        terminated = np.concatenate([outcome.terminated for outcome in outcomes], out=given.terminated)
        truncated = np.concatenate([outcome.truncated for outcome in outcomes], out=given.truncated)
        self._over = terminated | truncated
        infos = self._infos(rewards, outcomes, clipped)
        return VectorStep(observations, rewards, terminated, truncated, infos)

    def _move(
        self, actions: npt.NDArray[np.floating], drawn: Sequence[ResetResult | None], observations: Float32Array | None
    ) -> tuple[list[StepResult], Float32Array]:
        """Step every block; the observations are written into the caller's array, if it is given."""
        given = observations
        has_constants = given is not None and self._holds_constants(given)
        if observations is None and (self.threads > 1 or self._blocks[0].is_compiled):
            observations = self._new_observations()

        def move(index: int) -> StepResult:
            block, part = self._blocks[index], self._slices[index]
            if observations is None:
                return block.step(actions[part], drawn[index])
            outcome = block.step(actions[part], drawn[index], observations[part], has_constants=has_constants)
            if not outcome.is_observed:
                block.observe(observations[part])
            return outcome

        outcomes = self._side_by_side(move)
        if given is not None and not has_constants:
            self._remember(given)
        if observations is None:  # only here, because before the step it would cost page faults and cache
            observations = self._new_observations()
            for block, part in zip(self._blocks, self._slices, strict=True):
                block.observe(observations[part])
        return outcomes, observations

    def _checked(self, out: VectorBuffers | None) -> VectorBuffers:
        """The buffers of the caller, which fit.

        Raises:
            ValueError: when one of them does not fit, or two share memory.
        """
        if out is None:
            return VectorBuffers()
        if not isinstance(out, VectorBuffers):
            raise ValueError(f"out is a VectorBuffers, got a {type(out).__name__}")
        spans = []
        for array, (name, shape, dtypes) in zip(out, self._results, strict=True):
            if array is not None:
                require_buffer(name, array, shape, dtypes)
                if out is not self._apart:
                    spans.append((_address(array), array.nbytes, name))
        for (start, size, name), (following, _, other) in pairwise(sorted(spans)):
            if start + size > following:
                raise ValueError(f"{name} and {other} share memory: each needs its own")
        self._apart = out
        return out

    def _new_observations(self) -> Float32Array:
        return np.empty((self.num_envs, self.num_players, self.layout.size), dtype=np.float32)

    def _holds_constants(self, observations: Float32Array) -> bool:
        """Whether a buffer holds the constant slices, because an earlier step wrote them."""
        root = self._written.get(_address(observations))
        return root is not None and root() is _root(observations)

    def _remember(self, observations: Float32Array) -> None:
        """From here on a buffer holds the constant slices, until its memory is freed."""
        if len(self._written) >= _REMEMBERED_BUFFERS:
            self._written.clear()
        self._written[_address(observations)] = weakref.ref(_root(observations))

    def _side_by_side(self, move: Callable[[int], StepResult]) -> list[StepResult]:
        """``move`` of the index of every block, on all threads."""
        indices = range(len(self._blocks))
        if self.threads == 1:
            return list(map(move, indices))
        if self._pool is None or self._pool[0] != os.getpid():  # a forked process has no threads
            self._pool = os.getpid(), ThreadPoolExecutor(self.threads)
        outcomes: dict[int, StepResult] = {}

        def share(first: int) -> None:
            outcomes.update((index, move(index)) for index in indices[first :: self.threads])

        others = [self._pool[1].submit(share, first) for first in indices[1 : self.threads]]
        try:
            share(0)
        finally:
            wait(others)
        for other in others:
            other.result()  # raises what its share has raised
        return [outcomes[index] for index in indices]

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

    def first_infos(self) -> dict[str, Any]:
        """The infos of environments that have just started, with the keys, shapes and dtypes of :class:`VectorStep`.

        Raises:
            RuntimeError: before the first reset.
        """
        batch, players = self.num_envs, self.num_players
        return {
            "diverged": np.zeros(batch, dtype=np.bool_),
            "clipped": np.zeros((batch, players), dtype=np.int64),
            "is_success": np.concatenate([block.succeeded() for block in self._blocks]),
            **{name: np.zeros((batch, players)) for name in self.reward_names},
        }

    def _infos(self, rewards: FloatArray, outcomes: list[StepResult], clipped: IntArray) -> dict[str, Any]:
        infos = {
            "diverged": np.concatenate([outcome.diverged for outcome in outcomes]),
            "clipped": clipped,
            "is_success": np.concatenate([outcome.is_success for outcome in outcomes]),
        }
        first, names = outcomes[0], self.reward_names
        if first.rewards is next(iter(first.terms.values())) and rewards.dtype == np.float64:
            infos[names[0]] = rewards.copy()  # one term of weight 1, transposed already
        else:
            for name, term in zip(names, first.terms, strict=True):
                infos[name] = self._by_env([outcome.terms[term].T for outcome in outcomes])
        return infos

    def _by_env(self, parts: list[FloatArray], out: npt.NDArray[Any] | None = None) -> FloatArray:
        """The blocks' arrays in one, shape (B, N), C-contiguous whatever the parts are."""
        out = np.empty((self.num_envs, self.num_players)) if out is None else out
        result: FloatArray = np.concatenate(parts, out=out)
        return result

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


def member_actions(vector: VectorParallelEnv, actions: Any, members: str = "members") -> npt.NDArray[Any]:
    """Actions of the players of all environments, one row each: (B·N, action size) to (B, N, action size).

    Args:
        vector: the environments; row b·N + i is player i of environment b.
        actions: of the caller.
        members: word for the players in the message.

    Raises:
        ValueError: when they have another shape, or are masked.
    """
    given, count = as_plain("actions", actions), vector.num_envs * vector.num_players
    shape = (count, vector.layout.action_size)
    if given.shape != shape:
        raise ValueError(f"actions of {count} {members} have the shape {shape}, got {given.shape}")
    return given.reshape(vector.num_envs, vector.num_players, -1)


def _root(array: Float32Array) -> Float32Array:
    """The array whose memory a view shows."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _address(array: npt.NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


def require_buffer(name: str, array: Any, shape: tuple[int, ...], dtypes: tuple[np.dtype[Any], ...]) -> None:
    """Check a buffer of the caller.

    Raises:
        ValueError: when it is no plain array, or its shape, dtype or order is another, or it is read-only.
    """
    if isinstance(array, np.ndarray) and not isinstance(array, MaskedArray):
        if array.shape == shape and array.dtype in dtypes and array.flags.carray:
            return
        order = "" if array.flags.c_contiguous else ", not contiguous"
        access = "" if array.flags.writeable else ", read-only"
        found = f"{array.dtype} of shape {array.shape}{order}{access}"
    else:
        found = f"a {type(array).__name__}"
    kinds = " or ".join(map(str, dtypes))
    raise ValueError(f"{name} is a C-contiguous array of {kinds} of shape {shape} that can be written, got {found}")
