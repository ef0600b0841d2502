"""Leaderboards: scores, ranks and the tracks that they are taken over."""

import pytest
from small_suite import SMALL

from ptne_env import FactorySpec, PolicySpec
from ptne_env.experiments import Suite, Track, get_suite, run_suite
from ptne_env.experiments.suite import REFERENCES


def test_a_policy_that_does_not_fit_a_track_has_no_row_there():
    results = run_suite(SMALL, ["ppo-random-energy", "grounded"])
    board = results.leaderboard
    assert board.row("ring", "ppo-random-energy") is not None
    assert "neighbour slots: policy 2, environment 4" in results.not_applicable["complete", "ppo-random-energy"]
    assert board.row("complete", "ppo-random-energy") is None
    assert board.common == ("ring",)


def test_a_policy_for_fewer_than_half_of_the_tracks_does_not_narrow_the_scores_of_the_others():
    again = Track("again", SMALL.track("complete").scenario, "The same under another name.")
    board = run_suite(
        Suite("narrow", (*SMALL.tracks, again), episodes=2), ["ppo-random-energy", "grounded"]
    ).leaderboard
    assert board.common == ("ring", "complete", "again")
    assert {row.policy for row in board.overall} == {"grounded", *(policy.name for policy in REFERENCES)}
    assert board.row("ring", "ppo-random-energy").score is not None


def test_ranks_of_a_saturated_track_go_by_the_time_to_1e_6():
    fast = PolicySpec("fast", FactorySpec.of("ptne_env.laws:Grounded", kappa=3.0))
    tracks = ["nominal", "short-deadline"]
    results = run_suite(get_suite("ptne-v1"), ["grounded", fast, "aggregate-tracking"], tracks=tracks, episodes=20)
    board = results.leaderboard
    assert board.saturated == ("nominal",)
    rows = {name: board.row("nominal", name) for name in ("grounded", "fast", "static", "zero-input")}
    times = {name: row.fine_time for name, row in rows.items()}
    assert sorted(("grounded", "fast"), key=times.get) == sorted(("grounded", "fast"), key=lambda name: rows[name].rank)
    assert times["zero-input"] == pytest.approx(1.2)
    assert rows["zero-input"].rank == 5
    # Its strategies settle early, but its estimates, which are scored, do not.
    aggregate = board.row("nominal", "aggregate-tracking")
    assert aggregate.fine_time < times["static"]
    assert aggregate.rank == 4
    assert board.row("nominal", "oracle").rank is None
    by_digits = sorted(rows, key=lambda name: board.row("short-deadline", name).rank)
    digits = [results.record("short-deadline", name, "digits")["mean"] for name in by_digits]
    assert digits == sorted(digits, reverse=True)


def test_scores_are_0_for_zero_input_and_1_for_the_law():
    board = run_suite(SMALL, ["grounded"]).leaderboard
    for track in ("ring", "complete"):
        assert board.row(track, "zero-input").score.mean == pytest.approx(0, abs=1e-12)
        assert board.row(track, "static").score.mean == pytest.approx(1)
        assert board.row(track, "static").improvement.mean == 0.5
    overall = {row.policy: row for row in board.overall}
    assert overall["static"].improvement.mean == 0.5
    assert overall["zero-input"].improvement.mean == 0
    assert overall["oracle"].mean_rank is None
    assert [row.score.mean for row in board.overall] == sorted((row.score.mean for row in board.overall), reverse=True)
