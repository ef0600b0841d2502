"""Leaderboards of suites: per track and overall, scores, ranks and comparisons with their intervals."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.experiments.policy_specs import PolicySpec
from ptne_env.experiments.statistics import (
    Summary,
    estimate,
    interquartile_mean,
    mean,
    performance_profile,
    probability_of_improvement,
    unpaired_probability_of_improvement,
)
from ptne_env.experiments.suite import LAW, SATURATION_MARGIN, ZERO, Track

SMALLEST_GAIN = 0.1
"""Digits that the law must gain over zero input for a track's scores to be normalised by them."""

ERRORS = tuple(10.0**-digits for digits in range(1, 13))
"""ε for which the deadline success P(error ≤ ε) is given."""

THRESHOLDS = tuple(round(0.25 * step, 2) for step in range(21))
"""Normalised scores for which performance profiles are given."""

_MOST_DIGITS = float(distances.digits(np.array(0.0)))

_ByTrack: TypeAlias = Mapping[tuple[str, str], FloatArray]
"""By track and policy, shape (training seeds, episodes)."""


@dataclass(frozen=True)
class TrackRow:
    """One policy on one track that it can act on.

    Attributes:
        track: name.
        policy: name.
        rank: 1 is best; ``None`` for oracles.
        score: 0 is zero input, 1 the paper's law; ``None`` where the law does not gain a tenth of a digit.
        improvement: probability of improvement over the paper's law, paired by episode.
        unpaired_improvement: the same over any two episodes.
        fine_time: mean time to 1e-6 in seconds; an episode that never settles counts as its whole length.
        success: P(error ≤ ε) of the estimates at the deadline, for each of :data:`ERRORS`.
    """

    track: str
    policy: str
    rank: int | None
    score: Summary | None
    improvement: Summary
    unpaired_improvement: float
    fine_time: float
    success: tuple[float, ...]


@dataclass(frozen=True)
class OverallRow:
    """One policy over the common tracks.

    Attributes:
        policy: name.
        score: interquartile mean of the normalised scores.
        improvement: probability of improvement over the paper's law, paired by episode, mean over tracks.
        unpaired_improvement: the same over any two episodes.
        mean_rank: over the tracks; ``None`` for oracles.
        profile: share of normalised scores above each of :data:`THRESHOLDS`.
    """

    policy: str
    score: Summary
    improvement: Summary
    unpaired_improvement: float
    mean_rank: float | None
    profile: tuple[float, ...]


@dataclass(frozen=True)
class Leaderboard:
    """Scores and ranks of the policies of a suite.

    Attributes:
        rows: one per track and policy that can act there, in the order of the run.
        saturated: names of the tracks on which several policies reach the floor; those are ranked by time to 1e-6.
        common: names of the tracks of the overall scores: those that all policies can act on, leaving out the policies
            that cannot act on half of them, or failed on one.
        overall: one row per policy with an overall score, the best first.
        errors: :data:`ERRORS`.
        thresholds: :data:`THRESHOLDS`.
    """

    rows: tuple[TrackRow, ...]
    saturated: tuple[str, ...]
    common: tuple[str, ...]
    overall: tuple[OverallRow, ...]
    errors: tuple[float, ...] = ERRORS
    thresholds: tuple[float, ...] = THRESHOLDS

    def row(self, track: str, policy: str) -> TrackRow | None:
        """The row of one policy on one track; ``None`` where the policy cannot act."""
        return next((row for row in self.rows if (row.track, row.policy) == (track, policy)), None)


