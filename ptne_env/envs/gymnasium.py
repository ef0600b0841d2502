"""Gymnasium: all players as one agent, for centralised control and for every single-agent library.

A joint observation is the players' observations one after the other, or their graph; a joint action is their actions
one after the other; the reward is the mean over players. Registered as ``ptne/<scenario>-joint-v0``::

    env = gymnasium.make("ptne_env:ptne/energy-joint-v0")
    envs = gymnasium.make_vec("ptne_env:ptne/energy-joint-v0", num_envs=64)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ptne_env.arrays import BoolArray, Float32Array, FloatArray, as_plain, ordered_sum
from ptne_env.envs.parallel import NashSeekingEnv, parallel_env
from ptne_env.envs.vector import VectorParallelEnv, VectorStep, member_actions
from ptne_env.observation import ObservationLayout
from ptne_env.observation_forms import FormName, Shown, make_form
from ptne_env.scenario import Scenario


def _mean(values: FloatArray) -> FloatArray:
    """Over players, the last axis, in an order that does not depend on the size of the batch."""
    return ordered_sum(values, axis=-1) / values.shape[-1]


def _tiled(space: spaces.Box, players: int) -> Any:
    return spaces.Box(np.tile(space.low, players), np.tile(space.high, players), dtype=np.float32)


class JointEnv(gymnasium.Env[Shown, Float32Array]):
    """One environment, one agent that acts for all players; the arguments are those of :func:`ptne_env.parallel_env`.

    Info after a step: ``diverged``, ``clipped`` (summed over players), ``reward_terms`` (means over players) and, at
    the end, ``is_success``.

    Attributes:
        parallel: the wrapped environment.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["human", "rgb_array"],
        "render_fps": 30,
    }

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        *,
        render_mode: str | None = None,
        observation: FormName = "flat",
        **arguments: Any,
    ) -> None:
        self.parallel: NashSeekingEnv = parallel_env(scenario, render_mode=render_mode, **arguments)
        self.render_mode = render_mode
        players = self.parallel.possible_agents
        self._form = make_form(observation, self.parallel.layout, joint=True)
        self.observation_space = self._form.space()
        self.action_space = _tiled(self.parallel.action_space(players[0]), len(players))

    @property
    def layout(self) -> ObservationLayout:
        """The layout of each player's part of observations and actions."""
        return self.parallel.layout

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Shown, dict[str, Any]]:
        """Start an episode; see :meth:`ptne_env.NashSeekingEnv.reset`."""
        super().reset(seed=seed)
        observations, _ = self.parallel.reset(seed, options)
        return self._joint(observations), {}

    def step(self, action: Float32Array) -> tuple[Shown, float, bool, bool, dict[str, Any]]:
        """Hold all players' inputs for one step.

        Raises:
            RuntimeError: before the first reset and after the end of an episode.
            ValueError: when the action has a wrong shape or dtype, or is not finite; the state stays as it was.
        """
        joint = as_plain("a joint action", action)
        if joint.shape != self.action_space.shape:
            raise ValueError(f"a joint action has the shape {self.action_space.shape}, got {joint.shape}")
        agents = self.parallel.agents
        rows = joint.reshape(len(self.parallel.possible_agents), -1)
        observations, rewards, terminations, truncations, infos = self.parallel.step(
            dict(zip(agents, rows, strict=False))
        )
        first = infos[agents[0]]
        info = {
            **first,
            "clipped": sum(info["clipped"] for info in infos.values()),
            "reward_terms": {
                name: float(_mean(np.array([info["reward_terms"][name] for info in infos.values()])))
                for name in first["reward_terms"]
            },
        }
        return (
            self._joint(observations),
            float(_mean(np.array(list(rewards.values())))),
            terminations[agents[0]],
            truncations[agents[0]],
            info,
        )

    def _joint(self, observations: dict[str, Float32Array]) -> Shown:
        return self._form.show(np.concatenate(list(observations.values())))

    def render(self) -> npt.NDArray[np.uint8] | None:
        """See :meth:`ptne_env.NashSeekingEnv.render`."""
        return self.parallel.render()

    def close(self) -> None:
        """Close the window, if one is open."""
        self.parallel.close()


