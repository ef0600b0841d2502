"""Leaderboards: scores over all tracks, ranks by division, and the room that tracks leave."""

import time
from dataclasses import replace

import numpy as np
import pytest
from ptne_env.evaluation.leaderboard import leaderboard
from small_suite import SMALL

from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import Suite, get_policy_spec, get_suite, run_suite
from ptne_env.perception.observation import Interface


def board_of(digits, tracks=SMALL.tracks, **policies):
    """The leaderboard of made-up digits by policy, a list of arrays (training seeds, episodes) per track."""
    specs = {name: get_policy_spec(name) for name in ("zero-input", "static", "oracle")} | policies
    samples = {
        (track.name, name): {
            "digits": np.array(values[index], dtype=float),
            "settling_time_1e_6": np.full(np.shape(values[index]), np.nan),
            "estimate_distance": 10.0 ** -np.array(values[index], dtype=float),
        }
        for name, values in digits.items()
        for index, track in enumerate(tracks)
        if values[index] is not None
    }
    return leaderboard(tracks, specs, samples)


NULL, LAW, ORACLE = [[[0.0, 0.0]]] * 2, [[[4.0, 4.0]], [[2.0, 2.0]]], [[[12.0, 12.0]]] * 2
REFERENCES = {"zero-input": NULL, "static": LAW, "oracle": ORACLE}


def overall(board):
    return {row.policy: row for row in board.overall}


def entry(name, **interface):
    return PolicySpec(name, "object", Interface(**interface))


def test_the_score_is_the_mean_over_tracks_of_the_share_of_full_marks():
    tracks = (replace(SMALL.tracks[0], best_known=8.0), SMALL.tracks[1])
    board = board_of(REFERENCES, tracks)
    assert [scale.full_marks for scale in board.scales] == [8.0, 12.0]
    assert overall(board)["static"].score.mean == pytest.approx((4 / 8 + 2 / 12) / 2)
    assert overall(board)["zero-input"].score.mean == 0
    assert overall(board)["oracle"].score.mean == pytest.approx((12 / 8 + 1) / 2)  # a new best known


def test_a_track_without_numbers_counts_as_zero_input():
    board = board_of(REFERENCES | {"half": [[[6.0, 6.0]], None]}, half=entry("half"))
    assert overall(board)["half"].score.mean == pytest.approx(6 / 12 / 2)
    assert overall(board)["half"].mean_rank == (1 + 2) / 2  # beside zero input on the second track
    assert overall(board)["half"].improvement.mean == 0.5
    assert board.row(SMALL.tracks[1].name, "half") is None


def test_a_policy_that_diverges_has_a_negative_score():
    board = board_of(REFERENCES | {"wild": [[[12.0, 12.0]], [[-9.0, -9.0]]]}, wild=entry("wild"))
    assert overall(board)["wild"].score.mean == pytest.approx((12 - 9) / 24)
    assert board.row(SMALL.tracks[1].name, "wild").score.mean == pytest.approx(-9 / 12)


def test_every_track_counts_the_same_and_none_is_trimmed():
    tracks = tuple(replace(SMALL.tracks[0], name=f"track-{index}") for index in range(20))
    digits = {"zero-input": [[[0.0]]] * 20, "static": [[[4.0]]] * 20, "oracle": [[[12.0]]] * 20}
    whole, wild = [[[12.0]]] * 20, [[[12.0]]] * 17 + [[[-9.0]]] * 3
    board = board_of(digits | {"whole": whole, "wild": wild}, tracks, whole=entry("whole"), wild=entry("wild"))
    scores = {name: row.score.mean for name, row in overall(board).items()}
    assert scores["whole"] - scores["wild"] == pytest.approx(3 * 21 / 12 / 20)


def test_the_interval_of_a_score_holds_the_spread_of_zero_input():
    generator = np.random.default_rng(0)
    null = generator.normal(size=(2, 1, 400))
    board = board_of(REFERENCES | {"zero-input": null, "static": np.full((2, 1, 400), 6.0), "oracle": null + 12.0})
    score = overall(board)["static"].score
    # d score/d zero = (score − 1)/12, so the standard error is (1 − 1/2)/12/√800.
    assert score.high - score.low == pytest.approx(2 * 1.96 * 0.5 / 12 / np.sqrt(800), rel=0.1)
    zero = overall(board)["zero-input"].score
    assert (zero.low, zero.high) == pytest.approx((0, 0), abs=1e-12)


def test_training_seeds_are_shared_by_all_tracks():
    seeds = np.array([-1.0, 0.0, 1.0])[:, None] * np.ones((3, 2)) + 6
    board = board_of(REFERENCES | {"mine": [seeds, seeds]}, mine=replace(entry("mine"), policy=("a", "b", "c")))
    score, by_track = overall(board)["mine"].score, board.row(SMALL.tracks[0].name, "mine").score
    assert score.high - score.low == pytest.approx(by_track.high - by_track.low)


