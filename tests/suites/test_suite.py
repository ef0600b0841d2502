"""Suites: seeded episodes that an environment can replay, and scenarios by the names of tracks."""

import sys
from hashlib import sha256
from types import ModuleType

import numpy as np
import pytest
from small_suite import BASE, SMALL, TEAMS

import ptne_env
from ptne_env import evaluate, get_scenario, laws
from ptne_env.envs.gymnasium import JointEnv, JointVectorEnv
from ptne_env.evaluation import POLICIES, PolicySpec, Track
from ptne_env.evaluation.episodes import track_seed
from ptne_env.evaluation.tracks import compared_tracks
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.parts import PARTS, foreign_targets
from ptne_env.suites import Suite, get_suite, leaderboard, run_suite
from ptne_env.world.catalogue import scenario_names


def test_every_track_of_ptne_v1_is_a_valid_world_of_the_library_with_a_sentence():
    suite = get_suite("ptne-v1")
    assert len(suite.tracks) > 10
    for track in suite.tracks:
        assert track.change.endswith(".")
        assert "\n" not in track.change
        assert foreign_targets(track.to_dict()) == []
        Encoder(track.world, laws.Static.interface)


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


def test_wrong_suites_are_refused():
    with pytest.raises(ValueError, match="unknown suite 'ptne-v0'; did you mean 'ptne-v1'"):
        get_suite("ptne-v0")
    with pytest.raises(ValueError, match="not a Suite"):
        get_suite("builtins:dict")
    with pytest.raises(ValueError, match="unknown track of suite ptne-v1 'nominl'; did you mean 'nominal'"):
        get_suite("ptne-v1").track("nominl")
    with pytest.raises(ValueError, match="different names"):
        Suite("empty", ())


def test_scenarios_and_suites_are_found_by_name_and_address(monkeypatch):
    monkeypatch.setitem(sys.modules, "mine", mine := ModuleType("mine"))
    mine.suite, mine.make, mine.scenario = SMALL, lambda: SMALL, BASE
    assert get_suite("mine:suite") is get_suite("mine:make") is SMALL
    assert get_scenario("mine:suite/ring") == get_scenario("mine:scenario") == BASE
    assert get_scenario("ptne-v1/rounding") == get_suite("ptne-v1").track("rounding").scenario
    assert {*ptne_env.CATALOGUE, "ptne-v1/rounding"} < set(scenario_names())
    with pytest.raises(ValueError, match="some of its players follow a fixed policy; only ptne_env.evaluate and"):
        get_scenario("small_suite:TEAMS/strangers")


@pytest.mark.parametrize("form", [ptne_env.parallel_env, ptne_env.VectorParallelEnv, JointEnv, JointVectorEnv])
def test_every_form_takes_the_name_of_a_track_and_refuses_one_with_teammates(form):
    assert form("ptne-v1/rounding").scenario == get_scenario("ptne-v1/rounding")
    with pytest.raises(ValueError, match="'strangers' is more than its scenario: some of its players follow a fixed"):
        form("small_suite:TEAMS/strangers")


def test_evaluate_plays_a_track_by_its_name_as_the_suite_does():
    mine = {"law": "grounded"}
    names = ["small_suite:TEAMS/strangers", "ptne-v1/rounding", "energy"]
    results = evaluate(mine, names, episodes=2)
    assert [track.name for track in results.tracks] == names
    assert results.episode_sets["ptne-v1/rounding"] == get_suite("ptne-v1").episode_set("rounding", 2)
    expected = run_suite(TEAMS, mine, episodes=2).samples["strangers", "law"]["digits"]
    np.testing.assert_array_equal(results.samples[names[0], "law"]["digits"], expected)
    assert leaderboard(results) is None
    assert compared_tracks(["ptne-v1/rounding"]).popitem()[1].count == 60


def test_evaluate_plays_a_suite_and_its_name(monkeypatch):
    monkeypatch.setitem(PARTS, "suite:small-v1", "small_suite:SMALL")
    by_name, by_object = (evaluate("grounded", suite, episodes=1) for suite in ("small-v1", SMALL))
    assert by_name.episode_sets == by_object.episode_sets == run_suite(SMALL, "grounded", episodes=1).episode_sets
    assert list(by_object.policies) == ["grounded", "zero-input", "static", "oracle"]


def test_a_run_includes_the_reference_policies_and_refuses_their_names():
    results = run_suite(SMALL, ["grounded"], tracks="ring", episodes=2)
    assert list(results.policies) == ["grounded", "zero-input", "static", "oracle"]
    assert results.episodes == {"ring": 2}
    with pytest.raises(ValueError, match="'static' is the name of a reference policy"):
        run_suite(SMALL, [PolicySpec("static", POLICIES["grounded"].policy)])


def test_a_reference_policy_that_fails_ends_the_run(monkeypatch):
    monkeypatch.setattr(laws.Static, "inputs", lambda law, observation, memory: (1 / 0, memory))
    with pytest.raises(RuntimeError, match=r"reference policy 'static' fails on track 'ring': step 0: ZeroDivision"):
        run_suite(SMALL, [], tracks="ring")


@pytest.mark.parametrize(
    "track", [track for track in get_suite("ptne-v1").tracks if track.name != "nominal"], ids=lambda t: t.name
)
def test_links_of_tracks_have_a_range_and_noise_that_drowns_low_order_bits(track):
    state = get_suite("ptne-v1").episode_set(track.name, 100).initial_state(track.world)
    largest = max(np.abs(state.estimates).max(), np.abs(state.game.nash_equilibria).max())
    assert 3 <= track.scenario.message_range / largest <= 5.01
    last = track.world.channel.stages[-1]
    resolution = track.scenario.message_range * np.finfo(np.float32).eps
    assert getattr(last, "std", 0.0) > 50 * resolution or getattr(last, "width", 0.0) > 50 * resolution


def test_every_policy_runs_on_every_track_of_ptne_v1_or_has_a_reason():
    def short(track):
        even = {"steps": 60, "spacing": "transformed"}  # no step is longer than a dwell
        changes = even if track.name == "switching-transformed" else {"steps": 15}
        return Track(track.name, track.scenario.replace(**changes), track.change)

    suite = Suite("short", tuple(map(short, get_suite("ptne-v1").tracks)))
    results = run_suite(suite, POLICIES.values(), episodes=1)
    assert not results.failures
    for samples in results.samples.values():
        assert np.isfinite(samples["digits"]).all()
    refused = {policy for _, policy in results.not_applicable}
    assert refused == {name for name in POLICIES if name.startswith("ppo-")}
    assert len(results.samples) + len(results.not_applicable) == len(suite.tracks) * len(POLICIES)
