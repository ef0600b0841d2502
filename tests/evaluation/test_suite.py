"""Suites: frozen content, seeded episodes that an environment can replay, and team rules."""

import sys
from hashlib import sha256
from types import ModuleType

import numpy as np
import pytest
from ptne_env.evaluation.suite import (
    Suite,
    Teammates,
    Track,
    comparison,
    find_scenario,
    foreign_suites,
    get_suite,
)

import ptne_env
from ptne_env import FactorySpec, laws
from ptne_env.evaluation.episodes import track_seed
from ptne_env.evaluation.provenance import canonical_json
from ptne_env.evaluation.rollout import Member, rollout
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.world import graphs
from ptne_env.world.world import World

BASE = ptne_env.get_scenario("random-energy")


def small(**changes):
    tracks = changes.pop("tracks", (Track("nominal", BASE, "The base."),))
    return Suite(changes.pop("name", "small-v1"), tracks, **changes)


@pytest.mark.parametrize(
    "change",
    [
        {"tracks": (Track("nominal", BASE.replace(input_limit=999.0), "The base."),)},
        {"tracks": (Track("renamed", BASE, "The base."),)},
        {
            "tracks": (
                Track(
                    "nominal", BASE, "The base.", teammates=Teammates(FactorySpec.of("ptne_env.laws:ZeroInput"), (0,))
                ),
            )
        },
        {"tracks": (Track("nominal", BASE, "The base."), Track("more", BASE, "The same."))},
        {"episodes": 201},
        {"name": "small-v2"},
    ],
)
def test_a_suite_whose_content_has_changed_is_refused_under_its_old_hash(change):
    frozen = small().content_hash
    assert small(frozen=frozen).content_hash == frozen
    with pytest.raises(ValueError, match="a change of content is a new version"):
        small(frozen=frozen, **change)


def test_the_hash_ignores_none_and_the_order_of_keys():
    assert canonical_json({"b": [1, None], "a": {"c": None}}) == canonical_json({"a": {}, "b": [1, None], "d": None})


def test_every_track_is_a_valid_world_with_a_sentence():
    suite = get_suite("ptne-v1")
    for track in suite.tracks:
        assert track.change.endswith(".")
        assert "\n" not in track.change
        make_encoder(World(track.scenario), Interface("physical"))
    names = [track.name for track in suite.tracks]
    assert names[0] == "nominal"
    assert suite.track("nominal").scenario == BASE.replace(name="nominal")


@pytest.mark.parametrize(("seed", "episode"), [(0, 0), (0, 199), (7, 3)])
@pytest.mark.parametrize("split", ["train", "validation", "test"])
def test_the_seed_of_an_episode_is_the_seed_sequence_of_the_protocol(seed, episode, split):
    names = ("ptne-v1", "nominal", split)
    key = [int.from_bytes(sha256(name.encode()).digest()[:4], "big") for name in names]
    promised = np.random.SeedSequence([seed, episode], spawn_key=key)
    number = np.random.SeedSequence(track_seed(*names, seed, episode))
    np.testing.assert_array_equal(number.generate_state(8), promised.generate_state(8))
    for one, other in zip(number.spawn(4), promised.spawn(4), strict=True):
        np.testing.assert_array_equal(one.generate_state(8), other.generate_state(8))


def test_episode_sets_of_tracks_share_no_episode():
    suite = get_suite("ptne-v1")
    seeds = {
        suite.episode_set(track.name, seed=seed, split=split).episode_seed(episode)
        for track in suite.tracks
        for split in ("train", "validation", "test")
        for seed in range(3)
        for episode in range(5)
    }
    assert len(seeds) == len(suite.tracks) * 3 * 3 * 5


@pytest.mark.parametrize("name", ["nominal", "switching-physical", "saturated", "large-20"])
def test_an_environment_replays_an_episode_of_a_track(name):
    suite = get_suite("ptne-v1")
    track = suite.track(name)
    world = World(track.scenario)
    encoder = make_encoder(world, Interface("physical"))
    start = suite.episode_set(name, 3).initial_state(world)
    found = rollout(laws.Static(encoder.layout), encoder, start)

    env = ptne_env.parallel_env(track.scenario)
    law = laws.Static(env.layout)
    observations, _ = env.reset(seed=suite.episode_set(name).episode_seed(2))
    np.testing.assert_array_equal(env.estimates.T, start.estimates[:, :, 2])
    while env.agents:
        actions = {agent: law.predict(observation)[0] for agent, observation in observations.items()}
        observations, *_ = env.step(actions)
    error = np.linalg.norm(env.strategies - env.nash_equilibrium) / np.linalg.norm(env.nash_equilibrium)
    assert error == pytest.approx(found["strategy_distance"][-1, 2], rel=1e-12)


