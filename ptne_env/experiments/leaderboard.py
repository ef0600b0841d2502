"""What a suite has shown: per track and overall, scores, ranks and comparisons with their intervals."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.experiments.benchmark import RESULTS_FORMAT, TIMINGS, Run, versions
from ptne_env.experiments.metrics import SUITE_METRICS
from ptne_env.experiments.statistics import (
    Summary,
    estimate,
    interquartile_mean,
    mean,
    performance_profile,
    probability_of_improvement,
    summarise,
    unpaired_probability_of_improvement,
)
from ptne_env.experiments.suite import LAW, NULL, SATURATION_MARGIN, Track, content_hash
from ptne_env.world import World

SMALLEST_GAIN = 0.1
"""Digits that the law must gain over doing nothing for a track's scores to be normalised by them."""

ERRORS = tuple(10.0**-digits for digits in range(1, 13))
"""ε at which the deadline success P(error ≤ ε) is told."""

THRESHOLDS = tuple(round(0.25 * step, 2) for step in range(21))
"""Normalised scores at which performance profiles are told."""

_MOST_DIGITS = float(distances.digits(np.array(0.0)))


@dataclass(frozen=True)
class TrackRow:
    """One policy on one track.

    Attributes:
        track: name.
        policy: name.
        not_applicable: why it cannot act there; ``None``, and all that follows is there, where it can.
        rank: 1 is best; oracles and those that cannot act have none.
        score: 0 is doing nothing, 1 the paper's law; ``None`` where the law does not gain a tenth of a digit.
        improvement: probability of improvement over the paper's law, paired by episode.
        unpaired_improvement: the same over any two episodes.
        metrics: mean and interval by name of :data:`~ptne_env.experiments.metrics.SUITE_METRICS`, timings apart.
        fine_time: mean time to 1e-6 in seconds, an episode that never gets there counting as its whole length.
        success: P(error ≤ ε) of the estimates at the deadline, for each of :data:`ERRORS`.
    """

    track: str
    policy: str
    not_applicable: str | None = None
    rank: int | None = None
    score: Summary | None = None
    improvement: Summary | None = None
    unpaired_improvement: float | None = None
    metrics: dict[str, Summary] | None = None
    fine_time: float | None = None
    success: tuple[float, ...] | None = None


@dataclass(frozen=True)
class OverallRow:
    """One policy over the tracks that all can play.

    Attributes:
        policy: name.
        score: interquartile mean of the normalised scores.
        improvement: probability of improvement over the paper's law, paired by episode, mean over tracks.
        unpaired_improvement: the same over any two episodes.
        mean_rank: over the tracks; oracles have none.
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
    """The results of a suite.

    Attributes:
        run: what was run.
        rows: one per track and policy, in the order of the run.
        saturated: names of the tracks where the best policies all stand at the floor, ranked by time to 1e-6.
        common: names of the tracks that overall scores are taken over: those that all policies can play, short of the
            policies that cannot play half of them.
        overall: one per policy that enters overall scores, the best first.
    """

    run: Run
    rows: tuple[TrackRow, ...]
    saturated: tuple[str, ...]
    common: tuple[str, ...]
    overall: tuple[OverallRow, ...]

    def row(self, track: str, policy: str) -> TrackRow:
        """The row of one policy on one track.

        Raises:
            KeyError: when there is none.
        """
        for row in self.rows:
            if (row.track, row.policy) == (track, policy):
                return row
        raise KeyError(f"no row of policy {policy!r} on track {track!r}")

    def to_dict(self) -> dict[str, Any]:
        """All that is needed to read the results and to repeat them, as a JSON object; timings in one place.

        ``format`` is the version of what the entries mean, ``checksum`` the hash of all but itself and the timings.
        """
        run = self.run
        content = {
            "format": RESULTS_FORMAT,
            "suite": {"target": run.target, "content_hash": run.suite.content_hash, **run.suite.content()},
            "seed": run.seed,
            "split": run.split,
            "episodes": run.episodes,
            "versions": versions(),
            "participants": [participant.to_dict() for participant in run.participants.values()],
            "errors": list(ERRORS),
            "thresholds": list(THRESHOLDS),
            "tracks": [asdict(row) for row in self.rows],
            "saturated_tracks": list(self.saturated),
            "common_tracks": list(self.common),
            "overall": [asdict(row) for row in self.overall],
            "cells": [
                {"track": cell.track.name, "participant": cell.participant, "run": cell.run, "cell": cell.key}
                for cell in run.cells
            ],
        }
        timings = {cell.key: measured.timings for cell, measured in zip(run.cells, run.measured, strict=True)}
        return {**content, "checksum": content_hash(content), "timings": timings}

    def to_json(self) -> str:
        """:meth:`to_dict` as a JSON text without NaN or Infinity."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)


