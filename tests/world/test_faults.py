"""Disturbances of the strategies."""

import math

import pytest

from ptne_env import FactorySpec, get_scenario
from ptne_env.world.world import World


@pytest.mark.parametrize(
    ("disturbance", "message"),
    [
        ({"bound": math.inf}, "bound"),
        ({"bound": 1.0, "dwell": 0}, "dwell"),
    ],
)
def test_invalid_disturbances_are_refused(disturbance, message):
    with pytest.raises(ValueError, match=message):
        World(get_scenario("energy", disturbance=FactorySpec.of("disturbance:uniform", **disturbance)))


def test_a_part_of_another_kind_is_refused():
    with pytest.raises(ValueError, match="where a Disturbance is needed"):
        World(get_scenario("energy", disturbance=FactorySpec.of("channel:noise", std=1.0)))
