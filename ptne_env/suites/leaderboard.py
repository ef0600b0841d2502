"""Leaderboards of suites: the score, mean regret and mean rank of every policy over the scored tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptne_env.evaluation.results import Results, standing
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.suites.suite import ZERO


@dataclass(frozen=True)
class Row:
    """One policy over the scored tracks; where it cannot act or failed, it counts as zero input.

    Attributes:
        policy: name.
        score: mean digits.
        mean_regret: over the tracks whose games have best responses.
        mean_rank: of the ranks by digits, 1 being best, and by mean regret where digits are equal to two decimals;
            ``None`` for oracles.
    """

    policy: str
    score: Summary
    mean_regret: Summary
    mean_rank: float | None


def leaderboard(results: Results) -> tuple[Row, ...] | None:
    """The rows of a suite, the best first and oracles last; ``None`` for a comparison, and without a scored track.

    A policy that acts on no scored track has no row.
    """
    tracks = [track.name for track in results.tracks if track.scored]
    if results.is_comparison or not tracks:
        return None
    acting = [name for name in results.policies if any((track, name) in results.samples for track in tracks)]
    ranked = [name for name in acting if not results.policies[name].is_oracle]
    ranks: dict[str, list[int]] = {name: [] for name in ranked}
    for track in tracks:
        standings = {name: results.standing(track, _counted(results, track, name)) for name in ranked}
        for name, mine in standings.items():
            ranks[name].append(1 + sum(other < mine for other in standings.values()))
    rows = [
        Row(
            name,
            _over_tracks(results, tracks, name, "digits"),
            _over_tracks(results, tracks, name, "mean_regret"),
            float(np.mean(ranks[name])) if name in ranks else None,
        )
        for name in acting
    ]
    return tuple(sorted(rows, key=lambda row: (row.mean_rank is None, *standing(row.score, row.mean_regret))))


def _counted(results: Results, track: str, policy: str) -> str:
    """The policy whose numbers count for ``policy`` on a track."""
    return policy if (track, policy) in results.samples else ZERO


def _over_tracks(results: Results, tracks: list[str], policy: str, metric: str) -> Summary:
    """The mean of a metric over the tracks on which it has values."""
    seeds = len(results.policies[policy].training_seeds)
    found = [results.samples[track, _counted(results, track, policy)][metric] for track in tracks]
    return estimate([np.broadcast_to(each, (seeds, each.shape[1])) for each in found if np.isfinite(each).any()])
