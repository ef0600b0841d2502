"""What only an extra brings: without it the tests that need it are skipped, and say which extra that is."""

import pytest


def need_sb3(module="torch"):
    """Skip what asks, unless the extra ``sb3`` is installed, of which ``module`` is a part."""
    return pytest.importorskip(module, reason="needs the extra 'sb3': pip install 'ptne-env[sb3]'")


def need_matplotlib():
    """Skip what asks, unless the extra ``bench`` is installed, for pictures."""
    return pytest.importorskip("matplotlib", reason="needs the extra 'bench': pip install 'ptne-env[bench]'")


def need_jax():
    """Skip what asks, unless the extra ``jax`` is installed."""
    return pytest.importorskip("jax", reason="needs the extra 'jax': pip install 'ptne-env[jax]'")


def need_torchrl():
    """Skip what asks, unless the extra ``torchrl`` is installed."""
    return pytest.importorskip("torchrl", reason="needs the extra 'torchrl': pip install 'ptne-env[torchrl]'")
