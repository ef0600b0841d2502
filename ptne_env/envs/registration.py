"""Registration: ``pettingzoo.make("parallel", "ptne/energy-v0")``, ``gymnasium.make("ptne/energy-joint-v0")``.

The registries hold entry points: an environment is imported when it is made. PettingZoo has registries from 1.27 on.
"""

from __future__ import annotations

import gymnasium
import pettingzoo

from ptne_env.world.catalogue import CATALOGUE

NAMESPACE = "ptne"


def register_environments() -> None:
    """Register every scenario with PettingZoo, and its joint view with Gymnasium; a second call changes nothing."""
    if hasattr(pettingzoo, "register"):
        _register_with_pettingzoo()
    for scenario in CATALOGUE:
        joint_id = f"{NAMESPACE}/{scenario}-joint-v0"
        if joint_id not in gymnasium.registry:
            gymnasium.register(
                joint_id,
                entry_point="ptne_env.envs.gymnasium:JointEnv",
                vector_entry_point="ptne_env.envs.gymnasium:JointVectorEnv",
                kwargs={"scenario": scenario},
            )


def _register_with_pettingzoo() -> None:
    for scenario in CATALOGUE:
        for kind, registry, entry_point in (
            ("parallel", pettingzoo.parallel_registry, "ptne_env.envs.parallel:parallel_env"),
            ("aec", pettingzoo.aec_registry, "ptne_env.envs.turn_based:aec_env"),
        ):
            if (environment_id := f"{NAMESPACE}/{scenario}-v0") not in registry:
                pettingzoo.register(kind, environment_id, entry_point=entry_point, kwargs={"scenario": scenario})
