"""Training: random worlds, PPO of Stable-Baselines3 on vectorised environments, and the export of the learned policy.

Everything but the names of configurations and the worlds needs the extra ``pip install "ptne-env[sb3]"``.
"""

from pathlib import Path

CONFIGURATIONS = Path(__file__).parent / "configurations"
"""Folder of the shipped configurations, one ``.toml`` file each."""

SIZE_FREE = CONFIGURATIONS / "size_free"
"""Folder of those for policies without sizes."""

GENERALIST = "generalist"
"""The configuration in it that trains in random worlds."""

SHIPPED = "size-free"
"""The shipped policy that it trained."""

SPECIALIST = "specialist"
"""The configuration in it that fine-tunes a policy, which is no run by itself."""


def configurations() -> list[str]:
    """The names of the shipped configurations for policies of one layout."""
    return sorted(path.stem for path in CONFIGURATIONS.glob("*.toml"))


def all_configurations() -> list[str]:
    """The names of all shipped configurations that define a run."""
    return sorted({*configurations(), *(path.stem for path in SIZE_FREE.glob("*.toml"))} - {SPECIALIST})