def leaderboard(
    tracks: Sequence[Track],
    policies: Mapping[str, PolicySpec],
    samples: Mapping[tuple[str, str], Mapping[str, FloatArray]],
    failing: Collection[str] = (),
) -> Leaderboard:
    """Scores, ranks and comparisons.

    Args:
        tracks: that were run.
        policies: by name, the reference policies among them.
        samples: by (track, policy) and metric, shape (training seeds, episodes); nothing where a policy cannot act.
        failing: names of the policies that failed on a track, which have no overall score.
    """
    raw, fine_times = {}, {}
    for track in tracks:
        whole = float(track.world.clock.t[-1])
        for name in policies:
            if (track.name, name) in samples:
                found = samples[track.name, name]
                times = found["settling_time_1e_6"]
                raw[track.name, name] = found[track.metric]
                fine_times[track.name, name] = np.where(np.isfinite(times), times, whole)
    scores = _scores(tracks, policies, raw)
    ranks, saturated = _ranks(tracks, policies, raw, fine_times)
    rows = tuple(
        TrackRow(
            *place,
            rank=ranks.get(place),
            score=estimate(mean, [scores[place]]) if place in scores else None,
            improvement=estimate(probability_of_improvement, [digits], [raw[place[0], LAW]]).within(0, 1),
            unpaired_improvement=unpaired_probability_of_improvement([digits], [raw[place[0], LAW]]),
            fine_time=float(fine_times[place].mean()),
            success=tuple(float((samples[place]["estimate_distance"] <= error).mean()) for error in ERRORS),
        )
        for place, digits in raw.items()
    )
    scored = [track.name for track in tracks if (track.name, LAW) in scores]
    broad = [
        name
        for name in policies
        if name not in failing and 2 * sum((track, name) in scores for track in scored) >= len(scored)
    ]
    common = tuple(track for track in scored if all((track, name) in scores for name in broad))
    overall = [_overall(name, policies[name], common, scores, ranks) for name in broad] if common else []
    overall.sort(key=lambda row: -(row.score.mean or 0.0))
    return Leaderboard(rows, saturated, common, tuple(overall))


def _scores(
    tracks: Sequence[Track], policies: Mapping[str, PolicySpec], raw: _ByTrack
) -> dict[tuple[str, str], FloatArray]:
    """Normalised scores on the tracks on which the law gains enough."""
    scores = {}
    for track in tracks:
        zero, law = (float(raw[track.name, reference].mean()) for reference in (ZERO, LAW))
        if law - zero >= SMALLEST_GAIN:
            for name in policies:
                if (track.name, name) in raw:
                    scores[track.name, name] = (raw[track.name, name] - zero) / (law - zero)
    return scores


def _ranks(
    tracks: Sequence[Track], policies: Mapping[str, PolicySpec], raw: _ByTrack, fine_times: _ByTrack
) -> tuple[dict[tuple[str, str], int], tuple[str, ...]]:
    """Ranks by track and policy, and the names of the tracks that are saturated."""
    ranks, saturated = {}, []
    for track in tracks:
        ranked = [name for name, policy in policies.items() if not policy.is_oracle and (track.name, name) in raw]
        at_floor = {
            name for name in ranked if interquartile_mean([raw[track.name, name]]) >= _MOST_DIGITS - SATURATION_MARGIN
        }
        if len(at_floor) > 1:
            saturated.append(track.name)
        keys = {
            name: (
                # The policies at the floor, which digits do not separate, come first and are ranked by time.
                float(fine_times[track.name, name].mean()) if len(at_floor) > 1 and name in at_floor else float("inf"),
                -float(raw[track.name, name].mean()),
            )
            for name in ranked
        }
        for name, key in keys.items():
            ranks[track.name, name] = 1 + sum(other < key for other in keys.values())
    return ranks, tuple(saturated)


def _overall(
    name: str, policy: PolicySpec, common: tuple[str, ...], scores: _ByTrack, ranks: Mapping[tuple[str, str], int]
) -> OverallRow:
    own, law = ([scores[track, policy_name] for track in common] for policy_name in (name, LAW))
    return OverallRow(
        name,
        score=estimate(interquartile_mean, own),
        improvement=estimate(probability_of_improvement, own, law).within(0, 1),
        unpaired_improvement=unpaired_probability_of_improvement(own, law),
        mean_rank=None if policy.is_oracle else float(np.mean([ranks[track, name] for track in common])),
        profile=tuple(map(float, performance_profile(own, np.array(THRESHOLDS)))),
    )
