"""Leaderboards: scores over all tracks, ranks, and intervals."""

from dataclasses import replace

import numpy as np
import pytest
from small_suite import SMALL

from ptne_env import FactorySpec, PolicySpec, evaluate
from ptne_env.bench import leaderboard
from ptne_env.bench.leaderboard import improvements
from ptne_env.evaluation import Results, get_policy_spec


def board_of(digits, tracks=SMALL.tracks, **policies):
    """The leaderboard of made-up digits by policy, a list of arrays (training seeds, episodes) per track."""
    specs = {name: get_policy_spec(name) for name in ("zero-input", "static", "oracle")} | policies
    samples = {
        (track.name, name): {"digits": np.array(values[index], dtype=float)}
        for name, values in digits.items()
        for index, track in enumerate(tracks)
        if values[index] is not None
    }
    sets = {track.name: replace(SMALL.episode_set("ring"), track=("small", track.name)) for track in tracks}
    return leaderboard(Results("small", None, tuple(tracks), specs, sets, samples, {}, {}))


NULL, LAW, ORACLE = [[[0.0, 0.0]]] * 2, [[[4.0, 4.0]], [[2.0, 2.0]]], [[[12.0, 12.0]]] * 2
REFERENCES = {"zero-input": NULL, "static": LAW, "oracle": ORACLE}


def overall(board):
    return {row.policy: row for row in board.overall}


def entry(name, seeds=1):
    spec = FactorySpec.of("law:grounded")
    return PolicySpec(name, (spec,) * seeds if seeds > 1 else spec)


def test_the_score_is_the_mean_over_tracks_of_the_share_of_twelve_digits_above_zero_input():
    board = board_of(REFERENCES | {"zero-input": [[[0.0, 0.0]], [[-8.0, -8.0]]]})
    assert overall(board)["static"].score.mean == pytest.approx((4 / 12 + 10 / 20) / 2)
    assert overall(board)["zero-input"].score.mean == 0
    assert overall(board)["oracle"].score.mean == pytest.approx(1)


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
    board = board_of(REFERENCES | {"mine": [seeds, seeds]}, mine=entry("mine", seeds=3))
    score, by_track = overall(board)["mine"].score, board.row(SMALL.tracks[0].name, "mine").score
    assert score.high - score.low == pytest.approx(by_track.high - by_track.low)


def test_entries_are_ranked_without_oracles_and_ties_share_a_rank():
    digits = REFERENCES | {"mine": [[[5.0, 5.0]]] * 2, "same": [[[5.0, 5.0]]] * 2}
    board = board_of(digits, mine=entry("mine"), same=entry("same"))
    assert [row.policy for row in board.overall] == ["mine", "same", "static", "zero-input", "oracle"]
    assert [row.mean_rank for row in board.overall] == [1, 1, 3, 4, None]
    assert board.row("ring", "oracle").rank is None


def test_a_comparison_has_no_leaderboard():
    assert leaderboard(evaluate("static", SMALL.tracks[0], episodes=1)) is None


def test_paired_improvement_compares_the_same_episodes():
    x, y = np.array([[1.0, 2.0, 3.0, 4.0]]), np.array([[0.5, 1.5, 3.0, 5.0]])
    assert improvements(x, y).tolist() == [[1, 1, 0.5, 0]]
    assert improvements(np.vstack([x, x + 9]), y).mean() == pytest.approx((2.5 / 4 + 1) / 2)
