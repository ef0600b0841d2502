"""Tracks: worlds, team rules, and scenarios by address."""

import sys
from types import ModuleType

import numpy as np
import pytest
from small_suite import BASE, SMALL

import ptne_env
from ptne_env import FactorySpec, Interface, Scenario, laws
from ptne_env.evaluation import EpisodeSet, Teammates, Track, rollout
from ptne_env.evaluation.rollout import Member
from ptne_env.evaluation.tracks import compared_tracks
from ptne_env.perception.encoder import Encoder
from ptne_env.world.world import World


def test_a_team_of_two_static_laws_is_the_static_law():
    world = World(BASE)
    encoder = Encoder(world, Interface("physical"))
    start = EpisodeSet(4).initial_state(world)
    alone = rollout(laws.Static(encoder.layout), encoder, start)
    team = rollout(laws.Static(encoder.layout), encoder, start, Member(laws.Static(encoder.layout), encoder, (1, 3)))
    np.testing.assert_array_equal(alone["estimate_distance"], team["estimate_distance"])


class Watching:
    """The static law, keeping its observations."""

    def __init__(self, layout):
        self.law, self.layout, self.seen = laws.Static(layout), layout, []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.seen.append(observation.copy())
        return self.law.predict(observation, state, episode_start, deterministic)


def test_members_of_a_team_see_their_own_players_through_their_own_interface():
    world = World(BASE)
    physical, local = Encoder(world, Interface("physical")), Encoder(world, Interface("scaled"))
    one, other = Watching(physical.layout), Watching(local.layout)
    start = EpisodeSet(2).initial_state(world)
    rollout(one, physical, start, Member(other, local, (1, 3)))
    for policy, players in ((one, [0, 2, 4]), (other, [1, 3])):
        assert len(policy.seen) == BASE.steps
        for rows in policy.seen:
            assert policy.layout.select(rows, "player").argmax(axis=1).tolist() == players * 2


def test_teammates_act_in_place_of_the_policy():
    world = World(BASE)
    encoder = Encoder(world, Interface("physical"))
    start = EpisodeSet(2).initial_state(world)
    zero, law = laws.ZeroInput(encoder.layout), laws.Static(encoder.layout)
    none, some, others = (
        rollout(zero, encoder, start, team)["input_energy"].sum(axis=0)
        for team in (None, Member(law, encoder, (1, 3)), Member(law, encoder, (0, 2, 4)))
    )
    assert np.all(none == 0)
    assert np.all(some > 0)
    assert np.all(others > 0)


class Failing:
    """A policy that raises an error."""

    def __init__(self, layout):
        self.layout = layout

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        raise KeyError("x")


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (FactorySpec.of(Failing), "the teammates fail: step 0: KeyError"),
        (FactorySpec.of("law:static", kapa=1), r"the teammates, static\(kapa=1\), cannot play 'small': .*kapa"),
    ],
)
def test_a_failure_of_teammates_is_not_that_of_the_policy(policy, message):
    track = Track("team", BASE.replace(name="small"), "A team.", teammates=Teammates(policy, (4,)))
    with pytest.raises(ValueError, match=message):
        ptne_env.evaluate("static", track, episodes=2)


@pytest.mark.parametrize("players", [(), (0, 0), (5,), (0, 1, 2, 3, 4)])
def test_teammates_are_some_of_the_players(players):
    with pytest.raises(ValueError, match="teammates are some"):
        Track("team", BASE, "A team.", teammates=Teammates(FactorySpec.of("ptne_env.laws:ZeroInput"), players))


def test_a_track_is_its_own_dict_and_back():
    team = Teammates(FactorySpec.of("law:static", kappa=3.0), (1, 3))
    for track in (*SMALL.tracks, Track("team", BASE, "A team.", teammates=team, episodes=7, scored=False)):
        assert Track.from_dict(track.to_dict()) == track


def test_a_scenario_is_found_by_address(monkeypatch):
    monkeypatch.setitem(sys.modules, "mine", mine := ModuleType("mine"))
    mine.scenario, mine.number = BASE, 5
    mine.make = lambda: BASE
    assert ptne_env.get_scenario("mine:scenario") == ptne_env.get_scenario("mine:make") == BASE
    with pytest.raises(ValueError, match="'mine:number' is a int, not a Scenario"):
        ptne_env.get_scenario("mine:number")
    assert [track.name for track in compared_tracks(["mine:scenario", "energy"])] == [BASE.name, "energy"]


def test_a_track_in_which_nothing_is_random_has_one_episode():
    fixed, random = compared_tracks([ptne_env.get_scenario("energy", start="paper", name="paper"), "energy"])
    assert (fixed.episodes, random.episodes) == (1, None)
    assert isinstance(random.scenario, Scenario)
