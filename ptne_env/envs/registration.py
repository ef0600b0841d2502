"""Registration: ``pettingzoo.make("parallel", "ptne/energy-v0")``, ``gymnasium.make("ptne/energy-joint-v0")``."""

from __future__ import annotations

import gymnasium
from pettingzoo import aec_registry, parallel_registry, register

from ptne_env.scenario import CATALOGUE

NAMESPACE = "ptne"


def register_environments() -> None:
    """Register every scenario with PettingZoo, and its joint view with Gymnasium; a second call changes nothing."""
    for scenario in CATALOGUE:
        environment_id = f"{NAMESPACE}/{scenario}-v0"
        module = f"ptne_env.{scenario.replace('-', '_')}_v0"
        if environment_id not in parallel_registry:
            register("parallel", environment_id, entry_point=f"{module}:parallel_env")
        if environment_id not in aec_registry:
            register("aec", environment_id, entry_point=f"{module}:env")
        joint_id = f"{NAMESPACE}/{scenario}-joint-v0"
        if joint_id not in gymnasium.registry:
            gymnasium.register(
                joint_id,
                entry_point="ptne_env.envs.joint:JointEnv",
                vector_entry_point="ptne_env.envs.joint:JointVectorEnv",
                kwargs={"scenario": scenario},
            )
