"""PettingZoo's own suites on every scenario of the catalogue, without a warning and without a skipped check."""

import warnings

import pytest
from worlds import BLOCKS, BLOCKS_SWITCHING

from ptne_env import CATALOGUE
from ptne_env.envs.modules import EnvironmentModule, env, environment_module, parallel_env, raw_env

with warnings.catch_warnings():
    # The suites import one of PettingZoo's own environments in the way that PettingZoo itself deprecates.
    warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
    from pettingzoo.test import (
        api_test,
        max_cycles_test,
        parallel_api_test,
        parallel_seed_test,
        render_test,
        seed_test,
    )

MODULES = {name: environment_module(name) for name in CATALOGUE} | {
    scenario.name: EnvironmentModule(
        lambda scenario=scenario, **arguments: env(scenario, **arguments),
        lambda scenario=scenario, **arguments: raw_env(scenario, **arguments),
        lambda scenario=scenario, **arguments: parallel_env(scenario, **arguments),
    )
    for scenario in (BLOCKS, BLOCKS_SWITCHING)
}
VARIANTS = {
    "physical": {},
    "local": {"interface": "local"},
    "gains": {"action_mode": "gains"},
    "held": {"hold_steps": 10, "start": "random", "input_limit": 5.0},
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", MODULES)
def test_parallel_api(name, variant):
    parallel_api_test(MODULES[name].parallel_env(**VARIANTS[variant]), num_cycles=1000)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", MODULES)
def test_turn_based_api(name, variant):
    api_test(MODULES[name].env(**VARIANTS[variant]), num_cycles=1000)


@pytest.mark.parametrize("name", MODULES)
def test_seeds(name):
    parallel_seed_test(lambda: MODULES[name].parallel_env(start="random"))
    seed_test(lambda: MODULES[name].env(start="random"))


@pytest.mark.parametrize("name", MODULES)
def test_max_cycles(name):
    max_cycles_test(_gentle(MODULES[name]))


def _gentle(module):
    """Random actions that do not leave the range within four steps."""
    return EnvironmentModule(*(lambda make=make, **arguments: make(input_limit=10.0, **arguments) for make in module))


@pytest.mark.parametrize("name", [*CATALOGUE, "blocks"])
def test_rendering(name):
    render_test(MODULES[name].raw_env)


@pytest.mark.parametrize("name", MODULES)
def test_constructors_make_the_three_forms(name):
    module = MODULES[name]
    turn_based, raw, parallel = module.env(), module.raw_env(), module.parallel_env()
    assert turn_based.possible_agents == raw.possible_agents == parallel.possible_agents
    assert parallel.metadata["is_parallelizable"] is True
    assert parallel.metadata["name"] == f"ptne_{name.replace('-', '_')}_v0"
    assert parallel.scenario.name == name
