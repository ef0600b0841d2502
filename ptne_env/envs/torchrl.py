"""TorchRL: B environments as one batched environment, with the players stacked in the group ``player``.

Needs the extra ``pip install "ptne-env[torchrl]"``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

try:
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Bounded, Categorical, Composite, Unbounded
    from torchrl.envs import EnvBase
except ImportError as error:  # pragma: no cover - exercised in an environment without the package
    raise ImportError('the TorchRL adapter needs an extra: pip install "ptne-env[torchrl]"') from error

from gymnasium import spaces

from ptne_env.envs.simulation import Duplicable
from ptne_env.envs.vector import VectorBuffers, VectorParallelEnv
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.shared.random_streams import require_seed
from ptne_env.world.scenario import Scenario

GROUP = "player"
"""The group of all players: the name that TorchRL's ``PettingZooWrapper`` gives it, so a trainer fits both."""


class TorchRLEnv(Duplicable, EnvBase):
    """A TorchRL environment with the batch size (B,), whose keys are those of ``PettingZooWrapper``.

    ``("player", "observation")`` has the shape (B, N, size), ``("player", "action")`` (B, N, action size) and
    ``("player", "reward")`` (B, N, 1), all float32; ``("player", "info", …)`` holds each entry of the infos, (B, N),
    float32. ``done``, ``terminated`` and ``truncated`` have the shape (B, 1),
    and (B, N, 1) in the group. Tensors show the memory of new numpy arrays, without a copy, so no later step changes
    them. A reset starts the environments that ``"_reset"`` names, or all of them.

    Args:
        scenario: a name of the catalogue or a scenario.
        num_envs: B.
        seed: of the first reset; environment b gets seed + b.
        device: the CPU; collectors move tensors to the device of a policy.
        **arguments: of :class:`~ptne_env.envs.vector.VectorParallelEnv`: interface, reward,
            max_cycles, threads and fields of the scenario.

    Attributes:
        vector: the environments.
        layout: of observations and actions.
        group_map: the names of the players, by group.

    Raises:
        TypeError: for an unknown keyword, naming similar ones, or all.
        ValueError: for an unknown name, an invalid value, or another device.
    """

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        num_envs: int = 1,
        *,
        seed: int | None = None,
        device: str | torch.device = "cpu",
        **arguments: Any,
    ) -> None:
        vector = VectorParallelEnv(scenario, num_envs, **arguments)
        super().__init__(device=_require_cpu(device), batch_size=(vector.num_envs,))
        self.vector = vector
        self.layout: ObservationLayout = vector.layout
        self.group_map = {GROUP: [f"player_{index}" for index in range(vector.num_players)]}
        self._set_seed(seed)

        batch, group = (num_envs,), (num_envs, vector.num_players)
        entries = ("diverged", "clipped", "is_success", *vector.reward_names)
        infos = Composite({name: Unbounded(group, device=self.device) for name in entries}, shape=group)
        observed = self._bounded(vector.single_observation_space)
        self.observation_spec = self._grouped({"observation": observed, "info": infos})
        self.action_spec = self._grouped({"action": self._bounded(vector.single_action_space)})
        self.reward_spec = self._grouped({"reward": Unbounded((*group, 1), device=self.device)})
        self.done_spec = self._grouped(self._flags(group), self._flags(batch))

    def _grouped(self, members: dict[str, Any], whole: dict[str, Any] | None = None) -> Composite:
        """The specification of entries of the group, and of those of an environment as a whole."""
        shape = (*self.batch_size, self.vector.num_players)
        group = Composite(members, shape=shape, device=self.device)
        return Composite({**(whole or {}), GROUP: group}, shape=self.batch_size, device=self.device)

    def _bounded(self, space: spaces.Box) -> Bounded:
        shape = (*self.batch_size, self.vector.num_players, *space.shape)
        low, high = (torch.from_numpy(np.broadcast_to(bound, shape).copy()) for bound in (space.low, space.high))
        return Bounded(low, high, shape=shape, device=self.device, dtype=torch.float32)

    def _flags(self, shape: tuple[int, ...]) -> dict[str, Categorical]:
        names = ("done", "terminated", "truncated")
        return {name: Categorical(2, (*shape, 1), dtype=torch.bool, device=self.device) for name in names}

    def to(self, device: str | torch.device) -> TorchRLEnv:
        """This environment, which stays on the CPU.

        Raises:
            ValueError: for another device.
        """
        return super().to(_require_cpu(device))

    def _set_seed(self, seed: int | None) -> None:
        """Seed the next start of every environment: environment b gets seed + b.

        Raises:
            ValueError: for an invalid seed; the seeds stay as they were.
        """
        first = None if seed is None else require_seed(seed)
        self._seeds = [None if first is None else first + index for index in range(self.vector.num_envs)]

    def _reset(self, tensordict: TensorDictBase | None = None, *, seed: int | None = None) -> TensorDict:
        """Start the environments that ``"_reset"`` names; ``seed`` is as in :meth:`set_seed`.

        Raises:
            ValueError: for an invalid seed, or when the first reset leaves some out; no environment is touched.
        """
        given = None if tensordict is None else tensordict.get("_reset", None)
        mask = np.ones(self.vector.num_envs, dtype=np.bool_) if given is None else given.reshape(-1).numpy(force=True)
        if seed is not None:
            self._set_seed(seed)
        observations = self.vector.reset(self._seeds, mask)
        self._seeds = [None if start else own for own, start in zip(self._seeds, mask, strict=True)]
        terminated, truncated = np.zeros((2, self.vector.num_envs), dtype=np.bool_)
        return self._output({"observation": observations}, self.vector.first_infos(), terminated, truncated)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        """Step all environments.

        Raises:
            KeyError: without actions.
            RuntimeError: while an environment is over.
            ValueError: for actions of another shape or dtype, or that are not finite, or when ``"_step"`` leaves
                environments out; no environment is stepped.
        """
        chosen = tensordict.get("_step", None)
        if chosen is not None and not chosen.all():
            raise ValueError(
                "all environments are stepped together, and _step leaves some out: roll out with "
                "break_when_any_done=False, which resets an environment at its end, and without break_when_all_done"
            )
        given = tensordict[GROUP, "action"]
        if given.dtype is torch.bfloat16:  # which numpy does not have
            given = given.float()
        actions = given.numpy(force=True)
        rewards = np.empty((self.vector.num_envs, self.vector.num_players), dtype=np.float32)
        outcome = self.vector.step(actions, out=VectorBuffers(rewards=rewards))
        entries = {"observation": outcome.observations, "reward": rewards[:, :, None]}
        return self._output(entries, outcome.infos, outcome.terminated, outcome.truncated)

    def _output(
        self, entries: dict[str, Float32Array], infos: dict[str, Any], terminated: BoolArray, truncated: BoolArray
    ) -> TensorDict:
        """Tensors of the group, and the flags of every environment and of its players."""
        players = self.vector.num_players
        flags = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        whole = {name: torch.from_numpy(flag.reshape(-1, 1)) for name, flag in flags.items()}
        group = {name: torch.from_numpy(array) for name, array in entries.items()}
        group |= {name: torch.from_numpy(flag.repeat(players).reshape(-1, players, 1)) for name, flag in flags.items()}
        shape = (*self.batch_size, players)
        wide = {name: each if each.ndim > 1 else np.tile(each[:, None], players) for name, each in infos.items()}
        tensors = {name: torch.from_numpy(each.astype(np.float32)) for name, each in wide.items()}
        group["info"] = TensorDict(tensors, shape, device=self.device)
        members = TensorDict(group, shape, device=self.device)
        return TensorDict({**whole, GROUP: members}, self.batch_size, device=self.device)


def _require_cpu(device: str | torch.device) -> torch.device:
    """The device, or ``ValueError`` when it is not the CPU."""
    wanted = torch.device(device)
    if wanted.type != "cpu":
        raise ValueError(
            f"the environments compute on the CPU, got the device {wanted}: leave them there, and give the other "
            "device to the policy; collectors move tensors between the two"
        )
    return wanted
