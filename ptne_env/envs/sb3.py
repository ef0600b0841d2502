"""The Stable-Baselines3 environment: each player of B environments is one member, and all share one policy.

Needs the extra ``pip install "ptne-env[sb3]"``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from time import time
from typing import Any

import numpy as np
import numpy.typing as npt

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:  # pragma: no cover - exercised in an environment without the extra
    raise ImportError('the Stable-Baselines3 adapter needs an extra: pip install "ptne-env[sb3]"') from error

from ptne_env.envs.rendering import Renderer
from ptne_env.envs.simulation import require_options
from ptne_env.envs.vector import VectorParallelEnv, VectorStep
from ptne_env.shared.arrays import BoolArray, Float32Array, as_plain, require_count
from ptne_env.world.scenario import Scenario

Indices = int | Iterable[int] | None

TRUE_STATE = ("estimates", "strategies", "nash_equilibria", "time")
"""The attributes of which ``get_attr`` returns the row of each member's environment."""


class PlayerVecEnv(VecEnv):
    """A Stable-Baselines3 ``VecEnv`` of B·N members, one for every player of every environment.

    Member b·N + i is player i of environment b. All members share one policy, and observations name the player by a
    one-hot vector. Environments are reset in the step that ends them. The ``infos`` of their members then hold
    ``terminal_observation``, ``TimeLimit.truncated``, ``episode`` (return, length and seconds as from a ``Monitor``,
    which is not needed) and the entries of :class:`~ptne_env.NashSeekingEnv`'s infos; other infos are empty.

    The environments are one object: ``get_attr`` and ``set_attr`` reach its attributes, and ``env_method`` calls a
    method once and returns the answer for each requested member. Of the true state (:data:`TRUE_STATE`) ``get_attr``
    returns what concerns the member's environment, such as its ``estimates`` (N, n), in an array of its own.

    Args:
        scenario: a name, as for :func:`ptne_env.get_scenario`, or a scenario.
        num_envs: B, the number of environments; the ``num_envs`` of the VecEnv is B·N.
        seed: the seed of the first reset; environment b gets seed + b.
        render_mode: ``"rgb_array"`` for pictures of environment 0, as ``VecVideoRecorder`` takes them, or ``None``.
        **arguments: those of :class:`~ptne_env.envs.vector.VectorParallelEnv`, among them fields of the scenario.

    Attributes:
        vector: the environments.
        layout: the layout of observations and actions.
    """

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        seed: int | None = None,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"unknown render_mode {render_mode!r}; choose None or 'rgb_array'")
        self.vector = VectorParallelEnv(scenario, num_envs, **arguments)
        self.layout = self.vector.layout
        self.render_mode = render_mode
        self._pictured = self.vector._blocks[0]  # noqa: SLF001 - its first environment is number 0
        self._renderer = Renderer(self._pictured.encoder.world, render_mode) if render_mode else None
        self._players = self.vector.num_players
        self._actions = np.empty(0)
        self._began = time()
        super().__init__(
            self.vector.num_envs * self._players, self.vector.single_observation_space, self.vector.single_action_space
        )
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)
        if seed is not None:
            self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset with seed + b for environment b, and return the seed of each member."""
        first = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else require_count("a seed", seed, 0)
        self._seeds = [first + member // self._players for member in range(self.num_envs)]
        return self._seeds

    def set_options(self, options: Any = None) -> None:
        """Set the options of the next reset: ``{"estimates": table}``, shape (N, n) for all or (B, N, n), row i x^i(0).

        Raises:
            TypeError, ValueError: for something else than one dictionary with this key.
        """
        super().set_options(dict(require_options(options, "estimates")))

    def reset(self) -> Float32Array:
        """Start all episodes and return the observations, shape (B·N, size).

        Raises:
            ValueError: for estimates in the options of another shape or out of range; no environment is touched.
        """
        estimates = self._options[0].get("estimates")
        observations, _ = self.vector.reset(self._seeds[:: self._players], estimates=estimates)
        self._returns[:], self._lengths[:] = 0, 0
        self.reset_infos = [{} for _ in range(self.num_envs)]
        if self._renderer is not None:
            self._renderer.reset(self._pictured.current)
        self._reset_seeds()
        self._reset_options()
        return observations.reshape(self.num_envs, -1)

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions, shape (B·N, action size)."""
        self._actions = actions

    def step_wait(self) -> tuple[Float32Array, Float32Array, BoolArray, list[dict[str, Any]]]:
        """Step, and reset the environments whose episodes end.

        Raises:
            RuntimeError: before the first reset.
            ValueError: when the actions have another shape or dtype, or are not finite; no environment is stepped.
        """
        actions, shape = as_plain("actions", self._actions), (self.num_envs, self.layout.action_size)
        if actions.shape != shape:
            raise ValueError(f"actions of {self.num_envs} members have the shape {shape}, got {actions.shape}")
        outcome = self.vector.step(actions.reshape(self.vector.num_envs, self._players, -1))
        observations, over = outcome.observations, outcome.terminated | outcome.truncated
        dones = np.repeat(over, self._players)
        rewards = outcome.rewards.reshape(-1).astype(np.float32)
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if np.count_nonzero(over):
            for member in np.flatnonzero(dones).tolist():
                infos[member] = self._last_info(outcome, member)
            self._returns[dones], self._lengths[dones] = 0, 0
            observations, _ = self.vector.reset(mask=over)
        if self._renderer is not None:
            (self._renderer.reset if over[0] else self._renderer.record)(self._pictured.current)
        return observations.reshape(self.num_envs, -1), rewards, dones, infos

    def _last_info(self, outcome: VectorStep, member: int) -> dict[str, Any]:
        """Return the info of a member whose episode ends."""
        env, player = divmod(member, self._players)
        seconds = round(time() - self._began, 6)
        return {
            "terminal_observation": outcome.observations[env, player].copy(),
            "TimeLimit.truncated": bool(outcome.truncated[env]),
            "episode": {"r": float(self._returns[member]), "l": int(self._lengths[member]), "t": seconds},
            **{name: info[env] if info.ndim == 1 else info[env, player] for name, info in outcome.infos.items()},
        }

    def get_images(self) -> list[npt.NDArray[np.uint8] | None]:
        """Return the picture of environment 0, from which ``render`` of Stable-Baselines3 makes its own."""
        return [] if self._renderer is None else [self._renderer.draw()]

    def close(self) -> None:
        """Do nothing; there is nothing to release."""

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return the attribute once per requested member."""
        value, members = getattr(self._owner(attr_name), attr_name), list(self._get_indices(indices))
        if attr_name in TRUE_STATE:
            return [value[member // self._players].copy() for member in members]
        return [value] * len(members)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environments, which are one object; ``indices`` must name all members.

        Raises:
            ValueError: when only some members are named.
        """
        if self._count(indices) != self.num_envs:
            raise ValueError("the members share one environment object: an attribute is set for all of them or none")
        setattr(self._owner(attr_name), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call the method once and return its answer once per requested member."""
        return [getattr(self.vector, method_name)(*method_args, **method_kwargs)] * self._count(indices)

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Return whether the members report as this wrapper does, which is true of ``Monitor`` alone."""
        return [wrapper_class is Monitor] * self._count(indices)

    def _owner(self, name: str) -> Any:
        """Return the object that has the attribute."""
        return self if name == "render_mode" else self.vector

    def _count(self, indices: Indices) -> int:
        return len(list(self._get_indices(indices)))
