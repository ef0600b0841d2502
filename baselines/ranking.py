"""How much the tracks of ptne-v1 differ, and how sure its ranking is: ``python -m baselines.ranking``.

It prints the share of the variance between the best entries that the first principal component over the scored tracks
explains, the best entry of each track with its lead over the second, and Kendall's τ between the rankings of all
entries by score with two seeds of the episodes. Entries are the policies that have a rank. Finished jobs are kept in
the folder ``--out``, which is that of ``publish``, and not run again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import stats

from baselines.published import interval_of, with_interval
from ptne_env.evaluation import ENTERED, POLICIES, Results
from ptne_env.execution import Runner, Workers
from ptne_env.suites import leaderboard, run_suite

SEEDS = (0, 1)
"""Of the episodes of the two rankings."""

BEST = 8
"""The number of entries that are compared."""


def principal_share(digits: npt.ArrayLike) -> float:
    """The share of the variance that the first principal component explains of digits (entries, tracks).

    Every track has the same weight, so its digits are divided by their standard deviation over the entries.
    """
    variances = np.linalg.svd(stats.zscore(np.asarray(digits), axis=0), compute_uv=False) ** 2
    return float(variances[0] / variances.sum())


def entries(results: Results) -> list[str]:
    """The entries that have a rank, the best score first."""
    return [row.policy for row in leaderboard(results) or () if row.mean_rank is not None]


def best_entries(results: Results) -> list[str]:
    """The best entries by score that play every scored track."""
    tracks = results.counted_tracks
    return [name for name in entries(results) if all((track, name) in results.samples for track in tracks)][:BEST]


def leads(results: Results) -> list[str]:
    """A line for each scored track: the best entry, and its lead over the second in the same episodes."""
    lines = []
    for track in results.counted_tracks:
        first, second, *_ = [name for name in results.ranked(track) if results.policies[name].is_ranked]
        lead = results.difference(first, second, track)
        verb = "leads" if lead.is_above_zero else "cannot be told from"
        lines.append(f"{track}: {first} {verb} {second}, by {with_interval(interval_of(lead))}")
    return lines


def agreement(first: Results, second: Results) -> float:
    """Kendall's τ between the rankings by score of two runs."""
    order, other = entries(first), entries(second)
    return float(stats.kendalltau(range(len(order)), [other.index(name) for name in order]).statistic)


def main() -> None:
    """Run what is missing, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results" / "published")
    parser.add_argument("--episodes", type=int, help="the suite's own number if left out")
    parser.add_argument("--jobs", type=int, default=-1)
    arguments = parser.parse_args()
    runner = Runner(arguments.out, Workers(arguments.jobs))
    entered = [POLICIES[name] for name in ENTERED]
    first, second = (
        run_suite("ptne-v1", entered, episodes=arguments.episodes, seed=seed, run=runner) for seed in SEEDS
    )
    names = best_entries(first)
    digits = [[first.samples[track, name]["digits"].mean() for track in first.counted_tracks] for name in names]
    print(f"First principal component: {principal_share(digits):.2f} of the variance between {', '.join(names)}")
    print(*leads(first), sep="\n")
    print(f"Kendall's tau between seeds {SEEDS[0]} and {SEEDS[1]}: {agreement(first, second):.3f}")


if __name__ == "__main__":
    main()
