"""Leaderboards of suites: per track and overall, scores, ranks and comparisons with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ptne_env.evaluation.policy_specs import DIVISIONS, PolicySpec
from ptne_env.evaluation.statistics import Summary, estimate, improvements, performance_profile
from ptne_env.evaluation.suite import LAW, MOST_DIGITS, SATURATION_MARGIN, ZERO, Track
from ptne_env.shared.arrays import FloatArray

SMALLEST_GAIN = 0.1
"""Digits between zero input and full marks, below which a track has no scores."""

ROOM = 1.0
"""Digits that a track should leave between zero input and the best known honest entry, and above that entry."""

ERRORS = tuple(10.0**-digits for digits in range(1, 13))
"""ε for which the deadline success P(error ≤ ε) is given."""

THRESHOLDS = tuple(round(0.05 * step, 2) for step in range(25))
"""Normalised scores for which performance profiles are given."""

NEEDED = frozenset({"digits", "digits_after_hold", "estimate_distance", "settling_time_1e_6"})
"""The metrics from which leaderboards are made."""

_ByTrack: TypeAlias = Mapping[tuple[str, str], FloatArray]
"""By track and policy, shape (training seeds, episodes)."""


@dataclass(frozen=True)
class TrackRow:
    """One policy on one track that it can act on.

    Attributes:
        track: name.
        policy: name.
        rank: among the entries of its division, 1 is best; ``None`` for oracles.
        score: 0 is zero input, 1 full marks; ``None`` where these differ by less than a tenth of a digit.
        improvement: probability of improvement over the paper's law, paired by episode.
        fine_time: mean time to 1e-6 in seconds; an episode that never settles counts as its whole length.
        success: P(error ≤ ε) of the estimates at the deadline, for each of :data:`ERRORS`.
    """

    track: str
    policy: str
    rank: int | None
    score: Summary | None
    improvement: Summary
    fine_time: float
    success: tuple[float, ...]


@dataclass(frozen=True)
class OverallRow:
    """One policy over all tracks; where it cannot act or failed, it counts as zero input.

    Attributes:
        policy: name.
        score: mean over the tracks with scores.
        improvement: probability of improvement over the paper's law, paired by episode, mean over tracks.
        mean_rank: over the tracks, among the entries of its division; ``None`` for oracles.
        profile: share of normalised scores above each of :data:`THRESHOLDS`, mean over tracks.
    """

    policy: str
    score: Summary
    improvement: Summary
    mean_rank: float | None
    profile: tuple[float, ...]


@dataclass(frozen=True)
class Scale:
    """The digits that the scores of a track mean, and the room above the best entry.

    Attributes:
        track: name.
        zero: mean digits of zero input: score 0.
        full_marks: digits of the best known honest entry when the suite was frozen, or of the floor: score 1.
        has_scores: whether these differ by a tenth of a digit at least.
        best: honest policy with the most digits in this run.
        best_digits: its mean digits.
        highest: digits that no policy passes: the ceiling, or the floor.
        room: digits from the best known honest entry, in this run or when the suite was frozen, to ``highest``.
    """

    track: str
    zero: float
    full_marks: float
    has_scores: bool
    best: str
    best_digits: float
    highest: float
    room: float

    def scores(self, digits: FloatArray) -> FloatArray:
        """Normalised scores (digits − zero)/(full marks − zero), any shape."""
        return (digits - self.zero) / (self.full_marks - self.zero)


@dataclass(frozen=True)
class Leaderboard:
    """Scores and ranks of the policies of a suite.

    Attributes:
        rows: one per track and policy that can act there, in the order of the run.
        saturated: names of the tracks on which several policies of a division reach the floor; those are ranked by time
            to 1e-6.
        scales: one per track.
        overall: one row per policy, honest entries first, then coded ones, then oracles, the best of each first; empty
            where no track has scores.
        errors: :data:`ERRORS`.
        thresholds: :data:`THRESHOLDS`.
    """

    rows: tuple[TrackRow, ...]
    saturated: tuple[str, ...]
    scales: tuple[Scale, ...]
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
) -> Leaderboard:
    """Scores, ranks and comparisons.

    Args:
        tracks: that were run.
        policies: by name, the reference policies among them.
        samples: by (track, policy) and metric, shape (training seeds, episodes); nothing where a policy cannot act or
            failed, which counts as zero input.
    """
    digits: dict[tuple[str, str], FloatArray] = {}
    times: dict[tuple[str, str], FloatArray] = {}
    for track in tracks:
        whole = float(track.world.clock.t[-1])
        for name, policy in policies.items():
            acting = samples.get((track.name, name), samples[track.name, ZERO])
            shape = (len(policy.training_seeds), acting[track.metric].shape[1])
            digits[track.name, name] = np.broadcast_to(acting[track.metric], shape)
            found = np.broadcast_to(acting["settling_time_1e_6"], shape)
            times[track.name, name] = np.where(np.isfinite(found), found, whole)
    scales = tuple(_scale(track, policies, digits, samples) for track in tracks)
    scores = {
        (scale.track, name): _Scores(digits[scale.track, name], digits[scale.track, ZERO], scale)
        for scale in scales
        if scale.has_scores
        for name in policies
    }
    ranks: dict[tuple[str, str], int] = {}
    saturated = []
    for track in tracks:
        ranked, is_saturated = _ranks(track.name, policies, digits, times)
        ranks.update(ranked)
        saturated += [track.name] * is_saturated
    better = {place: improvements(values, digits[place[0], LAW]) for place, values in digits.items()}
    rows = tuple(
        TrackRow(
            *place,
            rank=ranks.get(place),
            score=estimate([scores[place].for_mean]) if place in scores else None,
            improvement=estimate([better[place]]).within(0, 1),
            fine_time=float(times[place].mean()),
            success=tuple(float((samples[place]["estimate_distance"] <= error).mean()) for error in ERRORS),
        )
        for place in digits
        if place in samples
    )
    scored = [scale.track for scale in scales if scale.has_scores]
    overall = [
        OverallRow(
            name,
            score=estimate([scores[track, name].for_mean for track in scored]),
            improvement=estimate([better[track.name, name] for track in tracks]).within(0, 1),
            mean_rank=None if policy.is_oracle else float(np.mean([ranks[track.name, name] for track in tracks])),
            profile=tuple(
                performance_profile([scores[track, name].plain for track in scored], np.array(THRESHOLDS)).tolist()
            ),
        )
        for name, policy in policies.items()
        if scored
    ]
    overall.sort(key=lambda row: (DIVISIONS.index(policies[row.policy].division), -(row.score.mean or 0.0)))
    return Leaderboard(rows, tuple(saturated), scales, tuple(overall))


class _Scores:
    """The normalised scores of one policy on one track, shape (training seeds, episodes).

    Attributes:
        plain: (digits − mean of zero input)/(full marks − mean of zero input).
        for_mean: numbers with the same mean s, whose spread is also that of zero input: the mean of zero input depends
            on the episodes too, by (s − 1)/(full marks − mean of zero input) in first order.
    """

    def __init__(self, digits: FloatArray, zero: FloatArray, scale: Scale) -> None:
        self.plain = scale.scores(digits)
        self.for_mean = self.plain + (self.plain.mean() - 1) * scale.scores(zero)


def _scale(
    track: Track,
    policies: Mapping[str, PolicySpec],
    digits: _ByTrack,
    samples: Mapping[tuple[str, str], object],
) -> Scale:
    zero = float(digits[track.name, ZERO].mean())
    honest = {
        name: float(digits[track.name, name].mean())
        for name, policy in policies.items()
        if policy.division == "honest" and (track.name, name) in samples
    }
    best = max(honest, key=honest.__getitem__)
    known = honest[best] if track.best_known is None else max(track.best_known, honest[best])
    return Scale(
        track.name,
        zero,
        track.full_marks,
        has_scores=track.full_marks - zero >= SMALLEST_GAIN,
        best=best,
        best_digits=honest[best],
        highest=track.highest,
        room=round(track.highest - known, 9),  # digits of the floor are 12 up to rounding
    )


def _ranks(
    track: str, policies: Mapping[str, PolicySpec], digits: _ByTrack, times: _ByTrack
) -> tuple[dict[tuple[str, str], int], bool]:
    """Ranks within each division by track and policy, and whether several policies of a division are at the floor."""
    ranks, is_saturated = {}, False
    for division in DIVISIONS[:-1]:  # all but oracles
        names = [name for name, policy in policies.items() if policy.division == division]
        means = {name: float(digits[track, name].mean()) for name in names}
        at_floor = {name for name, mean in means.items() if mean >= MOST_DIGITS - SATURATION_MARGIN}
        by_time = at_floor if len(at_floor) > 1 else set()
        # The policies at the floor, which digits do not separate, come first and are ranked by time.
        keys = {
            name: (float(times[track, name].mean()) if name in by_time else float("inf"), -mean)
            for name, mean in means.items()
        }
        ranks.update({(track, name): 1 + sum(other < key for other in keys.values()) for name, key in keys.items()})
        is_saturated |= bool(by_time)
    return ranks, is_saturated
