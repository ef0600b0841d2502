"""How much the tracks of ptne-v1 differ, and how sure its ranking is: ``python -m baselines.ranking``.

It prints the pairs of scored tracks with the largest Spearman correlations over the entries with which
the suite was designed, and Kendall's τ between the rankings of all entries by score with two seeds of the episodes.
Oracles are no entries. Finished jobs are kept
in the folder ``--out``, which is that of ``publish``, and not run again.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

from scipy import stats

from ptne_env.evaluation import ENTERED, POLICIES, Results
from ptne_env.execution import Runner, Workers
from ptne_env.suites import leaderboard, run_suite

SEEDS = (0, 1)
"""Of the episodes of the two rankings."""

LATER = ("recurrent-random-worlds",)
"""Entries that came when the suite stood: it was not designed with them, and does not change with them."""


def correlations(digits: Mapping[str, Mapping[str, float]]) -> list[tuple[float, str, str]]:
    """Spearman's correlation of every pair of tracks over the policies that act on both, the largest first.

    Args:
        digits: mean digits by track and policy; they count to two decimals.
    """
    pairs = []
    for first, second in combinations(digits, 2):
        both = digits[first].keys() & digits[second].keys()
        values = [[round(digits[track][name], 2) for name in both] for track in (first, second)]
        pairs.append((float(stats.spearmanr(*values).statistic), first, second))
    return sorted(pairs, reverse=True)


def digits_of(results: Results) -> dict[str, dict[str, float]]:
    """The mean digits on every scored track of the entries with which the suite was designed."""
    return {
        track.name: {
            name: digits.mean
            for name, digits in results.ranked(track.name).items()
            if digits.mean is not None and name not in LATER and not results.policies[name].is_oracle
        }
        for track in results.tracks
        if track.scored
    }


def agreement(first: Results, second: Results) -> float:
    """Kendall's τ between the rankings by score of two runs."""
    orders = [
        [row.policy for row in leaderboard(results) or () if row.mean_rank is not None] for results in (first, second)
    ]
    return float(stats.kendalltau(range(len(orders[0])), [orders[1].index(name) for name in orders[0]]).statistic)


def main() -> None:
    """Run what is missing, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results" / "published")
    parser.add_argument("--episodes", type=int, help="the suite's own number if left out")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--pairs", type=int, default=10)
    given = parser.parse_args()
    runner = Runner(given.out, Workers(given.jobs))
    entered = [POLICIES[name] for name in ENTERED]
    first, second = (run_suite("ptne-v1", entered, episodes=given.episodes, seed=seed, run=runner) for seed in SEEDS)
    for value, *tracks in correlations(digits_of(first))[: given.pairs]:
        print(f"Spearman {value:.3f}  {' and '.join(tracks)}")
    print(f"Kendall's tau between seeds {SEEDS[0]} and {SEEDS[1]}: {agreement(first, second):.3f}")


if __name__ == "__main__":
    main()