def leaderboard(run: Run) -> Leaderboard:
    """Summarise a run: scores, ranks and comparisons."""
    names = list(run.participants)
    samples = {(track.name, name): _stacked(run, track, name) for track in run.tracks for name in names}
    raw = {
        (track.name, name): found[track.metric]
        for track in run.tracks
        for name in names
        if (found := samples[track.name, name])
    }
    scores: dict[tuple[str, str], FloatArray] = {}
    for track in run.tracks:
        null, law = (float(raw[track.name, anchor].mean()) for anchor in (NULL, LAW))
        if law - null >= SMALLEST_GAIN:
            for name in names:
                if (track.name, name) in raw:
                    scores[track.name, name] = (raw[track.name, name] - null) / (law - null)
    ranks, saturated = _ranks(run, samples)
    rows = tuple(_row(run, track, name, samples, scores, ranks) for track in run.tracks for name in names)
    scored = [track.name for track in run.tracks if (track.name, LAW) in scores]
    broad = [name for name in names if 2 * sum((track, name) in scores for track in scored) >= len(scored)]
    common = tuple(track for track in scored if all((track, name) in scores for name in broad))
    overall = [_overall(run, name, common, scores, ranks) for name in broad] if common else []
    overall.sort(key=lambda row: -(row.score.mean or 0.0))
    return Leaderboard(run, rows, saturated, common, tuple(overall))


def _stacked(run: Run, track: Track, name: str) -> dict[str, FloatArray]:
    """Every metric of a policy on a track, (training seeds, episodes); empty where it cannot act."""
    found = run.of(track.name, name)
    if any(measured.reason is not None for measured in found):
        return {}
    return {metric: np.stack([measured.samples[metric] for measured in found]) for metric in found[0].samples}


def _fine_time(track: Track, samples: dict[str, FloatArray]) -> FloatArray:
    whole = float(World(track.scenario).clock.t[-1])
    times = samples["settling_time_1e_6"]
    return np.where(np.isfinite(times), times, whole)


def _ranks(
    run: Run, samples: dict[tuple[str, str], dict[str, FloatArray]]
) -> tuple[dict[tuple[str, str], int], tuple[str, ...]]:
    """Ranks by track and policy, and the tracks that are saturated."""
    ranks, saturated = {}, []
    for track in run.tracks:
        entrants = {
            name: found
            for name, participant in run.participants.items()
            if not participant.is_oracle and (found := samples[track.name, name])
        }
        at_floor = [
            name
            for name, found in entrants.items()
            if interquartile_mean([found[track.metric]]) >= _MOST_DIGITS - SATURATION_MARGIN
        ]
        if len(at_floor) > 1:
            saturated.append(track.name)
        keys = {
            name: (
                # Those at the floor, whom digits do not tell apart, go first and by time.
                float(_fine_time(track, found).mean()) if len(at_floor) > 1 and name in at_floor else float("inf"),
                -float(found[track.metric].mean()),
            )
            for name, found in entrants.items()
        }
        for name, key in keys.items():
            ranks[track.name, name] = 1 + sum(other < key for other in keys.values())
    return ranks, tuple(saturated)


def _row(
    run: Run,
    track: Track,
    name: str,
    samples: dict[tuple[str, str], dict[str, FloatArray]],
    scores: dict[tuple[str, str], FloatArray],
    ranks: dict[tuple[str, str], int],
) -> TrackRow:
    found = samples[track.name, name]
    if not found:
        reasons = [measured.reason for measured in run.of(track.name, name) if measured.reason is not None]
        return TrackRow(track.name, name, not_applicable=reasons[0])
    law = samples[track.name, LAW][track.metric]
    score = scores.get((track.name, name))
    errors = found["estimate_distance"]
    return TrackRow(
        track.name,
        name,
        rank=ranks.get((track.name, name)),
        score=None if score is None else estimate(mean, [score]),
        improvement=estimate(probability_of_improvement, [found[track.metric]], [law]).within(0, 1),
        unpaired_improvement=unpaired_probability_of_improvement([found[track.metric]], [law]),
        metrics=_summaries(found),
        fine_time=float(_fine_time(track, found).mean()),
        success=tuple(float((errors <= error).mean()) for error in ERRORS),
    )


def _summaries(found: dict[str, FloatArray]) -> dict[str, Summary]:
    """Mean and interval of every metric; over all training seeds, where there are several."""
    flat = summarise(np.array([values.ravel() for values in found.values()]))
    summaries = dict(zip(found, flat, strict=True))
    for metric, values in found.items():
        if len(values) > 1 and np.isfinite(values).all():
            summaries[metric] = estimate(mean, [values])
    return {metric: summaries[metric] for metric in SUITE_METRICS if metric not in TIMINGS}


def _overall(
    run: Run,
    name: str,
    common: tuple[str, ...],
    scores: dict[tuple[str, str], FloatArray],
    ranks: dict[tuple[str, str], int],
) -> OverallRow:
    mine, law = ([scores[track, one] for track in common] for one in (name, LAW))
    oracle = run.participants[name].is_oracle
    return OverallRow(
        name,
        score=estimate(interquartile_mean, mine),
        improvement=estimate(probability_of_improvement, mine, law).within(0, 1),
        unpaired_improvement=unpaired_probability_of_improvement(mine, law),
        mean_rank=None if oracle else float(np.mean([ranks[track, name] for track in common])),
        profile=tuple(map(float, performance_profile(mine, np.array(THRESHOLDS)))),
    )
