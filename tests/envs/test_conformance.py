"""PettingZoo's own suites, without a warning and without a skipped check."""

import warnings
from functools import partial
from types import SimpleNamespace

import pytest
from worlds import BLOCKS_SWITCHING

from ptne_env.envs.parallel import aec_env, parallel_env

with warnings.catch_warnings():
    # The suites import one of PettingZoo's own environments in the way that PettingZoo itself deprecates.
    warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
    from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, seed_test

SCENARIOS = {
    "energy": "energy",
    "random-energy-switching-transformed": "random-energy-switching-transformed",
    "robots": "robots",
    "blocks-switching": BLOCKS_SWITCHING,
}
VARIANTS = {"scaled": {}, "physical": {"interface": "physical", "hold_steps": 10, "input_limit": 5.0}}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_parallel_api(name, variant):
    parallel_api_test(parallel_env(SCENARIOS[name], **VARIANTS[variant]), num_cycles=1000)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", SCENARIOS)
def test_turn_based_api(name, variant):
    api_test(aec_env(SCENARIOS[name], **VARIANTS[variant]), num_cycles=1000)


@pytest.mark.parametrize("name", SCENARIOS)
def test_seeds(name):
    parallel_seed_test(lambda: parallel_env(SCENARIOS[name], start="random"))
    seed_test(lambda: aec_env(SCENARIOS[name], start="random"))


@pytest.mark.parametrize("name", SCENARIOS)
def test_max_cycles(name):
    constructors = SimpleNamespace(
        env=partial(aec_env, SCENARIOS[name]), parallel_env=partial(parallel_env, SCENARIOS[name])
    )
    max_cycles_test(constructors)
