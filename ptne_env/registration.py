"""Registration: ``pettingzoo.make("parallel", "ptne/energy-v0")``, ``gymnasium.make("ptne/energy-joint-v0")``.

What is registered is where an environment is to be found; it is imported when somebody makes one.
"""

from __future__ import annotations

from pathlib import Path

import gymnasium
from pettingzoo import aec_registry, parallel_registry, register

NAMESPACE = "ptne"


def register_environments() -> None:
    """Register every scenario with PettingZoo, and its joint view with Gymnasium; a second call changes nothing."""
    for path in sorted(Path(__file__).parent.glob("*_v0.py")):  # every scenario has one, and so none is built here
        scenario = path.stem.removesuffix("_v0").replace("_", "-")
        environment_id = f"{NAMESPACE}/{scenario}-v0"
        if environment_id not in parallel_registry:
            register("parallel", environment_id, entry_point=f"ptne_env.{path.stem}:parallel_env")
        if environment_id not in aec_registry:
            register("aec", environment_id, entry_point=f"ptne_env.{path.stem}:env")
        joint_id = f"{NAMESPACE}/{scenario}-joint-v0"
        if joint_id not in gymnasium.registry:
            gymnasium.register(
                joint_id,
                entry_point="ptne_env.envs.joint:JointEnv",
                vector_entry_point="ptne_env.envs.joint:JointVectorEnv",
                kwargs={"scenario": scenario},
            )
