"""Leaderboards: the rows of a suite's policies, with scores and ranks."""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from ptne_env.evaluation.comparison import ZERO
from ptne_env.evaluation.results import SHOWN, Results, standing
from ptne_env.evaluation.statistics import Summary, estimate


@dataclass(frozen=True)
class Row:
    """A row of a leaderboard: one policy over the scored tracks. Where it cannot act or fails, it counts as zero input.

    Attributes:
        policy: the name of the policy.
        score: the mean of its digits.
        on_the_way: the mean of its digits on the way.
        worst_tenth: the mean over tracks of its digits in the worst tenth of the episodes.
        mean_rank: its mean rank by digits, 1 being best, and by digits on the way where digits are equal to two
            decimals; ``None`` for oracles, and for policies that send code.
    """

    policy: str
    score: Summary
    on_the_way: Summary
    worst_tenth: Summary
    mean_rank: float | None


def leaderboard(results: Results) -> tuple[Row, ...] | None:
    """Return the rows of a suite, the best first and those without a rank last.

    A policy without a result on any scored track has no row. It is ``None`` for a comparison, or without scores.
    """
    tracks = [track.name for track in results.tracks if track.scored]
    if results.is_comparison or not tracks:
        return None
    names = [name for name in results.policies if any((track, name) in results.samples for track in tracks)]
    ranked = [name for name in names if results.policies[name].is_ranked]
    ranks: dict[str, list[int]] = {name: [] for name in ranked}
    for track in tracks:
        standings = {name: results.standing(track, _counted_policy(results, track, name)) for name in ranked}
        for name, mine in standings.items():
            ranks[name].append(1 + sum(other < mine for other in standings.values()))
    rows = [
        Row(name, score, on_the_way, worst_tenth, float(np.mean(ranks[name])) if name in ranks else None)
        for name in names
        for score, on_the_way, worst_tenth in [[_over_tracks(results, tracks, name, metric) for metric in SHOWN]]
    ]
    oracles = {name: spec.is_oracle for name, spec in results.policies.items()}
    order = [(oracles[row.policy], row.mean_rank is None, *standing(row.score, row.on_the_way)) for row in rows]
    return tuple(row for _, row in sorted(zip(order, rows, strict=True), key=itemgetter(0)))


def _counted_policy(results: Results, track: str, policy: str) -> str:
    """Return the policy whose numbers count for ``policy`` on a track: itself, or zero input where it has none."""
    return policy if (track, policy) in results.samples else ZERO


def _over_tracks(results: Results, tracks: list[str], policy: str, metric: str) -> Summary:
    """Return the mean of a metric over tracks."""
    seeds = len(results.policies[policy].training_seeds)
    counted = [results.values(track, _counted_policy(results, track, policy), metric) for track in tracks]
    return estimate([np.broadcast_to(v, (seeds, v.shape[1])) for v in counted if v is not None])
