"""Registration: ``pettingzoo.make("parallel", "ptne/energy-v0")``, ``gymnasium.make("ptne/energy-joint-v0")``.

The registries hold entry points: an environment is imported when it is made.
"""

from __future__ import annotations

import gymnasium
from pettingzoo import aec_registry, parallel_registry, register

from ptne_env.catalogue import CATALOGUE

NAMESPACE = "ptne"


def register_environments() -> None:
    """Register every scenario with PettingZoo, and its joint view with Gymnasium; a second call changes nothing."""
    for scenario in CATALOGUE:
        arguments = {"scenario": scenario}
        environment_id, joint_id = f"{NAMESPACE}/{scenario}-v0", f"{NAMESPACE}/{scenario}-joint-v0"
        if environment_id not in parallel_registry:
            register("parallel", environment_id, entry_point="ptne_env.envs.parallel:parallel_env", kwargs=arguments)
        if environment_id not in aec_registry:
            register("aec", environment_id, entry_point="ptne_env.envs.turn_based:aec_env", kwargs=arguments)
        if joint_id not in gymnasium.registry:
            gymnasium.register(
                joint_id,
                entry_point="ptne_env.envs.gymnasium:JointEnv",
                vector_entry_point="ptne_env.envs.gymnasium:JointVectorEnv",
                kwargs=arguments,
            )
