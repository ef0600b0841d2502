"""Running a suite: from policies and tracks to jobs, from jobs to results."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from ptne_env.evaluation import tuning
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.jobs import Job, JobResult, require_hashed
from ptne_env.evaluation.metrics import against_law
from ptne_env.evaluation.policy_specs import POLICIES, PolicySpec, get_policy_spec
from ptne_env.evaluation.results import Results, records, statistics_of
from ptne_env.evaluation.store import Store, run_jobs, run_missing
from ptne_env.evaluation.suite import (
    COMPARED_EPISODES,
    LAW,
    LEADERBOARD_SEED,
    SUITES,
    Suite,
    Track,
    comparison,
    get_suite,
)
from ptne_env.evaluation.tuning import Tunable, Tuned, Tuning, Tunings
from ptne_env.evaluation.workers import Workers
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.scenario import Scenario

Opposed: TypeAlias = bool | Literal["published"]
"""Where policies are compared with tuned laws: everywhere, nowhere, or where these laws ship with the library."""


def evaluate(
    policies: str | PolicySpec | Iterable[str | PolicySpec],
    scenarios: str | Scenario | Iterable[str | Scenario],
    *,
    episodes: int = COMPARED_EPISODES,
    seed: int = 0,
    hold_steps: int = 0,
    split: Split = "test",
    against_laws: Opposed = "published",
    folder: Path | None = None,
    rerun: bool = False,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int, int], None] | None = None,
) -> Results:
    """Run every policy on every scenario from the same seeded starts.

    A scenario of the catalogue, given by name, is run from ``episodes`` random starts. Any other is run as it is:
    ``episodes`` times when something in it is random, else once.

    Where something is random, every policy but the library's own laws is also compared, paired by episode, with the
    best of the paper's laws and the best of all laws. Both are tuned and chosen by the mean of the track's metric on
    validation episodes (:mod:`ptne_env.evaluation.tuning`). For the scenarios of the catalogue they ship with the
    library; ``against_laws=True`` tunes them for other scenarios too, which takes minutes per scenario.

    Args:
        policies: specs, or strings as :func:`~ptne_env.evaluation.policy_specs.get_policy_spec` takes them; one of
            them, or several.
        scenarios: scenarios, or names: of the catalogue, ``"SUITE/TRACK"`` or ``"module:object"``; one of them, or
            several.
        episodes: number of random starts.
        seed: of the episode sets; the remaining arguments are explained at :func:`run_suite`.
        hold_steps: steps after the deadline for the scenarios given by name.
        split: ``"test"``, ``"validation"`` or ``"train"``.
        against_laws: where policies are compared with tuned laws: ``"published"``, on scenarios whose tuned laws ship
            with the library; ``True``, on all; ``False``, on none.
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
        against_laws=against_laws,
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
    against_laws: Opposed = False,
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
        against_laws: as for :func:`evaluate`.
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
    opposed = []
    if against_laws and any(spec.is_learned for spec in specs):
        opposed = [
            track
            for track in map(suite.track, names)
            if track.world.is_random
            and (against_laws is True or all(search.is_published for search in _searches(suite, track)))
        ]
    runner.reserved = sum(_cost_of_opponents(suite, track, sets[track.name]) for track in opposed)
    opposed_names = {track.name for track in opposed}
    return assemble(suite, target, specs, sets, opposed=opposed_names, run=runner, tune=runner.tune)


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
    opposed: Container[str],
    run: Callable[[Sequence[Job]], list[JobResult]],
    tune: Callable[[Sequence[Tuning]], list[Tuned]],
) -> Results:
    """The results of a suite from the results of its jobs, of which there may be stored ones only.

    Args:
        suite: the suite.
        target: that finds it; ``None`` for an object.
        policies: beside the reference policies.
        episodes: the episode set of each track that is run, by name.
        opposed: names of the tracks on which policies are compared with tuned laws.
        run: gives the results of jobs, in their order.
        tune: gives the results of searches for tuned laws, in their order.

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
    tuned: dict[str, dict[str, PolicySpec]] = {}
    trials: dict[str, tuple[Job, ...]] = {}
    with_learned = {track for track, policy in samples if specs[policy].is_learned}
    random = [
        track for track in chosen if track.name in with_learned and track.world.is_random and track.name in opposed
    ]
    if random:
        tuned, trials = _tuned_laws(suite, random, run, tune)
        opposing = [Job(track, law, 0, episodes[track.name]) for track in random for law in tuned[track.name].values()]
        law_samples = _collected(opposing, run(opposing)).samples
        for (track_name, policy), measured in samples.items():
            if track_name in tuned and specs[policy].is_learned:
                metric = suite.track(track_name).metric
                for group, name in tuning.GROUPS.items():
                    measured.update(against_law(group, measured[metric], law_samples[track_name, name][metric]))
        jobs, samples = [*jobs, *opposing], {**samples, **law_samples}
    ordered = {
        (track.name, name): samples[track.name, name]
        for track in chosen
        for name in [*specs, *(law.name for law in tuned.get(track.name, {}).values())]
        if (track.name, name) in samples
    }
    first = next(iter(episodes.values()))
    return Results(
        suite=suite,
        target=target,
        policies=specs,
        tuned=tuned,
        seed=first.seed,
        split=first.split,
        episodes={name: found.count for name, found in episodes.items()},
        jobs=tuple(jobs),
        trials=trials,
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
    """Runs lists of jobs, and adds up their work for the progress callback.

    Jobs with the same key, such as those of a law under two names, run once, so that all have the same timings. Work
    that is known to come after the first list is ``reserved``, so that the progress does not fall back.
    """

    store: Store | None
    workers: Workers
    progress: Callable[[str, int, int], None] | None
    rerun: bool
    reserved: int = 0
    work: int = 0
    total: int = 0
    done: dict[str | tuple[int, int], JobResult] = field(default_factory=dict)

    def __call__(self, jobs: Sequence[Job]) -> list[JobResult]:
        """The results of jobs, in their order."""
        if self.store is not None and not self.rerun:
            require_hashed(jobs)
        names = [job.key or (self.total, index) for index, job in enumerate(jobs)]
        self._expect(sum(job.cost for job in jobs))
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

    def _expect(self, cost: int) -> None:
        """Add work to the total, the reserved work first."""
        if not self.total:
            self.total = cost + self.reserved
            return
        self.total += max(cost - self.reserved, 0)
        self.reserved = max(self.reserved - cost, 0)

    def tune(self, searches: Sequence[Tuning]) -> list[Tuned]:
        """The results of searches, in their order."""
        store = None if self.store is None else Tunings(self.store.folder)
        self._expect(sum(search.cost for search in searches))
        running = run_missing(
            searches,
            store,
            lambda missing: self.workers.run(Tuning.find, [(search,) for search in missing]),
            rerun=self.rerun,
        )
        found = {}
        for index, result in running:
            found[index] = result
            self.work += searches[index].cost
            if self.progress is not None and searches[index].cost:
                self.progress(f"{searches[index].track.name}: tuning laws", self.work, self.total)
        return [found[index] for index in range(len(searches))]


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


def _searches(suite: Suite, track: Track) -> list[Tuning]:
    """The searches for the laws with which policies are compared on a track."""
    return [Tuning(track, member, validation_set(suite, track)) for member in tuning.FIELD]


def _cost_of_opponents(suite: Suite, track: Track, episodes: EpisodeSet) -> int:
    """The work of finding the tuned laws of a track, and of playing them."""
    law = POLICIES[LAW]
    unknown = [search for search in _searches(suite, track) if not search.is_published]
    trials = len(unknown) * Job(track, law, 0, validation_set(suite, track)).cost
    return sum(search.cost for search in unknown) + trials + len(tuning.GROUPS) * Job(track, law, 0, episodes).cost


def validation_set(suite: Suite, track: Track) -> EpisodeSet:
    """The validation episodes on which laws are tuned for a track."""
    return suite.episode_set(track.name, tuning.VALIDATION_EPISODES, split="validation")


def _tuned_laws(
    suite: Suite,
    tracks: Sequence[Track],
    run: Callable[[Sequence[Job]], list[JobResult]],
    tune: Callable[[Sequence[Tuning]], list[Tuned]],
) -> tuple[dict[str, dict[str, PolicySpec]], dict[str, tuple[Job, ...]]]:
    """The best law of each group on the validation episodes of each track, and the jobs that show it.

    A trial that is published is not run.
    """
    searches = [search for track in tracks for search in _searches(suite, track)]
    laws = [
        (search, tuned.law, search.reached(tuned.law))
        for search, tuned in zip(searches, tune(searches), strict=True)
        if tuned.law is not None
    ]
    trials = [search.trial(law) for search, law, mean in laws if mean is None]
    played = zip(trials, run(trials), strict=True)
    digits: dict[str, dict[Tunable, tuple[FactorySpec, float]]] = {track.name: {} for track in tracks}
    for search, law, mean in laws:
        reached = tuning.mean_of(*next(played)) if mean is None else mean
        digits[search.track.name][search.member] = law, reached
    chosen = {name: tuning.best(found) for name, found in digits.items()}
    return chosen, {name: tuple(trial for trial in trials if trial.track.name == name) for name in digits}