class JointVectorEnv(gymnasium.vector.VectorEnv[Float32Array, Float32Array, npt.NDArray[Any]]):
    """B environments, one agent in each, stepped together; for ``gymnasium.make_vec``.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B.
        autoreset_mode: when an environment that ended starts again: in the ``NEXT_STEP`` (default), in the
            ``SAME_STEP`` (the last observation and info are in ``final_obs`` and ``final_info``), or on
            ``reset(options={"reset_mask": mask})`` (``DISABLED``).
        render_mode: ``None``; a vector of environments does not render.
        **arguments: of :class:`~ptne_env.envs.vector.VectorParallelEnv`: interface, action_mode, action_scale, reward,
            max_cycles and fields of the scenario.

    Attributes:
        vector: the wrapped environments.
    """

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
            raise ValueError("the vector environment does not render; make one environment with a render_mode")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**JointEnv.metadata, "render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.vector = VectorParallelEnv(scenario, num_envs, **arguments)
        self.num_envs = self.vector.num_envs
        self.render_mode = None
        players = self.vector.num_players
        self.single_observation_space = _tiled(self.vector.single_observation_space, players)
        self.single_action_space = _tiled(self.vector.single_action_space, players)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def layout(self) -> ObservationLayout:
        """The layout of each player's part of observations and actions."""
        return self.vector.layout

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: S for S, S + 1, …, or one per environment.
            options: ``{"reset_mask": mask}`` starts only the environments in the mask, shape (B,), bool;
                ``{"estimates": table}`` starts from the given estimates, shape (N, n) for all or (B, N, n).

        Raises:
            ValueError: for a wrong number of seeds, estimates of another shape, or a mask of another shape or dtype or
                without a True.
        """
        options = options or {}
        mask = options.get("reset_mask")
        if mask is not None and not np.any(mask):
            raise ValueError("options['reset_mask'] must name at least one environment to reset")
        observations = self.vector.reset(seed, mask, options.get("estimates"))
        self._over = np.zeros_like(self._over) if mask is None else self._over & ~np.asarray(mask)
        return self._joint(observations), {}

    def step(self, actions: Float32Array) -> tuple[Float32Array, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Step all environments and reset as the autoreset mode says.

        Raises:
            RuntimeError: before the first reset, or in mode ``DISABLED`` when an environment that ended was not reset.
            ValueError: when the actions have another shape or dtype, or are not finite.
        """
        actions = as_plain("joint actions", actions)
        if actions.shape != self.action_space.shape:
            raise ValueError(f"joint actions have the shape {self.action_space.shape}, got {actions.shape}")
        actions = actions.reshape(self.num_envs, self.vector.num_players, -1)
        restart = self._over if self.autoreset_mode is AutoresetMode.NEXT_STEP else None
        outcome = self.vector.step(actions, restart)
        observations = self._joint(outcome.observations)
        moved = np.ones(self.num_envs, dtype=np.bool_) if restart is None else ~restart
        infos = self._infos(outcome, moved)
        over = outcome.terminated | outcome.truncated
        self._over = over
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            final_observations = np.full(self.num_envs, None, dtype=object)
            for index in np.flatnonzero(over):
                final_observations[index] = observations[index].copy()
            infos = {
                "final_obs": final_observations,
                "_final_obs": over.copy(),
                "final_info": self._infos(outcome, over),
                "_final_info": over.copy(),
                **self._infos(outcome, moved & ~over),
            }
            observations = self._joint(self.vector.reset(mask=over))
            self._over = np.zeros_like(over)
        return observations, _mean(outcome.rewards), outcome.terminated, outcome.truncated, infos

    def _joint(self, observations: Float32Array) -> Float32Array:
        return observations.reshape(self.num_envs, -1)

    def _infos(self, outcome: VectorStep, present: BoolArray) -> dict[str, Any]:
        """Gymnasium's dictionary of arrays, each with a mask ``_name`` of the environments that have it."""
        over = present & (outcome.terminated | outcome.truncated)
        terms = {name: np.where(present, _mean(term), 0.0) for name, term in outcome.infos["reward_terms"].items()}
        return {
            "diverged": outcome.infos["diverged"] & present,
            "_diverged": present.copy(),
            "clipped": np.where(present, outcome.infos["clipped"].sum(axis=1), 0),
            "_clipped": present.copy(),
            "reward_terms": {**terms, **{f"_{name}": present.copy() for name in terms}},
            "_reward_terms": present.copy(),
            "is_success": outcome.infos["is_success"] & over,
            "_is_success": over,
        }


class PlayerVectorEnv(gymnasium.vector.VectorEnv[Float32Array, Float32Array, npt.NDArray[Any]]):
    """Every player of B environments as one of B·N environments, all with one policy; RLlib's single-agent runner.

    Member b·N + i is player i of environment b, and the observation holds the player's one-hot. Members of an
    environment end together and start again in the next step, which ignores their actions and has the reward 0
    (``NEXT_STEP``). Infos of members that end: ``diverged`` and ``is_success``; there are no others.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B, environments; the ``num_envs`` of the vector is B·N.
        **arguments: of :class:`~ptne_env.envs.vector.VectorParallelEnv`: interface, action_mode, action_scale, reward,
            max_cycles, threads and fields of the scenario.

    Attributes:
        vector: the wrapped environments.

    Raises:
        ValueError: for an unknown name or field, or an invalid value.
    """

    def __init__(self, scenario: str | Scenario = "energy", num_envs: int = 1, **arguments: Any) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.vector = VectorParallelEnv(scenario, num_envs, **arguments)
        self.num_envs = self.vector.num_envs * self.vector.num_players
        self.single_observation_space = self.vector.single_observation_space
        self.single_action_space = self.vector.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._over = np.zeros(self.vector.num_envs, dtype=np.bool_)

    @property
    def layout(self) -> ObservationLayout:
        """The layout of observations and actions."""
        return self.vector.layout

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002 - Gymnasium's signature
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start all episodes; ``seed`` is S for S, S + 1, …, or one per environment.

        Raises:
            ValueError: for an invalid seed or a wrong number of seeds.
        """
        observations = self.vector.reset(seed)
        self._over = np.zeros_like(self._over)
        return observations.reshape(self.num_envs, -1), {}

    def step(self, actions: Float32Array) -> tuple[Float32Array, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Step all environments, and start those again that ended in the step before.

        Raises:
            RuntimeError: before the first reset.
            ValueError: when the actions have another shape or dtype, or are not finite; no environment is stepped.
        """
        players = self.vector.num_players
        outcome = self.vector.step(member_actions(self.vector, actions), self._over)
        self._over = outcome.terminated | outcome.truncated
        infos: dict[str, Any] = {}
        if self._over.any():
            for name in ("diverged", "is_success"):
                infos |= {name: outcome.infos[name].repeat(players), f"_{name}": self._over.repeat(players)}
        return (
            outcome.observations.reshape(self.num_envs, -1),
            outcome.rewards.reshape(self.num_envs),
            outcome.terminated.repeat(players),
            outcome.truncated.repeat(players),
            infos,
        )
