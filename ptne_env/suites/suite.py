"""Suites: published tracks that policies are run on, with reference policies, scores and ranks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptne_env.evaluation.comparison import Run, as_list, compare, run_serially
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.policy_spec import POLICIES, PolicySpec, get_policy_spec
from ptne_env.evaluation.results import Results, standing
from ptne_env.evaluation.statistics import Summary, estimate
from ptne_env.evaluation.tracks import Track
from ptne_env.shared.arrays import require_count, require_printable
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import resolve
from ptne_env.world.catalogue import CATALOGUE, get_scenario
from ptne_env.world.scenario import Scenario

ZERO, LAW, ORACLE = "zero-input", "static", "oracle"
"""The reference policies that every run of a suite includes: score 0, the paper's law, and an oracle."""

EPISODES = 200
"""Episodes of a track, unless the suite has another number."""


@dataclass(frozen=True)
class Suite:
    """Tracks, and the rules by which they are run.

    Attributes:
        name: such as ``"ptne-v1"``; part of the seeds of all episodes.
        tracks: in the order of tables.
        episodes: of every track without a number of its own.

    Raises:
        ValueError: when names repeat, there is no track, or a count is below 1.
    """

    name: str
    tracks: tuple[Track, ...]
    episodes: int = EPISODES

    def __post_init__(self) -> None:
        require_count("a suite's number of episodes", self.episodes, 1)
        require_printable("the name of a suite", self.name)
        names = [track.name for track in self.tracks]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"a suite needs tracks with different names, got {names}")

    @property
    def references(self) -> tuple[PolicySpec, ...]:
        """The reference policies."""
        return tuple(POLICIES[name] for name in (ZERO, LAW, ORACLE))

    def track(self, name: str) -> Track:
        """A track by name.

        Raises:
            ValueError: for an unknown name.
        """
        for track in self.tracks:
            if track.name == name:
                return track
        raise ValueError(unknown_name(f"track of suite {self.name}", name, [track.name for track in self.tracks]))

    def episode_set(
        self, track: str, episodes: int | None = None, *, seed: int = 0, split: Split = "test"
    ) -> EpisodeSet:
        """The episodes of a track.

        Args:
            track: its name.
            episodes: in place of the suite's number; a track with a number of its own keeps it.
            seed: of the set; that of published results is 0.
            split: ``"test"``, ``"validation"`` or ``"train"``.

        Raises:
            ValueError: for an unknown track or split, or a number out of range.
        """
        count = self.track(track).episodes or (self.episodes if episodes is None else episodes)
        return EpisodeSet(count, seed, split, (self.name, track))


SUITES: Mapping[str, str] = {
    "ptne-v1": "ptne_env.suites.ptne_v1:SUITE",
    "robustness": "ptne_env.suites.robustness:robustness",
}
"""The published suites: name, and the ``"module:object"`` that is or makes each."""


def get_suite(suite: str | Suite) -> Suite:
    """A suite by name, by ``"module:object"`` (a suite, or a function without arguments that makes one), or as it is.

    Raises:
        ValueError: for an unknown name, or an object that is no suite.
    """
    if isinstance(suite, Suite):
        return suite
    if suite not in SUITES and ":" not in suite:
        raise ValueError(unknown_name("suite", suite, SUITES, "a 'module:object'"))
    found: Any = resolve(SUITES.get(suite, suite))
    made = found() if callable(found) else found
    if not isinstance(made, Suite):
        raise ValueError(f"{suite!r} is a {type(made).__name__}, not a Suite")
    return made


def world_names() -> list[str]:
    """The names of all scenarios, and of the tracks of published suites, that :func:`find_scenario` knows."""
    return [*CATALOGUE, *(f"{suite}/{track.name}" for suite in SUITES for track in get_suite(suite).tracks)]


def find_scenario(name: str) -> Scenario:
    """A scenario of the catalogue by name, of a track, such as ``"ptne-v1/liar"``, or by ``"module:object"``.

    The object is a scenario, or a function without arguments that makes one.

    Raises:
        ValueError: for an unknown name, an object that is no scenario, or a track with teammates.
    """
    suite, separator, track = name.partition("/")
    if separator:
        found = get_suite(suite).track(track)
        if found.teammates is not None:
            raise ValueError(
                f"track {name!r} is more than its scenario: some of its players follow a fixed policy; only "
                f"ptne compare {name} and run_suite play it"
            )
        return found.scenario
    if ":" not in name and name not in CATALOGUE:
        raise ValueError(unknown_name("scenario", name, world_names()))
    return get_scenario(name)


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
        suite: by name, ``"module:object"`` or as it is.
        policies: as for :func:`ptne_env.evaluate`.
        tracks: one name or several; all if left out.
        episodes: per track; the suite's own number if left out.
        seed: of the episode sets; that of published results is 0.
        split: ``"test"``, ``"validation"`` or ``"train"``, which share no episode.
        run: gives the results of jobs: one after the other in this process, or a
            :class:`ptne_env.execution.Runner`.

    Raises:
        ValueError: for unknown or repeated names, or a policy with the name of a reference policy.
        RuntimeError: when a reference policy fails.
        OSError, ImportError, ConnectionError, ChildProcessError: as :class:`ptne_env.execution.Runner`.
    """
    chosen = get_suite(suite)
    target = suite if isinstance(suite, str) else None
    names = [track.name for track in chosen.tracks] if tracks is None else list(dict.fromkeys(as_list(tracks)))
    sets = {name: chosen.episode_set(name, episodes, seed=seed, split=split) for name in names}
    specs = [get_policy_spec(policy) for policy in as_list(policies)]
    for reference in chosen.references:
        same = [spec for spec in specs if spec.name == reference.name]
        if any(spec != reference for spec in same):
            raise ValueError(f"{reference.name!r} is the name of a reference policy: give your policy another name")
        specs += [] if same else [reference]
    results = compare(chosen.name, [chosen.track(name) for name in names], specs, sets, run, target)
    for (track, policy), reason in results.failures.items():
        if policy in {reference.name for reference in chosen.references}:
            raise RuntimeError(f"the reference policy {policy!r} fails on track {track!r}: {reason}")
    return results


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
