"""Training: ``jax_ppo`` and ``through_world`` on JAX, ``sb3`` with Stable-Baselines3.

``ptne train NAME --algorithm ALGORITHM --out DIR`` runs them. ``DIR`` then holds ``policy.npz``, which
:func:`ptne_env.learn.load` loads, ``summary.json``, ``configuration.json``, the learning curve (``evaluations.npz``),
and checkpoints, from which the same command resumes an interrupted run. ``sb3`` needs the extra
``pip install "ptne-env[sb3]"``, the others the extra ``ptne-env[jax]``.
"""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType, ModuleType
from typing import Any, NamedTuple

VALIDATION_EPISODES = 200
"""The episodes on which an exported policy is validated."""


class Trainer(NamedTuple):
    """What trains with an algorithm.

    Attributes:
        module: the module of this package that trains.
        extra: the extra that it needs.
        unit: what its runs are counted in.
        episodes: those whose mean digits its summaries have.
        resumes_exactly: whether a resumed run ends as if it had not been interrupted.
        defaults: its settings that are not the defaults of a ``Configuration``.
    """

    module: str
    extra: str
    unit: str = "agent-steps"
    episodes: str = f"{VALIDATION_EPISODES} validation episodes"
    resumes_exactly: bool = False
    defaults: Mapping[str, Any] = MappingProxyType({})

    def load(self) -> ModuleType:
        """Import the module; ``ImportError`` that names the extra if it is missing."""
        try:
            return import_module(f"ptne_env.training.{self.module}")
        except ImportError as error:
            raise ImportError(f'training needs an extra: pip install "ptne-env[{self.extra}]"') from error


_SAC = {"steps": 2_000_000, "batch": 1000, "rollout": 5, "minibatches": 4, "epochs": 6, "learning_rate": 1e-3}

TRAINERS = {
    **dict.fromkeys(("ippo", "ippo-rnn", "mappo-rnn"), Trainer("jax_ppo", "jax", resumes_exactly=True)),
    "sb3-ppo": Trainer("sb3", "sb3"),
    "sb3-sac": Trainer("sb3", "sb3", defaults=_SAC),
    "through-world": Trainer("through_world", "jax", unit="updates", episodes="the last episodes"),
}
"""The algorithms, and what trains with each."""
