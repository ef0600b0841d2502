"""Training: PPO of Stable-Baselines3 on vectorised environments, and the export of the learned policy.

Everything but the names of configurations needs the extra ``pip install "ptne-env[sb3]"``.
"""

from pathlib import Path

CONFIGURATIONS = Path(__file__).parent / "configurations"
"""Folder of the shipped configurations, one ``.toml`` file each."""


def configurations() -> list[str]:
    """The names of the shipped configurations."""
    return sorted(path.stem for path in CONFIGURATIONS.glob("*.toml"))
