"""Running a suite: from policies and tracks to jobs, from jobs to results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ptne_env.arrays import FloatArray
from ptne_env.experiments import tuning
from ptne_env.experiments.episodes import Split
from ptne_env.experiments.jobs import Job, JobResult
from ptne_env.experiments.metrics import METRICS, against_law
from ptne_env.experiments.policy_specs import PolicySpec, get_policy_spec
from ptne_env.experiments.results import Results, records, statistics_of
from ptne_env.experiments.store import Store, run_jobs
from ptne_env.experiments.suite import LEADERBOARD_SEED, SUITES, Suite, Track, comparison, get_suite
from ptne_env.experiments.workers import Workers
from ptne_env.scenario import Scenario


def evaluate(
    policies: Iterable[str | PolicySpec],
    scenarios: Iterable[str | Scenario],
    *,
    episodes: int = 100,
    seed: int = 0,
    hold_steps: int = 0,
    split: Split = "test",
    against_laws: bool = True,
    folder: Path | None = None,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int], None] | None = None,
) -> Results:
    """Run every policy on every scenario from the same seeded starts.

    A scenario given by name is run from ``episodes`` random starts under its own name, and, unless it draws games,
    once more from the paper's start, on the track ``"NAME (paper start)"``. A
    :class:`~ptne_env.scenario.Scenario` is run as it is: ``episodes`` times when something in it is random, else once.

    A learned policy is also compared, paired by episode, with the best of the paper's laws and the best of all laws,
    both chosen by mean digits on validation episodes (:mod:`ptne_env.experiments.tuning`), where something is random.

    Args:
        policies: specs, or strings as :func:`~ptne_env.experiments.policy_specs.get_policy_spec` takes them.
        scenarios: names of the catalogue or scenarios.
        episodes: number of random starts.
        seed: of the episode sets; the remaining arguments are explained at :func:`run_suite`.
        hold_steps: steps after the deadline for the scenarios given by name.
        split: ``"test"``, ``"validation"`` or ``"train"``.
        against_laws: whether learned policies are compared with tuned laws.
        folder: in which finished jobs are stored.
        workers: run the jobs.
        progress: called when a job is done.

    Raises:
        ValueError, OSError, ImportError, ConnectionError, ChildProcessError: as :func:`run_suite`.
    """
    suite = comparison(scenarios, episodes=episodes, hold_steps=hold_steps)
    return run_suite(
        suite,
        policies,
        seed=seed,
        split=split,
        against_laws=against_laws,
        folder=folder,
        workers=workers,
        progress=progress,
    )


def run_suite(
    suite: str | Suite,
    policies: Iterable[str | PolicySpec],
    *,
    tracks: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int = LEADERBOARD_SEED,
    split: Split = "test",
    against_laws: bool = False,
    folder: Path | None = None,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int], None] | None = None,
) -> Results:
    """Run policies, and the reference policies of the suite, on the tracks of a suite.

    Jobs whose result is in the folder already are not run again, so an interrupted run goes on where it was. Workers
    return results, and only this process writes: they may be machines that share no folder with it, but they need the
    same library and the same files of policies and parts.

    Args:
        suite: by name, ``"module:object"`` or as it is.
        policies: specs, or strings as :func:`~ptne_env.experiments.policy_specs.get_policy_spec` takes them.
        tracks: names; all if left out.
        episodes: per track; the suite's own number if left out.
        seed: of the episode sets; the leaderboard's is 0.
        split: ``"test"``, ``"validation"`` or ``"train"``, which share no episode.
        against_laws: whether learned policies are compared with tuned laws; the tuning takes longer than the rest.
        folder: in which the results of finished jobs are stored; nothing is stored if left out.
        workers: run the jobs. Only the measured times of policies depend on it.
        progress: called with ``"track: policy"`` and the number of all jobs when a job is done.

    Raises:
        ValueError: for unknown or repeated names, when no policy fits any track, or a worker has other files.
        OSError: when the folder cannot be written.
        ImportError, ConnectionError, ChildProcessError: as :meth:`~ptne_env.experiments.workers.Workers.run`.
    """
    target = suite if isinstance(suite, str) else suite.name if suite.name in SUITES else None
    suite = get_suite(suite)
    chosen = suite.tracks if tracks is None else tuple(suite.track(name) for name in dict.fromkeys(tracks))
    specs = _by_name(suite, policies)
    sets = {track.name: suite.episode_set(track.name, episodes, seed=seed, split=split) for track in chosen}
    not_applicable = {
        (track.name, spec.name): f"it is run on {', '.join(sorted(spec.scenarios))} only"
        for track in chosen
        for spec in specs.values()
        if spec.scenarios is not None and track.scenario.name not in spec.scenarios
    }
    jobs = [
        Job(track, spec, training_seed, sets[track.name])
        for track in chosen
        for spec in specs.values()
        if (track.name, spec.name) not in not_applicable
        for training_seed in range(len(spec.training_seeds))
    ]
    runner = _Runner(None if folder is None else Store(folder), workers, progress)
    samples, reasons = _collected(jobs, runner.run(jobs))
    own = specs.keys() - {reference.name for reference in suite.references}
    if own and own.isdisjoint(policy for _, policy in samples):
        (_, name), reason = next(iter((not_applicable | reasons).items()))
        raise ValueError(f"policy {name!r} fits no track: {reason}")
    tuned: dict[str, dict[str, PolicySpec]] = {}
    if against_laws:
        with_learned = {track for track, policy in samples if specs[policy].is_learned}
        random = [track for track in chosen if track.name in with_learned and track.world.is_random]
        tuned = _tuned_laws(suite, random, runner)
        opposing = [Job(track, law, 0, sets[track.name]) for track in random for law in tuned[track.name].values()]
        law_samples, _ = _collected(opposing, runner.run(opposing))
        for (track, policy), measured in samples.items():
            if track in tuned and specs[policy].is_learned:
                for group, law in tuned[track].items():
                    measured.update(against_law(group, measured["digits"], law_samples[track, law.name]["digits"]))
        jobs, samples = [*jobs, *opposing], {**samples, **law_samples}
    ordered = {
        (track.name, name): samples[track.name, name]
        for track in chosen
        for name in [*specs, *(law.name for law in tuned.get(track.name, {}).values())]
        if (track.name, name) in samples
    }
    summarised = [(*place, statistics_of(found), sets[place[0]].count) for place, found in ordered.items()]
    tables = workers.gather(records, summarised)
    return Results(
        suite=suite,
        target=target,
        policies=specs,
        tuned=tuned,
        seed=seed,
        split=split,
        episodes={name: found.count for name, found in sets.items()},
        jobs=tuple(jobs),
        samples=ordered,
        not_applicable=not_applicable | reasons,
        records=tuple(record for table in tables for record in table),
    )


def _by_name(suite: Suite, policies: Iterable[str | PolicySpec]) -> dict[str, PolicySpec]:
    """The policies, and the reference policies of the suite, by name."""
    listed = [get_policy_spec(policy) for policy in policies]
    specs = {spec.name: spec for spec in listed}
    if len(specs) < len(listed):
        raise ValueError(f"a comparison needs different names, got {', '.join(spec.name for spec in listed)}")
    for name in tuning.GROUPS.values():
        if name in specs:
            raise ValueError(f"{name!r} is the name of a tuned law: give your policy another name")
    for reference in suite.references:
        if specs.setdefault(reference.name, reference) != reference:
            raise ValueError(
                f"{reference.name!r} is the name of a reference policy of every suite: give your policy another name"
            )
    if not specs:
        raise ValueError("a comparison needs at least one policy")
    return specs


@dataclass
class _Runner:
    """Runs lists of jobs, and counts them for the progress callback."""

    store: Store | None
    workers: Workers
    progress: Callable[[str, int], None] | None
    total: int = 0

    def run(self, jobs: Sequence[Job]) -> list[JobResult]:
        """The results of jobs, in their order."""
        self.total += len(jobs)
        # The largest games first, so that no worker is left alone with one at the end.
        order = sorted(range(len(jobs)), key=lambda index: -jobs[index].track.world.game.num_players)
        found: dict[int, JobResult] = {}
        for place, result in run_jobs([jobs[index] for index in order], self.store, self.workers):
            job = jobs[order[place]]
            found[order[place]] = result
            if self.progress is not None:
                self.progress(f"{job.track.name}: {job.policy.name}", self.total)
        return [found[index] for index in range(len(jobs))]


_Place: TypeAlias = tuple[str, str]
"""Names of a track and of a policy."""


def _collected(
    jobs: Sequence[Job], results: Sequence[JobResult]
) -> tuple[dict[_Place, dict[str, FloatArray]], dict[_Place, str]]:
    """Samples of shape (training seeds, episodes) by metric, and the reasons where a policy cannot act."""
    grouped: dict[_Place, list[JobResult]] = {}
    for job, result in zip(jobs, results, strict=True):
        grouped.setdefault((job.track.name, job.policy.name), []).append(result)
    samples, reasons = {}, {}
    for place, found in grouped.items():
        reason = next((result.not_applicable for result in found if result.not_applicable is not None), None)
        if reason is None:
            samples[place] = {
                name: np.stack([result.of_metric(name) for result in found])
                for name, metric in METRICS.items()
                if metric.value is not None
            }
        else:
            reasons[place] = reason
    return samples, reasons


def _tuned_laws(suite: Suite, tracks: Sequence[Track], runner: _Runner) -> dict[str, dict[str, PolicySpec]]:
    """The best law of each group on the validation episodes of each track."""
    trials = [
        Job(track, law, 0, suite.episode_set(track.name, tuning.VALIDATION_EPISODES, split="validation"))
        for track in tracks
        for law in tuning.candidate_specs()
    ]
    digits: dict[str, dict[Any, float]] = {track.name: {} for track in tracks}
    for job, result in zip(trials, runner.run(trials), strict=True):
        digits[job.track.name][job.policy.policy] = float(result.samples["digits"].mean())
    return {track: tuning.best(found) for track, found in digits.items()}
