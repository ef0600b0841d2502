"""Leaderboards: scores over all tracks, ranks, and intervals."""

from dataclasses import replace

import numpy as np
import pytest
from small_suite import SMALL

from ptne_env import FactorySpec, PolicySpec, evaluate
from ptne_env.evaluation import Results, get_policy_spec
from ptne_env.suites import leaderboard


def board_of(digits, tracks=SMALL.tracks, on_the_way=None, **policies):
    """The leaderboard of made-up digits by policy, a list of arrays (training seeds, episodes) per track, by policy."""
    specs = {name: get_policy_spec(name) for name in ("zero-input", "static", "oracle")} | policies
    samples = {}
    for name, values in digits.items():
        for track, reached in zip(tracks, values, strict=True):
            if reached is not None:
                array = np.array(reached, dtype=float)
                samples[track.name, name] = {
                    "digits": array,
                    "digits_on_the_way": np.full_like(array, (on_the_way or {}).get(name, 0.0)),
                }
    sets = {track.name: replace(SMALL.episode_set("ring"), track=("small", track.name)) for track in tracks}
    rows = leaderboard(Results("small", tuple(tracks), specs, sets, samples, {}, {}))
    return None if rows is None else {row.policy: row for row in rows}


NULL, LAW, ORACLE = [[[0.0, 0.0]]] * 2, [[[4.0, 4.0]], [[2.0, 2.0]]], [[[12.0, 12.0]]] * 2
REFERENCES = {"zero-input": NULL, "static": LAW, "oracle": ORACLE}


def entry(name, seeds=1):
    spec = FactorySpec.of("law:grounded")
    return PolicySpec(name, (spec,) * seeds if seeds > 1 else spec)


def test_the_score_is_the_mean_of_digits_over_the_scored_tracks():
    board = board_of(REFERENCES)
    assert {name: row.score.mean for name, row in board.items()} == {"static": 3, "zero-input": 0, "oracle": 12}
    assert list(board) == ["static", "zero-input", "oracle"]
    ring, complete = SMALL.tracks
    half = board_of(REFERENCES, tracks=(replace(ring, scored=False), complete))
    assert half["static"].score.mean == 2
    assert board_of(REFERENCES, tracks=[replace(track, scored=False) for track in SMALL.tracks]) is None


def test_a_track_without_numbers_counts_as_zero_input():
    board = board_of(REFERENCES | {"half": [[[6.0, 6.0]], None]}, on_the_way={"half": 5.0}, half=entry("half"))
    assert board["half"].score.mean == 3
    assert board["half"].on_the_way.mean == 2.5
    assert board["half"].mean_rank == (1 + 2) / 2  # beside zero input on the second track


def test_training_seeds_are_shared_by_all_tracks():
    seeds = np.array([-1.0, 0.0, 1.0])[:, None] * np.ones((3, 2)) + 6
    both, one = (
        board_of({name: found[:count] for name, found in digits.items()}, SMALL.tracks[:count], mine=entry("mine", 3))
        for digits in [REFERENCES | {"mine": [seeds, seeds]}]
        for count in (2, 1)
    )
    half = [board["mine"].score.high - board["mine"].score.mean for board in (both, one)]
    assert half[0] == pytest.approx(half[1])


def test_entries_are_ranked_without_oracles_and_ties_share_a_rank():
    digits = REFERENCES | {"mine": [[[5.0, 5.0]]] * 2, "same": [[[5.004, 5.0]]] * 2}
    board = board_of(digits, mine=entry("mine"), same=entry("same"))
    assert list(board) == ["mine", "same", "static", "zero-input", "oracle"]
    assert [row.mean_rank for row in board.values()] == [1, 1, 3, 4, None]


@pytest.mark.parametrize(
    ("digits", "first"),
    [
        pytest.param(4.998, "fast", id="equal to two decimals"),
        pytest.param(4.98, "slow", id="equal to one decimal"),
    ],
)
def test_of_equal_digits_to_two_decimals_the_larger_digits_on_the_way_are_better(digits, first):
    made = REFERENCES | {"slow": [[[5.0, 5.0]]] * 2, "fast": [[[digits, digits]]] * 2}
    board = board_of(made, slow=entry("slow"), fast=entry("fast"), on_the_way={"fast": 3.0, "slow": 1.0})
    second = ({"fast", "slow"} - {first}).pop()
    assert list(board)[:2] == [first, second]
    assert [board[name].mean_rank for name in (first, second)] == [1, 2]


def test_the_worst_tenth_is_the_mean_over_tracks():
    spread = [[*range(10), *range(10)]]
    board = board_of(REFERENCES | {"mine": [spread, spread]}, mine=entry("mine"))
    assert (board["mine"].score.mean, board["mine"].worst_tenth.mean) == (4.5, 0)
    assert board["mine"].worst_tenth.low is not None


def test_a_policy_that_acts_nowhere_has_no_row():
    board = board_of(REFERENCES | {"static": [[[-1.0, -1.0]]] * 2, "unfit": [None, None]}, unfit=entry("unfit"))
    assert "unfit" not in board
    assert [board[name].mean_rank for name in ("zero-input", "static")] == [1, 2]


def test_a_comparison_has_no_leaderboard():
    assert leaderboard(evaluate("static", SMALL.tracks[0], episodes=1)) is None