def test_honest_entries_are_ranked_without_coded_ones_and_oracles():
    digits = REFERENCES | {"code": [[[12.0, 12.0]]] * 2, "weak-code": [[[1.0, 1.0]]] * 2, "mine": [[[5.0, 5.0]]] * 2}
    coded = entry("code")
    board = board_of(digits, code=coded, mine=entry("mine"), **{"weak-code": replace(coded, name="weak-code")})
    rows = overall(board)
    assert [row.policy for row in board.overall] == ["mine", "static", "zero-input", "code", "weak-code", "oracle"]
    assert [row.mean_rank for row in board.overall] == [1, 2, 3, 1, 2, None]
    assert rows["code"].score.mean == 1
    assert board.scales[0].best == "mine"


def test_the_room_of_a_track_is_the_distance_from_the_best_honest_entry_to_the_ceiling():
    tracks = (replace(SMALL.tracks[0], best_known=5.0, ceiling=9.0), SMALL.tracks[1])
    board = board_of(REFERENCES | {"code": ORACLE}, tracks, code=entry("code"))
    first, second = board.scales
    assert (first.best, first.best_digits, first.highest, first.room) == ("static", 4.0, 9.0, 4.0)
    assert (second.best_digits, second.highest, second.room) == (2.0, 12.0, 10.0)


def test_a_track_on_which_zero_input_has_full_marks_has_no_scores():
    board = board_of(REFERENCES | {"zero-input": [[[11.95, 11.95]], [[0.0, 0.0]]]})
    assert [scale.has_scores for scale in board.scales] == [False, True]
    assert board.row(SMALL.tracks[0].name, "static").score is None
    assert overall(board)["static"].score.mean == pytest.approx(2 / 12)


def test_ranks_of_a_saturated_track_go_by_the_time_to_1e_6():
    fast = PolicySpec("fast", FactorySpec.of("ptne_env.laws:Grounded", kappa=3.0))
    tracks = ["nominal", "short-deadline"]
    results = run_suite(get_suite("ptne-v1"), ["grounded", fast], tracks=tracks, episodes=20)
    board = results.leaderboard
    assert board.saturated == ("nominal",)
    rows = {name: board.row("nominal", name) for name in ("grounded", "fast", "static", "zero-input")}
    times = {name: row.fine_time for name, row in rows.items()}
    assert sorted(("grounded", "fast"), key=times.get) == sorted(("grounded", "fast"), key=lambda name: rows[name].rank)
    assert times["zero-input"] == pytest.approx(1.2)
    assert rows["zero-input"].rank == 4
    assert board.row("nominal", "oracle").rank is None
    by_digits = sorted(rows, key=lambda name: board.row("short-deadline", name).rank)
    digits = [results.record("short-deadline", name, "digits")["mean"] for name in by_digits]
    assert digits == sorted(digits, reverse=True)


def test_a_policy_for_one_track_has_its_digits_there_and_nothing_elsewhere():
    results = run_suite(SMALL, ["ppo-random-energy", "grounded"])
    board = results.leaderboard
    assert "neighbour slots: policy 2, environment 4" in results.not_applicable["complete", "ppo-random-energy"]
    assert board.row("complete", "ppo-random-energy") is None
    score = board.row("ring", "ppo-random-energy").score.mean
    assert overall(board)["ppo-random-energy"].score.mean == pytest.approx(score / 2)


def test_best_known_and_ceiling_leave_the_hash_of_published_suites_alone():
    suite = get_suite("ptne-v1")
    assert suite.content_hash.startswith("3a1aedf1")
    assert {track.full_marks for track in suite.tracks} == {12.0}
    known = Suite("known", (replace(SMALL.tracks[0], best_known=8.0),))
    assert known.content_hash != Suite("known", SMALL.tracks[:1]).content_hash


@pytest.mark.parametrize(
    ("digits", "message"),
    [
        ({"best_known": 12.5}, "best_known of track 'ring' is a number of digits from -12 to 12, got 12.5"),
        (
            {"best_known": 9.0, "ceiling": 8.0},
            "best_known of track 'ring' is a number of digits from -12 to 8, got 9.0",
        ),
        ({"ceiling": float("nan")}, "ceiling of track 'ring' is a number"),
    ],
)
def test_digits_of_a_track_that_cannot_be_are_refused(digits, message):
    with pytest.raises(ValueError, match=message):
        replace(SMALL.tracks[0], **digits)


def test_a_leaderboard_of_29_policies_on_20_tracks_takes_seconds():
    tracks = tuple(replace(SMALL.tracks[0], name=f"track-{index}") for index in range(20))
    generator = np.random.default_rng(0)
    shapes = {"zero-input": 1, "static": 1, "oracle": 1} | {f"policy-{index}": 5 for index in range(26)}
    digits = {name: generator.normal(size=(20, seeds, 200)) for name, seeds in shapes.items()}
    policies = {name: replace(entry(name), policy=("a",) * 5) for name, seeds in shapes.items() if seeds == 5}
    start = time.process_time()
    board_of(digits, tracks, **policies)
    assert time.process_time() - start < 10
