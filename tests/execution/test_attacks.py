"""Attacks: what playing loud and code gain over relay through channels of the suite."""

from functools import cache, partial

import pytest
from attacks import CODER, LOUD, Loud, played, room

from ptne_env.evaluation import Track
from ptne_env.laws import Relay
from ptne_env.suites import get_suite

EPISODES = 10


@cache
def track(name, **changes):
    """A track of ptne-v1, or the same with another world."""
    found = get_suite("ptne-v1").track(name)
    return Track(name, found.scenario.replace(**changes), found.change)


@cache
def relayed(at):
    return played(at, Relay, EPISODES)


def gained(at, attack):
    """What an attack gains over relay: mean digits at T, and over the second half of the steps."""
    return (played(at, attack, EPISODES) - relayed(at)).mean(axis=1)


@pytest.mark.parametrize("name", ["switching-transformed", "rounding", "rotation"])
def test_loud_play_and_equations_in_code_gain_at_most_what_the_range_allows(name):
    allowed = room(track(name), EPISODES) + 0.1
    assert gained(track(name), LOUD.get(name, Loud))[0] <= allowed
    assert gained(track(name), CODER)[0] <= allowed


def test_without_a_range_loud_play_gains_a_digit_more():
    endless = track("switching-transformed", message_range=None, input_limit=1e5)
    allowed = room(track("switching-transformed"), EPISODES) + 0.1
    assert gained(endless, partial(Loud, gain=100.0))[0] > allowed + 1


def test_equations_in_code_tell_the_equilibrium_without_noise_and_gain_nothing_with_it():
    clean, early = track("switching-physical", message_range=None, channel="perfect"), partial(CODER, switch=60)
    assert played(clean, early, EPISODES).min() > 5
    assert gained(track("switching-physical"), early).max() < 0


@pytest.mark.parametrize("attack", [Loud, CODER])
def test_attacks_decide_each_row_from_its_own_observations_and_links(attack):
    played(track("rounding", steps=60), attack, EPISODES, audit=True)
