"""Saturation of suites on small ones, and the agreement of rankings."""

from dataclasses import replace

import pytest

from ptne_env import FactorySpec, get_scenario
from ptne_env.evaluation import run_suite
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.jobs import Job
from ptne_env.evaluation.policy_specs import get_policy_spec
from ptne_env.evaluation.saturation import agreement, ceiling_of, closed_tracks
from ptne_env.evaluation.suite import MOST_DIGITS, Suite, Teammates, Track

BASE = get_scenario("random-energy")
NOISE = FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=0.05)


def suite_of(*tracks):
    return Suite("small-v2", tracks, episodes=4)


def test_a_track_without_room_above_or_below_is_closed():
    suite = suite_of(
        Track("floor", BASE, "The best laws reach the floor."),
        Track("open", BASE.replace(channel=NOISE), "Noise."),
        Track("known", BASE.replace(channel=NOISE), "Noise, and a best known entry near the ceiling.", best_known=11.5),
        Track("still", BASE.replace(input_limit=1e-3), "Inputs that move nothing."),
    )
    closed = closed_tracks(run_suite(suite, ["routed-unknown", "grounded"]).leaderboard.scales)
    assert set(closed) == {"floor", "known", "still"}
    assert closed["floor"] == "0.00 digits are left above the best known honest entry"
    assert "gains 0.00 digits" in closed["still"]


def test_a_ceiling_of_reach_is_found_and_counts_as_the_highest_digits():
    suite = suite_of(Track("slow", BASE.replace(input_limit=0.5), "Inputs that are too small."))
    digits, reason = ceiling_of(suite, "slow")
    assert reason == "reach"
    results = run_suite(suite, ["oracle"])
    assert results.samples["slow", "oracle"]["digits"].mean() <= digits < 2


@pytest.mark.parametrize(("law", "reason"), [("Static", "teammates"), ("Grounded", "floor")])
def test_only_static_teammates_have_a_ceiling(law, reason):
    team = Teammates(FactorySpec.of(f"ptne_env.laws:{law}", kappa=2.0), (1,))
    suite = suite_of(Track("team", BASE.replace(channel=NOISE), "A team.", teammates=team))
    assert ceiling_of(suite, "team")[1] == reason


def test_without_a_bound_the_floor_is_the_ceiling():
    assert ceiling_of(suite_of(Track("base", BASE, "The base.")), "base") == (MOST_DIGITS, "floor")


def test_a_ranking_agrees_with_itself_and_not_with_its_reverse():
    suite = suite_of(Track("base", BASE.replace(channel=NOISE), "Noise."))
    policies = ["grounded", "adaptive", "corollary-one"]
    first, second = (run_suite(suite, policies, seed=seed).leaderboard for seed in (0, 1))
    assert agreement(first, first) == pytest.approx(1)
    assert agreement(first, second) > 0.5
    turned = replace(
        second,
        overall=tuple(replace(row, score=replace(row.score, mean=-row.score.mean)) for row in second.overall),
    )
    assert agreement(second, turned) == pytest.approx(-1)


def test_the_scale_of_scores_leaves_stored_jobs_valid():
    track = Track("base", BASE, "The base.")
    keys = {
        Job(replace(track, best_known=known, ceiling=ceiling), get_policy_spec("static"), 0, EpisodeSet(2)).key
        for known, ceiling in ((None, None), (3.0, None), (3.0, 4.0))
    }
    assert len(keys) == 1
