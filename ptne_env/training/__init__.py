"""Training: ``ppo`` with Stable-Baselines3, and ``through_world`` with JAX; both write a policy file and a curve.

``ppo`` needs the extra ``pip install "ptne-env[sb3]"``, ``through_world`` the extra ``ptne-env[jax]``.
"""

from collections.abc import Mapping
from pathlib import Path

from ptne_env.shared.files import shipped_files


def configurations() -> Mapping[str, Path]:
    """Return the files of the shipped configurations by name."""
    return shipped_files("training/configurations", ".toml")
