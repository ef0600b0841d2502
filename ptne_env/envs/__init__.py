"""Adapters without physics, one module per library, and their registration with PettingZoo and Gymnasium.

``pettingzoo.make("parallel", "ptne/energy-v0")`` and ``gymnasium.make("ptne/energy-joint-v0")`` make environments. The
registries hold entry points, so an environment is imported when it is made.
"""

from __future__ import annotations

import gymnasium
import pettingzoo

from ptne_env.world.catalogue import CATALOGUE

NAMESPACE = "ptne"


def register_environments() -> None:
    """Register every scenario with PettingZoo, and its joint view with Gymnasium; a second call changes nothing."""
    for scenario in CATALOGUE:
        name = f"{NAMESPACE}/{scenario}-v0"
        if name in pettingzoo.parallel_registry:
            continue
        made: dict[str, object] = {"scenario": scenario}
        pettingzoo.register("parallel", name, entry_point="ptne_env.envs.parallel:parallel_env", kwargs=made)
        pettingzoo.register("aec", name, entry_point="ptne_env.envs.parallel:aec_env", kwargs=made)
        for joint in (f"{NAMESPACE}/{scenario}-joint-v0", name):  # Gymnasium knows the joint view alone
            gymnasium.register(
                joint,
                entry_point="ptne_env.envs.gymnasium:JointEnv",
                vector_entry_point="ptne_env.envs.gymnasium:JointVectorEnv",
                kwargs=made,
            )
