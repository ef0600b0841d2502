"""Training: ``ppo`` with Stable-Baselines3, and ``through_world`` with JAX; both write a policy file and a curve.

``ppo`` needs the extra ``pip install "ptne-env[sb3]"``, ``through_world`` the extra ``ptne-env[jax]``.
"""

from pathlib import Path

CONFIGURATIONS = Path(__file__).parent / "configurations"
"""The folder of the shipped configurations, one ``.toml`` file each."""


def configurations() -> list[str]:
    """Return the names of the shipped configurations."""
    return sorted(path.stem for path in CONFIGURATIONS.glob("*.toml"))
