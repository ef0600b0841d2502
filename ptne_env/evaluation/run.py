"""Running a suite: from policies and tracks to jobs, from jobs to results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.jobs import Job, JobResult, require_hashed
from ptne_env.evaluation.policy_specs import PolicySpec, get_policy_spec
from ptne_env.evaluation.results import Results, records, statistics_of
from ptne_env.evaluation.store import Store, run_jobs
from ptne_env.evaluation.suite import (
    COMPARED_EPISODES,
    LEADERBOARD_SEED,
    SUITES,
    Suite,
    comparison,
    get_suite,
)
from ptne_env.evaluation.workers import Workers
from ptne_env.shared.arrays import FloatArray
from ptne_env.world.scenario import Scenario


def evaluate(
    policies: str | PolicySpec | Iterable[str | PolicySpec],
    scenarios: str | Scenario | Iterable[str | Scenario],
    *,
    episodes: int = COMPARED_EPISODES,
    seed: int = 0,
    hold_steps: int = 0,
    split: Split = "test",
    folder: Path | None = None,
    rerun: bool = False,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int, int], None] | None = None,
) -> Results:
    """Run every policy on every scenario from the same seeded starts.

    A scenario of the catalogue, given by name, is run from ``episodes`` random starts. Any other is run as it is:
    ``episodes`` times when something in it is random, else once.

    Args:
        policies: specs, or strings as :func:`~ptne_env.evaluation.policy_specs.get_policy_spec` takes them; one of
            them, or several.
        scenarios: scenarios, or names: of the catalogue, ``"SUITE/TRACK"`` or ``"module:object"``; one of them, or
            several.
        episodes: number of random starts.
        seed: of the episode sets; the remaining arguments are explained at :func:`run_suite`.
        hold_steps: steps after the deadline for the scenarios given by name.
        split: ``"test"``, ``"validation"`` or ``"train"``.
        folder: in which finished jobs are stored.
        rerun: whether stored jobs are run again.
        workers: run the jobs.
        progress: called when a job is done.

    Raises:
        ValueError, OSError, ImportError, ConnectionError, ChildProcessError: as :func:`run_suite`.
    """
    suite = comparison(_several(scenarios), episodes=episodes, hold_steps=hold_steps)
    return run_suite(
        suite,
        policies,
        seed=seed,
        split=split,
        folder=folder,
        rerun=rerun,
        workers=workers,
        progress=progress,
    )


def run_suite(
    suite: str | Suite,
    policies: str | PolicySpec | Iterable[str | PolicySpec],
    *,
    tracks: str | Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int = LEADERBOARD_SEED,
    split: Split = "test",
    folder: Path | None = None,
    rerun: bool = False,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int, int], None] | None = None,
) -> Results:
    """Run policies, and the reference policies of the suite, on the tracks of a suite.

    Jobs whose result is in the folder already are not run again, so an interrupted run goes on where it was. Workers
    return results, and only this process writes: they may be machines that share no folder with it, but they need the
    same library and the same files of policies and parts.

    A policy that fails on a track (it raises, answers in another form or does not pass the audit of its decisions)
    costs that track: :attr:`~ptne_env.evaluation.results.Results.failures` holds the reason, and nothing is stored.

    Args:
        suite: by name, ``"module:object"`` or as it is.
        policies: specs, or strings as :func:`~ptne_env.evaluation.policy_specs.get_policy_spec` takes them; one of
            them, or several.
        tracks: one name or several; all if left out.
        episodes: per track; the suite's own number if left out.
        seed: of the episode sets; the leaderboard's is 0.
        split: ``"test"``, ``"validation"`` or ``"train"``, which share no episode.
        folder: in which the results of finished jobs are stored; nothing is stored if left out.
        rerun: whether stored jobs are run again. Jobs whose sources cannot be hashed need it.
        workers: run the jobs. Only the measured times of policies depend on it.
        progress: called with ``"track: policy"``, the work that is done and all work when a job is done, both in
            :attr:`~ptne_env.evaluation.jobs.Job.cost`.

    Raises:
        ValueError: for unknown or repeated names, when no policy fits any track, a worker has other files, or the
            sources of a policy or a part cannot be hashed and ``rerun`` is not set.
        RuntimeError: when a reference policy fails.
        OSError: when the folder cannot be written.
        ImportError, ConnectionError, ChildProcessError: as :meth:`~ptne_env.evaluation.workers.Workers.run`.
    """
    target = suite if isinstance(suite, str) else suite.name if suite.name in SUITES else None
    suite = get_suite(suite)
    names = [track.name for track in suite.tracks] if tracks is None else list(dict.fromkeys(_several(tracks)))
    sets = {name: suite.episode_set(name, episodes, seed=seed, split=split) for name in names}
    runner = _Runner(None if folder is None else Store(folder), workers, progress, rerun=rerun)
    specs = [get_policy_spec(policy) for policy in _several(policies)]
    return assemble(suite, target, specs, sets, run=runner)


def _several(given: Any) -> Iterable[Any]:
    """Several things, of one or several."""
    if isinstance(given, str | PolicySpec | Scenario):
        return [given]
    if not isinstance(given, Iterable):
        raise TypeError(
            f"expected names, policies or scenarios, got a {type(given).__name__}; the scenario of an environment is "
            "env.scenario, and a policy of your own is PolicySpec(name, policy)"
        )
    return given


def assemble(
    suite: Suite,
    target: str | None,
    policies: Sequence[PolicySpec],
    episodes: Mapping[str, EpisodeSet],
    *,
    run: Callable[[Sequence[Job]], list[JobResult]],
) -> Results:
    """The results of a suite from the results of its jobs, of which there may be stored ones only.

    Args:
        suite: the suite.
        target: that finds it; ``None`` for an object.
        policies: beside the reference policies.
        episodes: the episode set of each track that is run, by name.
        run: gives the results of jobs, in their order.

    Raises:
        ValueError: for repeated names, or when no policy fits any track.
        RuntimeError: when a reference policy fails.
    """
    specs = _by_name(suite, policies)
    chosen = tuple(suite.track(name) for name in episodes)
    not_applicable = {
        (track.name, spec.name): f"it is run on {', '.join(sorted(spec.scenarios))} only"
        for track in chosen
        for spec in specs.values()
        if spec.scenarios is not None and track.scenario.name not in spec.scenarios
    }
    jobs = [
        Job(track, spec, training_seed, episodes[track.name])
        for track in chosen
        for spec in specs.values()
        if (track.name, spec.name) not in not_applicable
        for training_seed in range(len(spec.training_seeds))
    ]
    outcome = _collected(jobs, run(jobs))
    samples, not_applicable = outcome.samples, not_applicable | outcome.not_applicable
    references = {reference.name for reference in suite.references}
    own = specs.keys() - references
    if own and own.isdisjoint(policy for _, policy in (samples | outcome.failures)):
        (_, name), reason = next(iter(not_applicable.items()))
        raise ValueError(f"policy {name!r} fits no track: {reason}")
    for (track_name, name), reason in outcome.failures.items():
        if name in references:
            raise RuntimeError(f"the reference policy {name!r} fails on track {track_name!r}: {reason}")
    ordered = {
        (track.name, name): samples[track.name, name]
        for track in chosen
        for name in specs
        if (track.name, name) in samples
    }
    first = next(iter(episodes.values()))
    return Results(
        suite=suite,
        target=target,
        policies=specs,
        seed=first.seed,
        split=first.split,
        episodes={name: found.count for name, found in episodes.items()},
        jobs=tuple(jobs),
        samples=ordered,
        not_applicable=not_applicable,
        failures=outcome.failures,
        records=tuple(
            record
            for place, found in ordered.items()
            for record in records(*place, statistics_of(found), episodes[place[0]].count)
        ),
    )


def _by_name(suite: Suite, listed: Sequence[PolicySpec]) -> dict[str, PolicySpec]:
    """The policies, and the reference policies of the suite, by name."""
    specs = {spec.name: spec for spec in listed}
    if len(specs) < len(listed):
        raise ValueError(
            f"a comparison needs different names, got {', '.join(spec.name for spec in listed)}; a file gets another "
            "name by 'name=path'"
        )
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
    """Runs lists of jobs, and adds up their work for the progress callback.

    Jobs with the same key, such as those of a law under two names, run once, so that all have the same timings.
    """

    store: Store | None
    workers: Workers
    progress: Callable[[str, int, int], None] | None
    rerun: bool
    work: int = 0
    total: int = 0
    done: dict[str | tuple[int, int], JobResult] = field(default_factory=dict)

    def __call__(self, jobs: Sequence[Job]) -> list[JobResult]:
        """The results of jobs, in their order."""
        if self.store is not None and not self.rerun:
            require_hashed(jobs)
        names = [job.key or (self.total, index) for index, job in enumerate(jobs)]
        self.total += sum(job.cost for job in jobs)
        missing = {name: index for index, name in reversed(list(enumerate(names))) if name not in self.done}
        # Quick jobs first, so that progress shows at once; lists of policies begin with the fastest laws.
        order = sorted(missing.values(), key=lambda index: (jobs[index].cost, index))
        running = run_jobs([jobs[index] for index in order], self.store, self.workers, rerun=self.rerun)
        for index, result in chain(
            ((order[place], result) for place, result in running),
            ((index, self.done[name]) for index, name in enumerate(names) if missing.get(name) != index),
        ):
            self.done[names[index]] = result
            self.work += jobs[index].cost
            if self.progress is not None:
                self.progress(f"{jobs[index].track.name}: {jobs[index].policy.name}", self.work, self.total)
        return [self.done[name] for name in names]


_Place: TypeAlias = tuple[str, str]
"""Names of a track and of a policy."""


@dataclass
class _Outcome:
    """Samples of shape (training seeds, episodes) by metric, and reasons why there are none."""

    samples: dict[_Place, dict[str, FloatArray]]
    not_applicable: dict[_Place, str]
    failures: dict[_Place, str]


def _collected(jobs: Sequence[Job], results: Sequence[JobResult]) -> _Outcome:
    grouped: dict[_Place, list[JobResult]] = {}
    for job, result in zip(jobs, results, strict=True):
        grouped.setdefault((job.track.name, job.policy.name), []).append(result)
    outcome = _Outcome({}, {}, {})
    for place, found in grouped.items():
        failure = next((result.failure for result in found if result.failure is not None), None)
        reason = next((result.not_applicable for result in found if result.not_applicable is not None), None)
        if failure is not None:
            outcome.failures[place] = failure
        elif reason is not None:
            outcome.not_applicable[place] = reason
        else:
            columns = [result.by_metric() for result in found]
            outcome.samples[place] = {name: np.stack([column[name] for column in columns]) for name in columns[0]}
    return outcome
