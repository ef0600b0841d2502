"""The Gymnasium environments: all players as one agent, for centralised control and single-agent libraries.

A joint observation holds the observations of the players one after the other, a joint action holds their actions, and
the reward is the mean over players. Registered as ``ptne/<scenario>-joint-v0``::

    env = gymnasium.make("ptne_env:ptne/energy-joint-v0")
    envs = gymnasium.make_vec("ptne_env:ptne/energy-joint-v0", num_envs=64)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ptne_env.envs.parallel import NashSeekingEnv
from ptne_env.envs.simulation import require_options
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, as_plain, ordered_sum
from ptne_env.world.scenario import Scenario

_FLAGS = ("diverged", "is_success")
"""The infos that all players of an environment share."""


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean over players, the last axis, in an order that does not depend on the size of the batch."""
    return ordered_sum(values, axis=-1) / values.shape[-1]


def _join_players(infos: dict[str, Any]) -> dict[str, Any]:
    """Return infos of players, the last axis, as those of one agent: clipped entries are summed, rewards averaged."""
    return {
        name: values if name in _FLAGS else values.sum(axis=-1) if name == "clipped" else _mean(values)
        for name, values in infos.items()
    }


def _joint_info(infos: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the info of the agent that acts for all players."""
    first, *_ = players = list(infos.values())
    return _join_players(
        {name: np.array(first[name] if name in _FLAGS else [info[name] for info in players]) for name in first}
    )


def _add_masks(infos: dict[str, Any], present: BoolArray) -> dict[str, Any]:
    """Return infos as Gymnasium's vectors have them, each with a mask ``_name`` of the environments that have it."""
    masked: dict[str, Any] = {}
    for name, values in infos.items():
        masked |= {name: np.where(present, values, np.zeros_like(values)), f"_{name}": present.copy()}
    return masked


def _join_boxes(space: spaces.Box, players: int) -> Any:
    return spaces.Box(np.tile(space.low, players), np.tile(space.high, players), dtype=np.float32)


def _forward(wrapped: str, *names: str) -> tuple[Any, ...]:
    """Return properties that are attributes of the wrapped environment."""
    return tuple(property(attrgetter(f"{wrapped}.{name}"), doc=f"See ``{wrapped}``.") for name in names)


class _HasReadableSpec:
    """An environment whose spec holds data in place of parts, scenarios and interfaces, so that JSON has it all."""

    scenario: Scenario
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The spec with which Gymnasium made the environment, if it did."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            parts = {name: getattr(self.scenario, name, value) for name, value in spec.kwargs.items()}
            arguments = {name: getattr(value, "to_dict", lambda value=value: value)() for name, value in parts.items()}
            spec = replace(spec, kwargs=arguments)
        self._spec = spec


class JointEnv(_HasReadableSpec, gymnasium.Env[Float32Array, Float32Array]):
    """One environment with one agent that acts for all players; arguments are those of :func:`ptne_env.parallel_env`.

    The info has the same keys and dtypes after a reset and after every step: those of
    :class:`~ptne_env.NashSeekingEnv`, with ``clipped`` summed over players and ``reward_<term>`` averaged. ``diverged``
    and ``is_success`` are arrays of shape (), because Gymnasium's vectors give numpy scalars the dtype object.

    Episodes do not draw from ``np_random``, because each source of randomness has its own generator.

    Attributes:
        parallel: the wrapped environment, whose true state is this one's: ``estimates``, ``strategies``,
            ``nash_equilibrium``, ``time``, ``state``, ``get_state`` and ``set_state``.
        layout: the layout of each player's part of observations and actions.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["human", "rgb_array"],
        "render_fps": 30,
    }

    estimates, strategies, nash_equilibrium, time, state, get_state, set_state = _forward(
        "parallel", "estimates", "strategies", "nash_equilibrium", "time", "state", "get_state", "set_state"
    )

    def __init__(
        self, scenario: str | Scenario = "energy", *, render_mode: str | None = None, **arguments: Any
    ) -> None:
        self.parallel = NashSeekingEnv(scenario, render_mode=render_mode, **arguments)
        self.scenario = self.parallel.scenario
        self.layout = self.parallel.layout
        self.render_mode = render_mode
        players = len(self.parallel.possible_agents)
        self.observation_space = _join_boxes(self.layout.observation_space(), players)
        self.action_space = _join_boxes(self.layout.action_space(), players)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start an episode; see :meth:`ptne_env.NashSeekingEnv.reset`."""
        observations, infos = self.parallel.reset(seed, options)
        super().reset(seed=seed)
        return np.concatenate(list(observations.values())), _joint_info(infos)

    def step(self, action: Float32Array) -> tuple[Float32Array, float, bool, bool, dict[str, Any]]:
        """Hold all players' inputs for one step.

        Raises:
            RuntimeError: before the first reset and after the end of an episode.
            ValueError: when the action has a wrong shape or dtype, or is not finite; the state stays as it was.
        """
        joint = as_plain("a joint action", action)
        if joint.shape != self.action_space.shape:
            raise ValueError(f"a joint action has the shape {self.action_space.shape}, got {joint.shape}")
        agents = self.parallel.possible_agents
        actions = dict(zip(agents, joint.reshape(len(agents), -1), strict=True))
        observations, rewards, terminations, truncations, infos = self.parallel.step(actions)
        reward = float(_mean(np.array(list(rewards.values()))))
        ends = terminations[agents[0]], truncations[agents[0]]
        return np.concatenate(list(observations.values())), reward, *ends, _joint_info(infos)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """See :meth:`ptne_env.NashSeekingEnv.render`."""
        return self.parallel.render()

    def close(self) -> None:
        """Close the window, if one is open."""
        self.parallel.close()


class JointVectorEnv(_HasReadableSpec, gymnasium.vector.VectorEnv[Float32Array, Float32Array, npt.NDArray[Any]]):
    """B environments with one agent each, stepped together, for ``gymnasium.make_vec``.

    Infos hold arrays of shape (B,) of the entries of :class:`JointEnv`'s info, each with a mask ``_name`` of the
    environments that have it: those that were reset, or all of them after a step.

    Args:
        scenario: a name, as for :func:`ptne_env.get_scenario`, or a scenario.
        num_envs: B.
        autoreset_mode: when an environment that has ended starts again: in the ``NEXT_STEP`` (default), in the
            ``SAME_STEP`` (``final_obs`` and ``final_info`` hold the last observation and info), or, with ``DISABLED``,
            on ``reset(options={"reset_mask": mask})``.
        render_mode: ``None``, because a vector of environments does not render.
        **arguments: those of :class:`~ptne_env.envs.vector.VectorParallelEnv`, among them fields of the scenario.

    Attributes:
        vector: the wrapped environments, whose true state is this one's: ``estimates``, ``strategies``,
            ``nash_equilibria``, ``time``, ``get_state`` and ``set_state``.
        layout: the layout of each player's part of observations and actions.
    """

    estimates, strategies, nash_equilibria, time, get_state, set_state = _forward(
        "vector", "estimates", "strategies", "nash_equilibria", "time", "get_state", "set_state"
    )

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        if render_mode is not None:
            raise ValueError(
                f"environments that are stepped together do not render, got render_mode={render_mode!r}: leave it out, "
                "or step them one by one, with gymnasium.make_vec(…, vectorization_mode='sync')"
            )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**JointEnv.metadata, "render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.vector = VectorParallelEnv(scenario, num_envs, **arguments)
        self.scenario = self.vector.scenario
        self.layout = self.vector.layout
        self.num_envs = self.vector.num_envs
        self.render_mode = None
        players = self.vector.num_players
        self.single_observation_space = _join_boxes(self.vector.single_observation_space, players)
        self.single_action_space = _join_boxes(self.vector.single_action_space, players)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: S for S, S + 1, …, or a seed per environment.
            options: ``{"reset_mask": mask}`` starts only the environments in the mask, shape (B,), bool;
                ``{"estimates": table}`` starts from these estimates, shape (N, n) for all or (B, N, n).

        Raises:
            ValueError: for a wrong number of seeds, estimates of another shape, or a mask that has another shape or
                dtype or names no environment.
        """
        values = require_options(options, "estimates", "reset_mask")
        mask = values.get("reset_mask")
        if mask is not None and not np.any(mask):
            raise ValueError("options['reset_mask'] must name at least one environment to reset")
        observations, infos = self.vector.reset(seed, mask, values.get("estimates"))
        started = np.ones(self.num_envs, dtype=np.bool_) if mask is None else np.asarray(mask)
        return self._joint(observations), _add_masks(_join_players(infos), started)

    def step(self, actions: Float32Array) -> tuple[Float32Array, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Step all environments, and reset as the autoreset mode says.

        Raises:
            RuntimeError: before the first reset, or with ``DISABLED`` when an environment that has ended was not reset.
            ValueError: when the actions have another shape or dtype, or are not finite.
        """
        actions = as_plain("joint actions", actions)
        if actions.shape != self.action_space.shape:
            raise ValueError(f"joint actions have the shape {self.action_space.shape}, got {actions.shape}")
        actions = actions.reshape(self.num_envs, self.vector.num_players, -1)
        restart = self.vector.over if self.autoreset_mode is AutoresetMode.NEXT_STEP else None
        outcome = self.vector.step(actions, restart)
        observations, infos, final = self._joint(outcome.observations), _join_players(outcome.infos), {}
        over = outcome.terminated | outcome.truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            final_observations = np.full(self.num_envs, None, dtype=object)
            for index in np.flatnonzero(over):
                final_observations[index] = observations[index].copy()
            final = {"final_obs": final_observations, "final_info": _add_masks(infos, over)}
            final |= {f"_{name}": over.copy() for name in final}
            fresh, first = self.vector.reset(mask=over)
            observations, first = self._joint(fresh), _join_players(first)
            infos = {name: np.where(over, first[name], values) for name, values in infos.items()}
        infos = {**final, **_add_masks(infos, np.ones_like(over))}
        return observations, _mean(outcome.rewards), outcome.terminated, outcome.truncated, infos

    def _joint(self, observations: Float32Array) -> Float32Array:
        return observations.reshape(self.num_envs, -1)
