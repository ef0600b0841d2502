"""The suite ptne-v2: each of its tracks can still tell good policies from better."""

import numpy as np
import pytest

from ptne_env.evaluation import run_suite
from ptne_env.evaluation.leaderboard import ROOM
from ptne_env.evaluation.policy_specs import get_policy_spec
from ptne_env.evaluation.ptne_v2 import BASE, ptne_v2
from ptne_env.evaluation.saturation import ceiling_of
from ptne_env.evaluation.suite import MOST_DIGITS, SUITES, get_suite
from ptne_env.theory.ceilings import news_digits, sensor_digits

SUITE = ptne_v2()
SANITY = "clean"
SCORED = [track.name for track in SUITE.tracks if track.name != SANITY]
CROWDS = ["crowd-50", "crowd-200"]


def start_of(name, episodes=40):
    track = SUITE.track(name)
    return track.world, SUITE.episode_set(name, episodes).initial_state(track.world)


def test_the_suite_is_published_under_its_name():
    assert "ptne-v2" in SUITES
    assert get_suite("ptne-v2").name == "ptne-v2"


def test_tracks_draw_their_graph_or_name_it():
    fixed = {track.name for track in SUITE.tracks if not track.world.topology.is_random}
    assert fixed == {SANITY, "coupled", *CROWDS}
    assert BASE.channel.target == "ptne_env.world.channel:AdditiveNoise"


@pytest.mark.parametrize("name", SCORED)
def test_the_best_known_entry_leaves_a_digit_below_the_ceiling(name):
    track = SUITE.track(name)
    assert track.best_known is not None
    assert track.highest - track.best_known >= ROOM


@pytest.mark.parametrize("name", [name for name in SCORED if name not in CROWDS])
def test_the_best_known_entry_gains_a_digit(name):
    results = run_suite(SUITE, ["zero-input"], tracks=[name], episodes=5)
    zero = results.samples[name, "zero-input"][SUITE.track(name).metric].mean()
    assert SUITE.track(name).best_known - zero >= ROOM


@pytest.mark.parametrize("name", SCORED)
def test_stored_ceilings_are_those_of_the_theory(name):
    episodes = None if SUITE.track(name).ceiling is not None else 20
    found, _ = ceiling_of(SUITE, name, episodes)
    assert found <= SUITE.track(name).highest < found + 0.02


def test_strangers_and_their_noise_are_the_reason_of_a_ceiling():
    assert [track.name for track in SUITE.tracks if track.ceiling is not None] == ["strangers"]
    assert ceiling_of(SUITE, "strangers", 20)[1] == "teammates"
    assert ceiling_of(SUITE, "drift", 20) == (MOST_DIGITS, "floor")


def test_the_sensor_track_leaves_a_digit_to_policies_without_own_payoff():
    world, state = start_of("sensor", 200)
    bound = sensor_digits(world, state, world.clock.steps).mean()
    assert ROOM <= bound - SUITE.track("sensor").best_known < 2


@pytest.mark.parametrize("name", [track.name for track in SUITE.tracks])
def test_news_of_every_player_reach_every_other_in_time(name):
    world, state = start_of(name, 2 if name in CROWDS else 40)
    assert np.isinf(news_digits(world, state, world.clock.steps)).all()


@pytest.mark.parametrize(("name", "law"), [("clean", "routed"), ("sensor", "contact-relay"), ("coupled", "multi-rate")])
def test_best_known_digits_are_those_of_a_law(name, law):
    results = run_suite(SUITE, [get_policy_spec(law)], tracks=[name], episodes=30)
    measured = results.samples[name, law][SUITE.track(name).metric].mean()
    assert measured == pytest.approx(SUITE.track(name).full_marks, abs=0.4)


def test_the_equilibrium_of_the_coupled_track_is_a_variational_one():
    _, state = start_of("coupled")
    game, points = state.game, state.game.nash_equilibria
    assert np.abs(game.natural_residual(points)).max() < 1e-8
    prices = points[-2:]
    assert prices.min() >= 0
    assert (prices > 1e-6).any(axis=0).mean() > 0.5
