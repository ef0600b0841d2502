"""Stable-Baselines3: every player of B environments as one of its environments, all with one policy.

Needs the extra ``pip install "ptne-env[sb3]"``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from inspect import getmembers
from itertools import pairwise
from time import time
from typing import Any

import numpy as np
from gymnasium import spaces

try:
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
except ImportError as error:  # pragma: no cover - exercised in an environment without the extra
    raise ImportError('the Stable-Baselines3 adapter needs an extra: pip install "ptne-env[sb3]"') from error

from ptne_env.envs.simulation import Duplicable
from ptne_env.envs.vector import VectorParallelEnv, VectorStep, member_actions
from ptne_env.perception.observation import InterfaceKind, ObservationLayout
from ptne_env.perception.observation_forms import FormName, Shown, make_form
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.world.scenario import Scenario

Indices = int | Iterable[int] | None


class _Monitored(Duplicable, VecMonitor):
    """A ``VecMonitor``, so that Stable-Baselines3 asks for no other; another around it does no harm.

    Attributes of the wrapped ``VecEnv``, such as ``layout``, are found here too.
    """

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles leave out the members of the class, which a ``VecEnvWrapper`` keeps: some have no copy."""
        return {name: value for name, value in vars(self).items() if name != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy or pickle."""
        vars(self).update(state, class_attributes=dict(getmembers(type(self))))

    def step_wait(self) -> VecEnvStepReturn:
        """Step; infos of members that end hold ``episode``: return ``r``, length ``l`` and seconds ``t``."""
        observations, rewards, dones, infos = self.venv.step_wait()
        self.episode_returns += rewards
        self.episode_lengths += 1
        if np.count_nonzero(dones):  # the loop of VecMonitor is over all members in every step
            seconds = round(time() - self.t_start, 6)
            for member in np.flatnonzero(dones).tolist():
                total, length = self.episode_returns[member], self.episode_lengths[member]
                infos[member]["episode"] = {"r": total, "l": length, "t": seconds}
            self.episode_count += int(np.count_nonzero(dones))
            self.episode_returns[dones], self.episode_lengths[dones] = 0, 0
        return observations, rewards, dones, infos


class PlayerVecEnv(_Monitored):
    """A Stable-Baselines3 ``VecEnv`` of B·N members, one for every player of every environment.

    Member b·N + i is player i of environment b. All members share one policy, and the observation holds the player's
    one-hot. Environments are reset in the step that ends them; then ``infos`` of their members hold
    ``terminal_observation``, ``TimeLimit.truncated``, ``episode`` (as a ``VecMonitor`` gives it, so none is needed) and
    the entries of :class:`~ptne_env.NashSeekingEnv`'s infos. Of a step that ends nothing the infos are empty, because a
    dictionary per member and term would cost more than the step; the same empty ones are returned in every step, until
    the caller writes into one of them.

    The environments are one object: ``get_attr`` and ``set_attr`` reach its attributes, and ``env_method`` calls a
    method once and returns the answer for each requested member.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B, environments; the ``num_envs`` of the VecEnv is B·N.
        interface: ``"scaled"`` or ``"physical"``.
        seed: of the first reset; environment b gets seed + b.
        observation: ``"flat"``, or ``"padded-graph"``: a Dict, for ``MultiInputPolicy`` with a features extractor; see
            :mod:`ptne_env.perception.observation_forms`.
        **arguments: of :class:`~ptne_env.envs.vector.VectorParallelEnv`: reward, max_cycles
            and fields of the scenario.

    Attributes:
        vector: the environments.
        layout: of observations and actions.

    Raises:
        TypeError: for an unknown keyword, naming similar ones, or all.
        ValueError: for an unknown name, or an invalid value.
    """

    vector: VectorParallelEnv
    layout: ObservationLayout

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        interface: InterfaceKind = "scaled",
        seed: int | None = None,
        observation: FormName = "flat",
        **arguments: Any,
    ) -> None:
        super().__init__(
            _Players(scenario, num_envs, interface=interface, seed=seed, observation=observation, **arguments)
        )


class _Players(VecEnv):
    """The members of a :class:`PlayerVecEnv`, without statistics of episodes."""

    def __init__(
        self,
        scenario: str | Scenario,
        num_envs: int,
        *,
        interface: InterfaceKind,
        seed: int | None,
        observation: FormName,
        **arguments: Any,
    ) -> None:
        if observation == "graph":
            raise ValueError("Stable-Baselines3 takes no Graph: choose observation='flat' or 'padded-graph'")
        self.vector = VectorParallelEnv(scenario, num_envs, interface=interface, **arguments)
        self.layout = self.vector.layout
        self._form = make_form(observation, self.layout)
        self.render_mode: str | None = None
        self._players = self.vector.num_players
        self._actions = np.empty(0)
        super().__init__(
            self.vector.num_envs * self._players,
            self._form.space(),
            self.vector.single_action_space,
        )
        # Of the members that go on, in every step: to make 320 dictionaries takes as long as to step 64 environments.
        self._empty = self._new_infos()
        if seed is not None:
            self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset: environment b gets seed + b, which all its members report."""
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        self._seeds = [seed + member // self._players for member in range(self.num_envs)]
        return self._seeds

    def reset(self) -> Shown:
        """Start all episodes; observations of shape (B·N, size)."""
        observations = self.vector.reset(self._seeds[:: self._players])
        self.reset_infos = self._new_infos()
        self._reset_seeds()
        self._reset_options()
        return self._shown(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions, shape (B·N, action size)."""
        self._actions = actions

    def step_wait(self) -> tuple[Shown, Float32Array, BoolArray, list[dict[str, Any]]]:
        """Step, and reset the environments that ended.

        Raises:
            RuntimeError: before the first reset.
            ValueError: when the actions have another shape or dtype, or are not finite; no environment is stepped.
        """
        outcome = self.vector.step(member_actions(self.vector, self._actions))
        over = outcome.terminated | outcome.truncated
        dones = np.zeros(self.num_envs, dtype=np.bool_)
        if any(self._empty):  # the caller wrote into one
            self._empty = self._new_infos()
        infos = self._empty.copy()
        observations = outcome.observations
        if np.count_nonzero(over):
            self._finish(outcome, over, infos)
            observations = self.vector.reset(mask=over)
            dones = np.repeat(over, self._players)
        rewards = outcome.rewards.reshape(-1).astype(np.float32)
        return self._shown(observations), rewards, dones, infos

    def _finish(self, outcome: VectorStep, over: BoolArray, infos: list[dict[str, Any]]) -> None:
        of_infos = outcome.infos.items()
        for env in np.flatnonzero(over).tolist():
            for player in range(self._players):
                infos[env * self._players + player] = {
                    "terminal_observation": self._form.show(outcome.observations[env, player].copy()),
                    "TimeLimit.truncated": bool(outcome.truncated[env]),
                    **{name: each[env] if each.ndim == 1 else each[env, player] for name, each in of_infos},
                }

    def _new_infos(self) -> list[dict[str, Any]]:
        """An empty dictionary for every member."""
        return [{} for _ in range(self.num_envs)]

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """The attribute, once per requested member."""
        return [self._find(attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set the attribute of the environments, which are one object; ``indices`` must be all members.

        Raises:
            ValueError: when only some members are named.
        """
        if self._count(indices) != self.num_envs:
            raise ValueError("the members share one environment object: an attribute is set for all of them or none")
        setattr(self if hasattr(self, attr_name) else self.vector, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call the method once; its answer, once per requested member."""
        return [self._find(method_name)(*method_args, **method_kwargs)] * self._count(indices)

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:  # noqa: ARG002
        """No member is wrapped."""
        return [False] * self._count(indices)

    def _find(self, name: str) -> Any:
        return getattr(self, name) if name == "render_mode" else getattr(self.vector, name)

    def _count(self, indices: Indices) -> int:
        return len(list(self._get_indices(indices)))

    def _shown(self, observations: Float32Array) -> Shown:
        return self._form.show(observations.reshape(self.num_envs, -1))


class MixedPlayerVecEnv(_Monitored):
    """The members of several :class:`PlayerVecEnv`, one after the other, as one ``VecEnv``.

    Args:
        parts: of the same observation and action sizes; each seeds itself from the seed of the whole.

    Attributes:
        parts: as given.
        layout: of the first part; names of slices and sizes are those of all.

    Raises:
        ValueError: without parts, or when a policy for one of them could not act in another.
    """

    parts: list[PlayerVecEnv]
    layout: ObservationLayout

    def __init__(self, parts: Sequence[PlayerVecEnv]) -> None:
        super().__init__(_Mixture(parts))


class _Mixture(VecEnv):
    """The members of a :class:`MixedPlayerVecEnv`, without statistics of episodes."""

    def __init__(self, parts: Sequence[PlayerVecEnv]) -> None:
        if not parts:
            raise ValueError("a mixture needs at least one part")
        self.parts = list(parts)
        self.layout: ObservationLayout = parts[0].layout
        for part in parts[1:]:
            if (part.layout.slices, part.layout.interface) != (self.layout.slices, self.layout.interface) or (
                part.action_space != parts[0].action_space
            ):
                raise ValueError(
                    "no policy of one layout can act in both "
                    f"{parts[0].vector.scenario.name!r} and {part.vector.scenario.name!r}: their layouts differ; a "
                    "policy without sizes can (docs/learning.md)"
                )
        boxes = [part.observation_space for part in parts]
        low = np.min([box.low for box in boxes if isinstance(box, spaces.Box)], axis=0)
        high = np.max([box.high for box in boxes if isinstance(box, spaces.Box)], axis=0)
        sizes = [part.num_envs for part in parts]
        self._slices = [slice(*ends) for ends in pairwise(np.cumsum([0, *sizes]).tolist())]
        self.render_mode: str | None = None
        super().__init__(sum(sizes), spaces.Box(low, high, dtype=np.float32), parts[0].action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset: the parts get seeds of their own, drawn from this one."""
        children = np.random.SeedSequence(seed).generate_state(len(self.parts)).tolist()
        self._seeds = [each for part, child in zip(self.parts, children, strict=True) for each in part.seed(child)]
        return self._seeds

    def reset(self) -> Float32Array:
        """Start all episodes; observations of shape (members, size)."""
        observations = np.concatenate([part.reset() for part in self.parts])
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions, shape (members, action size)."""
        for part, own in zip(self.parts, self._slices, strict=True):
            part.step_async(actions[own])

    def step_wait(self) -> tuple[Float32Array, Float32Array, BoolArray, list[dict[str, Any]]]:
        """Step every part; see :meth:`PlayerVecEnv.step_wait`."""
        observations, rewards, dones, infos = zip(*(part.step_wait() for part in self.parts), strict=True)
        together = [info for part in infos for info in part]
        return np.concatenate(observations), np.concatenate(rewards), np.concatenate(dones), together

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """The attribute of each requested member."""
        values = [value for part in self.parts for value in part.get_attr(attr_name)]
        return [values[index] for index in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set the attribute of all environments; see :meth:`PlayerVecEnv.set_attr`."""
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError("the members share environment objects: an attribute is set for all of them or none")
        for part in self.parts:
            part.set_attr(attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call the method of every part once; the answer for each requested member."""
        calls = (part.env_method(method_name, *method_args, **method_kwargs) for part in self.parts)
        answers = [answer for call in calls for answer in call]
        return [answers[index] for index in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:  # noqa: ARG002
        """No member is wrapped."""
        return [False] * len(list(self._get_indices(indices)))
