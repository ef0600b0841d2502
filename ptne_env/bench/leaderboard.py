"""Leaderboards of suites: per track and overall, scores, ranks and comparisons with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ptne_env.bench.suite import LAW, ZERO
from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.metrics import MOST_DIGITS
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.statistics import Scores, Summary, estimate
from ptne_env.shared.arrays import FloatArray


@dataclass(frozen=True)
class TrackRow:
    """One policy on one track that it can act on.

    Attributes:
        track: name.
        policy: name.
        rank: by mean digits, 1 is best; ``None`` for oracles.
        score: 0 is zero input, 1 the 12 digits of the floor.
        improvement: probability of improvement over the paper's law, paired by episode.
    """

    track: str
    policy: str
    rank: int | None
    score: Summary
    improvement: Summary


@dataclass(frozen=True)
class OverallRow:
    """One policy over all tracks; where it cannot act or failed, it counts as zero input.

    Attributes:
        policy: name.
        score: mean over the tracks.
        improvement: probability of improvement over the paper's law, paired by episode, mean over tracks.
        mean_rank: over the tracks; ``None`` for oracles.
    """

    policy: str
    score: Summary
    improvement: Summary
    mean_rank: float | None


@dataclass(frozen=True)
class Leaderboard:
    """Scores and ranks of the policies of a suite.

    Attributes:
        rows: one per track and policy that can act there, in the order of the run.
        overall: one row per policy, the best first, oracles last.
    """

    rows: tuple[TrackRow, ...]
    overall: tuple[OverallRow, ...]

    def row(self, track: str, policy: str) -> TrackRow | None:
        """The row of one policy on one track; ``None`` where the policy cannot act."""
        return next((row for row in self.rows if (row.track, row.policy) == (track, policy)), None)


def scores(digits: FloatArray, zero: FloatArray) -> FloatArray:
    """Scores (digits − zero input)/(12 − zero input), with the mean digits of zero input; any shape."""
    return (digits - zero.mean()) / (MOST_DIGITS - zero.mean())


def leaderboard(results: Results) -> Leaderboard | None:
    """Scores, ranks and comparisons of a suite; ``None`` for a comparison, which has no reference policies.

    Where a policy cannot act or failed, it counts as zero input.
    """
    if results.is_comparison:
        return None
    tracks, policies, samples = results.tracks, results.policies, results.samples
    digits: dict[tuple[str, str], FloatArray] = {}
    for track in tracks:
        for name, policy in policies.items():
            acting = samples.get((track.name, name), samples[track.name, ZERO])[track.metric]
            digits[track.name, name] = np.broadcast_to(acting, (len(policy.training_seeds), acting.shape[1]))
    plain = {place: scores(values, digits[place[0], ZERO]) for place, values in digits.items()}
    spread = {place: _with_spread(values, plain[place[0], ZERO]) for place, values in plain.items()}
    better = {place: improvements(values, digits[place[0], LAW]) for place, values in digits.items()}
    ranks = _ranks(policies, digits)
    rows = tuple(
        TrackRow(*place, ranks.get(place), estimate([spread[place]]), _probability([better[place]]))
        for place in digits
        if place in samples
    )
    overall = [
        OverallRow(
            name,
            estimate([spread[track.name, name] for track in tracks]),
            _probability([better[track.name, name] for track in tracks]),
            None if policy.is_oracle else float(np.mean([ranks[track.name, name] for track in tracks])),
        )
        for name, policy in policies.items()
    ]
    overall.sort(key=lambda row: (row.mean_rank is None, -(row.score.mean or 0.0)))
    return Leaderboard(rows, tuple(overall))


def _with_spread(plain: FloatArray, zero: FloatArray) -> FloatArray:
    """Scores with the same mean, whose spread is also that of zero input.

    The mean of zero input depends on the episodes too: a score s moves by (s − 1)/(12 − zero) of it in first order.
    """
    return plain + (plain.mean() - 1) * zero


def _ranks(
    policies: Mapping[str, PolicySpec], digits: Mapping[tuple[str, str], FloatArray]
) -> dict[tuple[str, str], int]:
    """Ranks by mean digits of all but oracles, by track and policy."""
    means = {place: float(values.mean()) for place, values in digits.items() if not policies[place[1]].is_oracle}
    return {
        (track, name): 1 + sum(other > mean for (place, _), other in means.items() if place == track)
        for (track, name), mean in means.items()
    }


def _probability(better: Scores) -> Summary:
    """The mean of improvements, its interval cut to where a probability can be."""
    found = estimate(better)
    if found.low is None or found.high is None:
        return found
    return Summary(found.mean, max(found.low, 0.0), min(found.high, 1.0))


def improvements(scores: FloatArray, others: FloatArray) -> FloatArray:
    """1 where a score is better than the other policy's on the same episode, 1/2 where both are equal, else 0.

    Args:
        scores: shape (training seeds, episodes).
        others: of a policy with one training seed, shape (1, episodes).

    Returns:
        Shape (training seeds, episodes); the mean is the probability of improvement P(x > y) + P(x = y)/2.
    """
    return (np.sign(scores - others) + 1) / 2
