"""Suites: published tracks on which policies are run beside reference policies, with scores and ranks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np

from ptne_env.evaluation.comparison import Run, as_list, compare, run_serially
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.policy_spec import POLICIES, PolicySpec, get_policy_spec
from ptne_env.evaluation.results import SHOWN, Results, standing
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.evaluation.tracks import Track
from ptne_env.shared.arrays import require_count, require_printable
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import resolve
from ptne_env.world.catalogue import CATALOGUE, get_scenario
from ptne_env.world.scenario import Scenario

ZERO, LAW, ORACLE = REFERENCES = "zero-input", "static", "oracle"
"""The reference policies that every run of a suite includes: zero input with score 0, the paper's law, an oracle."""


@dataclass(frozen=True)
class Suite:
    """Tracks, and the rules by which they are run.

    Attributes:
        name: the name, such as ``"ptne-v1"``, which is part of the seeds of all episodes.
        tracks: the tracks in the order of tables.
        episodes: the number of episodes of every track without a number of its own.

    Raises:
        ValueError: when names of tracks repeat, when there is no track, or when the number of episodes is below 1.
    """

    name: str
    tracks: tuple[Track, ...]
    episodes: int = 200

    def __post_init__(self) -> None:
        require_count("a suite's number of episodes", self.episodes, 1)
        require_printable("the name of a suite", self.name)
        names = [track.name for track in self.tracks]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"a suite needs tracks with different names, got {names}")

    def track(self, name: str) -> Track:
        """Return a track by name; ``ValueError`` for an unknown one."""
        for track in self.tracks:
            if track.name == name:
                return track
        raise ValueError(unknown_name(f"track of suite {self.name}", name, [track.name for track in self.tracks]))

    def episode_set(
        self, track: str, episodes: int | None = None, *, seed: int = 0, split: Split = "test"
    ) -> EpisodeSet:
        """Return the episodes of a track, whose own number stands before ``episodes``, and that before the suite's.

        Raises:
            ValueError: for an unknown track or split, or a number out of range.
        """
        count = self.track(track).episodes or (self.episodes if episodes is None else episodes)
        return EpisodeSet(count, seed, split, (self.name, track))


SUITES: Mapping[str, str] = {
    "ptne-v1": "ptne_env.suites.ptne_v1:SUITE",
    "robustness": "ptne_env.suites.robustness:robustness",
}
"""The published suites: the ``"module:object"`` that is the suite, or makes it, by name."""


def get_suite(suite: str | Suite) -> Suite:
    """Return a suite by name or by ``"module:object"``, a suite or a function without arguments that makes one.

    Raises:
        ValueError: for an unknown name, or an object that is not a suite.
    """
    if isinstance(suite, Suite):
        return suite
    if suite not in SUITES and ":" not in suite:
        raise ValueError(unknown_name("suite", suite, SUITES, "a 'module:object'"))
    target: Any = resolve(SUITES.get(suite, suite))
    resolved = target() if callable(target) else target
    if not isinstance(resolved, Suite):
        raise ValueError(f"{suite!r} is a {type(resolved).__name__}, not a Suite")
    return resolved


def world_names() -> list[str]:
    """Return the names that :func:`find_scenario` knows: of scenarios, and of the tracks of published suites."""
    return [*CATALOGUE, *(f"{suite}/{track.name}" for suite in SUITES for track in get_suite(suite).tracks)]


def find_scenario(name: str) -> Scenario:
    """Return the scenario of :func:`find_track`.

    Raises:
        ValueError: as :func:`find_track`, and for a track with teammates.
    """
    track = find_track(name)
    if track.teammates is not None:
        raise ValueError(
            f"track {name!r} is more than its scenario: some of its players follow a fixed policy; only "
            f"ptne compare {name} and run_suite play it"
        )
    return track.scenario


def find_track(name: str) -> Track:
    """Return a track by its name, such as ``"ptne-v1/liar"``, or one of a scenario, by its name or ``"module:object"``.

    The object is a scenario, or a function without arguments that makes one. The track names no number of episodes.

    Raises:
        ValueError: for an unknown name, or an object that is not a scenario.
    """
    suite, separator, track = name.partition("/")
    if separator:
        return replace(get_suite(suite).track(track), episodes=None)
    if ":" not in name and name not in CATALOGUE:
        raise ValueError(unknown_name("scenario", name, world_names()))
    scenario = get_scenario(name)
    return Track(scenario.name, scenario, "")


def run_suite(
    suite: str | Suite,
    policies: str | PolicySpec | Iterable[str | PolicySpec],
    *,
    tracks: str | Iterable[str] | None = None,
    episodes: int | None = None,
    seed: int = 0,
    split: Split = "test",
    run: Run = run_serially,
) -> Results:
    """Run policies, and the reference policies of the suite, on the tracks of a suite.

    Args:
        suite: a suite, its name, or a ``"module:object"``.
        policies: the policies, as for :func:`ptne_env.evaluate`.
        tracks: one name of a track or several; all tracks if left out.
        episodes: the number of episodes per track; the suite's own number if left out.
        seed: the seed of the episode sets; that of published results is 0.
        split: as for :func:`ptne_env.evaluate`.
        run: likewise.

    Raises:
        ValueError: for unknown or repeated names, or a policy with the name of a reference policy.
        RuntimeError: when a reference policy fails.
        OSError, ImportError, ConnectionError, ChildProcessError: as :class:`ptne_env.execution.Runner` raises them.
    """
    target = suite if isinstance(suite, str) else None
    suite = get_suite(suite)
    names = [track.name for track in suite.tracks] if tracks is None else list(dict.fromkeys(as_list(tracks)))
    sets = {name: suite.episode_set(name, episodes, seed=seed, split=split) for name in names}
    specs = [get_policy_spec(policy) for policy in as_list(policies)]
    for name in REFERENCES:
        same = [spec for spec in specs if spec.name == name]
        if any(spec != POLICIES[name] for spec in same):
            raise ValueError(f"{name!r} is the name of a reference policy: give your policy another name")
        specs += [] if same else [POLICIES[name]]
    results = compare(suite.name, [suite.track(name) for name in names], specs, sets, run, target)
    for (track, policy), reason in results.failures.items():
        if policy in REFERENCES:
            raise RuntimeError(f"the reference policy {policy!r} fails on track {track!r}: {reason}")
    return results


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

    It is ``None`` for a comparison, or without scores.
    """
    tracks = [track.name for track in results.tracks if track.scored]
    if results.is_comparison or not tracks:
        return None
    ranked = [name for name, spec in results.policies.items() if spec.is_ranked]
    ranks: dict[str, list[int]] = {name: [] for name in ranked}
    for track in tracks:
        standings = {name: results.standing(track, _counted_policy(results, track, name)) for name in ranked}
        for name, mine in standings.items():
            ranks[name].append(1 + sum(other < mine for other in standings.values()))
    rows = [
        Row(name, score, on_the_way, worst_tenth, float(np.mean(ranks[name])) if name in ranks else None)
        for name in results.policies
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
