"""The TorchRL environment: B environments as one batched environment with the players stacked in a group.

Needs the extra ``pip install "ptne-env[torchrl]"``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

try:
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Bounded, Categorical, Composite, Unbounded
    from torchrl.envs import EnvBase
except ImportError as error:  # pragma: no cover - exercised in an environment without the package
    raise ImportError('the TorchRL adapter needs an extra: pip install "ptne-env[torchrl]"') from error

from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.shared.arrays import BoolArray, require_count
from ptne_env.world.scenario import Scenario

GROUP = "player"
"""The name of the group of all players, as TorchRL's ``PettingZooWrapper`` has it, so that a trainer fits both."""


class TorchRLEnv(EnvBase):
    """A TorchRL environment on the CPU with the batch size (B,), whose keys are those of ``PettingZooWrapper``.

    ``("player", "observation")`` has the shape (B, N, size), ``("player", "action")`` (B, N, action size) and
    ``("player", "reward")`` (B, N, 1), all float32; ``("player", "info", …)`` holds each entry of the infos, (B, N),
    float32. ``done``, ``terminated`` and ``truncated`` have the shape (B, 1), and (B, N, 1) in the group. Tensors use
    the memory of new numpy arrays, which no later step changes. A reset starts the environments that ``"_reset"``
    names, or all of them.

    Args:
        scenario: a name, as for :func:`ptne_env.get_scenario`, or a scenario.
        num_envs: B.
        seed: the seed of the first reset; environment b gets seed + b.
        **arguments: those of :class:`~ptne_env.envs.vector.VectorParallelEnv`, among them fields of the scenario.

    Attributes:
        vector: the environments.
        layout: the layout of observations and actions.
        group_map: the names of the players, by group.
    """

    def __init__(
        self, scenario: str | Scenario = "energy", num_envs: int = 1, *, seed: int | None = None, **arguments: Any
    ) -> None:
        vector = VectorParallelEnv(scenario, num_envs, **arguments)
        super().__init__(device="cpu", batch_size=(vector.num_envs,))
        self.vector = vector
        self.layout = vector.layout
        self.group_map = {GROUP: [f"player_{index}" for index in range(vector.num_players)]}
        self._set_seed(seed)

        batch, group = (num_envs,), (num_envs, vector.num_players)
        entries = ("diverged", "clipped", "is_success", *vector.reward_names)
        infos = Composite({name: Unbounded(group) for name in entries}, shape=group)
        observed = self._bounded_spec(vector.single_observation_space)
        self.observation_spec = self._group_spec({"observation": observed, "info": infos})
        self.action_spec = self._group_spec({"action": self._bounded_spec(vector.single_action_space)})
        self.reward_spec = self._group_spec({"reward": Unbounded((*group, 1))})
        self.done_spec = self._group_spec(self._flag_specs(group), self._flag_specs(batch))

    def _group_spec(self, members: dict[str, Any], whole: dict[str, Any] | None = None) -> Composite:
        """Return the specification of entries of the group, and of those of an environment as a whole."""
        group = Composite(members, shape=(*self.batch_size, self.vector.num_players))
        return Composite({**(whole or {}), GROUP: group}, shape=self.batch_size, device=self.device)

    def _bounded_spec(self, space: spaces.Box) -> Bounded:
        shape = (*self.batch_size, self.vector.num_players, *space.shape)
        low, high = (torch.from_numpy(np.broadcast_to(bound, shape).copy()) for bound in (space.low, space.high))
        return Bounded(low, high, shape=shape, dtype=torch.float32)

    def _flag_specs(self, shape: tuple[int, ...]) -> dict[str, Categorical]:
        return {name: Categorical(2, (*shape, 1), dtype=torch.bool) for name in ("done", "terminated", "truncated")}

    def _set_seed(self, seed: int | None) -> None:
        """Seed the next start of every environment: environment b gets seed + b.

        Raises:
            ValueError: for an invalid seed; the seeds stay as they were.
        """
        first = None if seed is None else require_count("a seed", seed, 0)
        self._seeds = [None if first is None else first + index for index in range(self.vector.num_envs)]

    def _reset(self, tensordict: TensorDictBase | None = None, *, seed: int | None = None) -> TensorDict:
        """Start the environments that ``"_reset"`` names; ``seed`` is that of :meth:`set_seed`.

        Raises:
            ValueError: for an invalid seed, or when the first reset leaves some out; no environment is touched.
        """
        named = None if tensordict is None else tensordict.get("_reset", None)
        mask = np.ones(self.vector.num_envs, dtype=np.bool_) if named is None else named.reshape(-1).numpy(force=True)
        if seed is not None:
            self._set_seed(seed)
        observations, infos = self.vector.reset(self._seeds, mask)
        self._seeds = [None if start else own for own, start in zip(self._seeds, mask, strict=True)]
        terminated, truncated = np.zeros((2, self.vector.num_envs), dtype=np.bool_)
        return self._output({"observation": observations}, infos, terminated, truncated)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        """Step all environments.

        Raises:
            KeyError: without actions.
            RuntimeError: when an environment is over.
            ValueError: for actions of another shape or dtype, or that are not finite, or when ``"_step"`` leaves
                environments out; no environment is stepped.
        """
        stepped = tensordict.get("_step", None)
        if stepped is not None and not stepped.all():
            raise ValueError(
                "all environments are stepped together, but _step leaves some out: roll out with "
                "break_when_any_done=False, which resets an environment at its end, and without break_when_all_done"
            )
        outcome = self.vector.step(tensordict[GROUP, "action"].numpy(force=True))
        entries: dict[str, Any] = {"observation": outcome.observations, "reward": outcome.rewards[:, :, None]}
        return self._output(entries, outcome.infos, outcome.terminated, outcome.truncated)

    def _output(
        self, entries: dict[str, Any], infos: dict[str, Any], terminated: BoolArray, truncated: BoolArray
    ) -> TensorDict:
        """Return the tensors of the group, and the flags of every environment and of its players."""
        players = self.vector.num_players
        shape = (*self.batch_size, players)
        flags = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        whole = {name: torch.from_numpy(flag.reshape(-1, 1)) for name, flag in flags.items()}
        group: dict[str, Any] = {name: torch.from_numpy(np.float32(array)) for name, array in entries.items()}
        group |= {name: torch.from_numpy(flag.repeat(players).reshape(*shape, 1)) for name, flag in flags.items()}
        wide = {name: info if info.ndim > 1 else np.tile(info[:, None], players) for name, info in infos.items()}
        group["info"] = TensorDict({name: torch.from_numpy(np.float32(info)) for name, info in wide.items()}, shape)
        return TensorDict({**whole, GROUP: TensorDict(group, shape)}, self.batch_size, device=self.device)
