"""PufferLib: every player of B environments as one agent, in arrays that the trainer owns.

Nothing here needs PufferLib. Where it asks for its own type, a class has both::

    class Players(PlayerBufferEnv, pufferlib.PufferEnv): ...
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import batch_space

from ptne_env.envs.vector import VectorBuffers, VectorParallelEnv, member_actions, require_buffer
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array, IntArray
from ptne_env.shared.random_streams import require_seed
from ptne_env.world.scenario import Scenario

Infos = list[dict[str, float]]
Step = tuple[Float32Array, Float32Array, BoolArray, BoolArray, Infos]


class PlayerBufferEnv:
    """B·N agents by the contract of PufferLib's ``PufferEnv``: what a step returns are always the same arrays.

    Agent b·N + i is player i of environment b. All agents share one policy, and the observation holds the player's
    one-hot. Environments are reset in the step that ends them: then ``terminals`` or ``truncations`` are True, rewards
    are the last ones, observations the first of the next episodes, and ``infos`` holds one dictionary with the shares
    of the ended environments that were a success and that diverged.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B.
        buf: arrays of the caller, C-contiguous and apart in memory: ``observations`` (B·N, size), float32; ``rewards``
            (B·N,), float32; ``terminals``, ``truncations`` and ``masks`` (B·N,), bool; ``actions`` (B·N, action size),
            float32, which is only kept. New arrays if left out.
        seed: of the first reset.
        **arguments: of :class:`~ptne_env.envs.vector.VectorParallelEnv`: interface, reward,
            max_cycles, threads and fields of the scenario.

    Attributes:
        vector: the environments.
        num_agents: B·N.
        agent_ids: 0, …, B·N − 1.
        single_observation_space: of one player.
        single_action_space: of one player.
        observation_space: of all agents.
        action_space: of all agents.
        observations, rewards, terminals, truncations, masks, actions: the arrays; all masks are True.
        infos: of the last step.

    Raises:
        TypeError: for an unknown keyword, naming similar ones, or all.
        ValueError: for an unknown name, an invalid value, or arrays that are missing or do not fit.
    """

    emulated = False
    """PufferLib asks whether it has to translate spaces."""
    done = False
    """PufferLib asks whether it has to reset."""

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        buf: Mapping[str, npt.NDArray[Any]] | None = None,
        seed: int | None = None,
        **arguments: Any,
    ) -> None:
        self.vector = VectorParallelEnv(scenario, num_envs, **arguments)
        self.num_agents = self.vector.num_envs * self.vector.num_players
        self.agent_ids = np.arange(self.num_agents)
        self.single_observation_space = self.vector.single_observation_space
        self.single_action_space = self.vector.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_agents)
        self.action_space = batch_space(self.single_action_space, self.num_agents)
        self.infos: Infos = []
        self._seed = None if seed is None else require_seed(seed)

        kinds = {
            "observations": (self.single_observation_space.shape, np.float32),
            "rewards": ((), np.float32),
            "terminals": ((), np.bool_),
            "truncations": ((), np.bool_),
            "masks": ((), np.bool_),
            "actions": (self.single_action_space.shape, np.float32),
        }
        arrays: dict[str, npt.NDArray[Any]] = {}
        for name, (shape, kind) in kinds.items():
            whole, dtype = (self.num_agents, *shape), np.dtype(kind)
            if buf is None:
                arrays[name] = np.zeros(whole, dtype)
            elif name not in buf:
                raise ValueError(f"buf has no {name!r}: it holds {', '.join(kinds)}, or is left out")
            else:
                require_buffer(f"buf[{name!r}]", buf[name], whole, (dtype,))
                arrays[name] = buf[name]
        for (name, array), (other, its) in combinations(arrays.items(), 2):
            if np.may_share_memory(array, its):
                raise ValueError(f"buf[{name!r}] and buf[{other!r}] share memory: each needs its own")
        self.observations, self.rewards = arrays["observations"], arrays["rewards"]
        self.terminals, self.truncations = arrays["terminals"], arrays["truncations"]
        self.masks, self.actions = arrays["masks"], arrays["actions"]
        self.masks[:] = True
        group = (self.vector.num_envs, self.vector.num_players)
        self._flags = self.terminals.reshape(group), self.truncations.reshape(group)
        self._out = VectorBuffers(self.observations.reshape(*group, -1), self.rewards.reshape(group))

    @property
    def layout(self) -> ObservationLayout:
        """The layout of observations and actions."""
        return self.vector.layout

    @property
    def driver_env(self) -> PlayerBufferEnv:
        """Itself."""
        return self

    @property
    def agents_per_batch(self) -> int:
        """B·N."""
        return self.num_agents

    def reset(self, seed: int | None = None) -> tuple[Float32Array, Infos]:
        """Start all episodes.

        Args:
            seed: S for seeds S·B, S·B + 1, …, so that workers with successive seeds have no episode in common.

        Raises:
            ValueError: for an invalid seed; no array is written.
        """
        chosen = self._seed if seed is None else require_seed(seed)
        self.vector.reset(None if chosen is None else chosen * self.vector.num_envs, out=self._out)
        self._seed = None
        self.rewards[:] = 0
        self.terminals[:] = self.truncations[:] = False
        self.infos = []
        return self.observations, self.infos

    def step(self, actions: npt.NDArray[np.floating]) -> Step:
        """Step all environments, and reset those that end.

        Raises:
            RuntimeError: before the first reset.
            ValueError: when the actions have another shape or dtype, or are not finite; no environment is stepped, and
                no array is written.
        """
        outcome = self.vector.step(member_actions(self.vector, actions, "agents"), out=self._out)
        for flags, ended in zip(self._flags, (outcome.terminated, outcome.truncated), strict=True):
            flags[:] = ended[:, None]
        over = outcome.terminated | outcome.truncated
        self.infos = []
        if over.any():
            self.infos = [{name: float(outcome.infos[name][over].mean()) for name in ("is_success", "diverged")}]
            self.vector.reset(mask=over, out=self._out)
        return self.observations, self.rewards, self.terminals, self.truncations, self.infos

    def async_reset(self, seed: int | None = None) -> None:
        """As :meth:`reset`; :meth:`recv` returns the result."""
        self.reset(seed)

    def send(self, actions: npt.NDArray[np.floating]) -> None:
        """As :meth:`step`; :meth:`recv` returns the result."""
        self.step(actions)

    def recv(self) -> tuple[Float32Array, Float32Array, BoolArray, BoolArray, Infos, IntArray, BoolArray]:
        """Observations, rewards, terminals, truncations, infos, agent_ids and masks."""
        arrays = self.observations, self.rewards, self.terminals, self.truncations
        return *arrays, self.infos, self.agent_ids, self.masks

    def __copy__(self) -> NoReturn:
        """Refused.

        Raises:
            TypeError: always, because the arrays belong to the trainer.
        """
        raise TypeError("a PlayerBufferEnv writes into arrays of its trainer and cannot be copied: make a new one")

    def __deepcopy__(self, memo: dict[int, Any]) -> NoReturn:
        """Refused, as :meth:`__copy__`."""
        self.__copy__()

    def close(self) -> None:
        """Nothing to release."""
