"""Every scenario is found by the names that PettingZoo's users type."""

import pettingzoo
import pytest

import ptne_env
from ptne_env.envs import register_environments


@pytest.mark.parametrize("scenario", list(ptne_env.CATALOGUE))
def test_make_and_parallel_env_give_the_same_environment(scenario):
    by_id = pettingzoo.make("parallel", f"ptne/{scenario}-v0", hold_steps=3)
    assert isinstance(by_id, ptne_env.NashSeekingEnv)
    assert by_id.scenario == ptne_env.parallel_env(scenario, hold_steps=3).scenario
    assert by_id.scenario == ptne_env.get_scenario(scenario, hold_steps=3)
    assert str(by_id) == f"ptne_{scenario.replace('-', '_')}_v0"
    assert isinstance(pettingzoo.make("aec", f"ptne/{scenario}-v0"), pettingzoo.AECEnv)


def test_registration_is_idempotent_and_silent():
    before = dict(pettingzoo.parallel_registry)
    register_environments()  # a warning would be an error
    assert dict(pettingzoo.parallel_registry) == before
