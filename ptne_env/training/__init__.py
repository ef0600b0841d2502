"""Training: ``jax_ppo`` and ``through_world`` on JAX, ``ppo`` with Stable-Baselines3; all write a policy and a curve.

``ppo`` needs the extra ``pip install "ptne-env[sb3]"``, the others the extra ``ptne-env[jax]``.
"""

from collections.abc import Mapping
from pathlib import Path

from ptne_env.shared.files import shipped_files


def configurations() -> Mapping[str, Path]:
    """Return the files of the shipped configurations by name."""
    return shipped_files("training/configurations", ".toml")