def test_a_team_of_two_static_laws_is_the_static_law():
    world = World(BASE)
    encoder = make_encoder(world, Interface("physical"))
    start = get_suite("ptne-v1").episode_set("mixed-team", 4).initial_state(world)
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
    physical, local = make_encoder(world, Interface("physical")), make_encoder(world, Interface("scaled"))
    one, other = Watching(physical.layout), Watching(local.layout)
    start = get_suite("ptne-v1").episode_set("mixed-team", 2).initial_state(world)
    rollout(one, physical, start, Member(other, local, (1, 3)))
    for policy, players in ((one, [0, 2, 4]), (other, [1, 3])):
        assert len(policy.seen) == BASE.steps
        for rows in policy.seen:
            assert policy.layout.select(rows, "player").argmax(axis=1).tolist() == players * 2


def test_teammates_act_in_place_of_the_policy():
    world = World(BASE)
    encoder = make_encoder(world, Interface("physical"))
    start = get_suite("ptne-v1").episode_set("mixed-team", 2).initial_state(world)
    zero, law = laws.ZeroInput(encoder.layout), laws.Static(encoder.layout)
    none, some, others = (
        rollout(zero, encoder, start, team)["input_energy"].sum(axis=0)
        for team in (None, Member(law, encoder, (1, 3)), Member(law, encoder, (0, 2, 4)))
    )
    assert np.all(none == 0)
    assert np.all(some > 0)
    assert np.all(others > 0)


@pytest.mark.parametrize("players", [(), (0, 0), (5,), (0, 1, 2, 3, 4)])
def test_teammates_are_some_of_the_players(players):
    with pytest.raises(ValueError, match="teammates are some"):
        Track("team", BASE, "A team.", teammates=Teammates(FactorySpec.of("ptne_env.laws:ZeroInput"), players))


def test_wrong_suites_are_refused():
    with pytest.raises(ValueError, match="unknown suite 'ptne-v0'; did you mean 'ptne-v1' or 'ptne-v2'"):
        get_suite("ptne-v0")
    with pytest.raises(ValueError, match="not a Suite"):
        get_suite("builtins:dict")
    with pytest.raises(ValueError, match="unknown track of suite ptne-v1 'nominl'; did you mean 'nominal'"):
        get_suite("ptne-v1").track("nominl")
    with pytest.raises(ValueError, match="different names"):
        small(tracks=())
    with pytest.raises(ValueError, match="is scored by digits, got 'digits_after_hold'"):
        Track("nominal", BASE, "The base.", "digits_after_hold")


def test_a_scenario_is_found_by_address_and_as_a_track(monkeypatch):
    monkeypatch.setitem(sys.modules, "mine", mine := ModuleType("mine"))
    mine.scenario, mine.suite, mine.number = BASE, small, 5
    mine.make = lambda: BASE
    assert find_scenario("mine:scenario") == find_scenario("mine:make") == BASE
    names = [track.name for track in comparison(["mine:scenario", "ptne-v1/delay", "energy"]).tracks]
    assert names == [BASE.name, get_suite("ptne-v1").track("delay").scenario.name, "energy"]
    with pytest.raises(ValueError, match="is a Suite: name one of its tracks, such as 'mine:suite/nominal'"):
        find_scenario("mine:suite")
    with pytest.raises(ValueError, match="'mine:number' is a int, not a Scenario"):
        find_scenario("mine:number")
    with pytest.raises(ValueError, match="'mine:scenario' is a Scenario, not a Suite: .* without --suite"):
        get_suite("mine:scenario")


def test_a_class_that_a_notebook_defines_again_makes_another_world(monkeypatch):
    notebook = ModuleType("notebook")
    monkeypatch.setitem(sys.modules, "notebook", notebook)
    notebook.ring = lambda: graphs.cycle(5)
    ring = FactorySpec.of("notebook:ring")
    track = Track("own", BASE.replace(topology=ring), "Own graph.")
    before = track.world
    assert track.world is before
    notebook.ring = lambda: graphs.complete(5)
    assert track.world is not before
    assert len(track.world.topology.graphs[0].edges) == 10
    notebook.suite = lambda: small(name="first")
    assert get_suite("notebook:suite") is get_suite("notebook:suite")
    notebook.suite = lambda: small(name="second")
    assert get_suite("notebook:suite").name == "second"


def test_suites_that_are_not_published_are_foreign():
    names = (
        "ptne-v1",
        "ptne_env.evaluation.ptne_v1:ptne_v1",
        "energy",
        "ptne-v1/delay",
        None,
        "mine:suite",
        "evil:s/t",
    )
    assert foreign_suites(*names) == ["mine:suite", "evil:s"]
