"""BenchMARL: any scenario as a task whose environments are stepped together.

Needs the package ``benchmarl``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

try:
    from benchmarl.environments import TaskClass
except ImportError as error:  # pragma: no cover - exercised in an environment without the package
    raise ImportError("the BenchMARL adapter needs a package: pip install benchmarl") from error

from torchrl.data import Composite
from torchrl.envs import EnvBase

from ptne_env.envs.torchrl import TorchRLEnv
from ptne_env.world.world import World


class NashSeekingTask(TaskClass):
    """A task for ``benchmarl.experiment.Experiment``: ``NashSeekingTask("random-energy", {"interface": "local"})``.

    Args:
        name: of a scenario of the catalogue.
        config: the arguments of :class:`~ptne_env.envs.torchrl.TorchRLEnv`.
    """

    def __init__(self, name: str, config: dict[str, Any] | None = None) -> None:
        super().__init__(name, config)

    def get_env_fun(
        self,
        num_envs: int,
        continuous_actions: bool,  # noqa: ARG002, FBT001 - all actions are continuous
        seed: int | None,
        device: str,
    ) -> Callable[[], EnvBase]:
        """A function that makes one batched environment."""
        return partial(TorchRLEnv, self.name, num_envs, seed=seed, device=device, **self.config)

    def supports_continuous_actions(self) -> bool:
        """Always."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Never."""
        return False

    def has_render(self, env: EnvBase) -> bool:  # noqa: ARG002
        """Never, because batches are not drawn."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """The number of steps of an episode, with the hold phase."""
        return World(env.vector.scenario).clock.total_steps

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """All players in one group."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Of one environment, without the infos: BenchMARL's networks read every entry."""
        spec = env.full_observation_spec_unbatched.clone()
        del spec["player", "info"]
        return spec

    def action_spec(self, env: EnvBase) -> Composite:
        """Of one environment."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """Not given: BenchMARL logs no entries of infos."""

    def state_spec(self, env: EnvBase) -> None:
        """Not given: a centralised critic receives the observations of all players."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """Not given: all actions are allowed."""

    @staticmethod
    def env_name() -> str:
        """The name of the family of tasks."""
        return "ptne"
