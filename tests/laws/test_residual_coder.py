"""The residual coder: code gains digits where it can, and costs little where it cannot."""

import pytest

from ptne_env import FactorySpec, evaluate, get_scenario
from ptne_env.suites import get_suite

PAIR = ["relay", "residual-coder"]
DELAYED = get_scenario("random-energy").replace(
    name="delayed",
    message_range=100.0,
    channel=FactorySpec.of(
        "channel:chain",
        stages=[FactorySpec.of("channel:delay", steps=3), FactorySpec.of("channel:noise", std=0.001)],
    ),
)


def gain(world):
    """The mean digits that code gains over relay."""
    results = evaluate(PAIR, [world], episodes=10)
    plain, coded = (results.samples[world.name, law]["digits"].mean() for law in PAIR)
    return coded - plain


@pytest.mark.parametrize(("name", "least"), [("rounding", 0.5), ("uneven-box", 1.2)])
def test_code_gains_digits(name, least):
    """So no document may say that code is useless."""
    assert gain(get_suite("ptne-v1").track(name)) > least


@pytest.mark.parametrize("world", [DELAYED, *map(get_suite("ptne-v1").track, ["strangers", "short-deadline"])])
def test_players_whose_code_is_not_understood_play_the_relay(world):
    """The first rounds, in which they find out, cost some digits."""
    assert gain(world) > -0.5
