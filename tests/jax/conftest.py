"""JAX with 64-bit numbers, in these tests alone."""

import os

import pytest

# Most functions here run once, so XLA compiles quickly; tests of equality also run a few that it optimises.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false")


@pytest.fixture(autouse=True)
def _x64():
    import jax

    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", val=True)
    yield
    jax.config.update("jax_enable_x64", before)
