"""Checking published results: rebuilding their tables, and running a sample of their jobs again."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.jobs import Job, JobResult
from ptne_env.evaluation.metrics import METRICS
from ptne_env.evaluation.policy_specs import PolicySpec
from ptne_env.evaluation.results import read_results
from ptne_env.evaluation.run import assemble
from ptne_env.evaluation.store import PublishedStore
from ptne_env.evaluation.suite import Suite, comparison, foreign_suites, get_suite
from ptne_env.shared.arrays import FloatArray, require_count
from ptne_env.shared.files import read_json, require_file
from ptne_env.world.catalogue import CATALOGUE

SIGNIFICANCE = 1e-3
"""Probability that honest results have a job whose score is called better than on fresh episodes."""

LARGEST = 10_000
"""Most episodes of a track, and most steps after the deadline, that a check runs: others chose these numbers."""

_DIGEST = re.compile("[0-9a-f]{64}")

_REBUILT = (
    "suite",
    "seed",
    "split",
    "episodes",
    "policies",
    "records",
    "not_applicable",
    "failures",
    "leaderboard",
    "timings",
)
"""The keys of results that follow from the stored jobs."""


@dataclass(frozen=True)
class Repetition:
    """A job that was run again, on the published episodes and on fresh ones.

    Attributes:
        job: the job.
        difference: as :meth:`~ptne_env.evaluation.jobs.JobResult.difference`.
        failure: why there are no numbers of one of the runs; ``None`` where there are.
        published: mean score of the track's metric on the published episodes, as stored; ``None`` without a score.
        fresh: the same on as many fresh episodes; ``None`` too where nothing is random.
        probability: that a policy that does not know the published episodes does as well on them compared with the
            fresh ones (one-sided Mann-Whitney tests of the score and of the time to 1e-6, by which ranks are given).
        knows_episodes: whether that probability is below :data:`SIGNIFICANCE`, shared by the jobs of the check.
    """

    job: Job
    difference: float
    failure: str | None
    published: float | None
    fresh: float | None
    probability: float | None
    knows_episodes: bool

    def passes(self, tolerance: float = 0.0) -> bool:
        """Whether the job reproduces within ``tolerance``, and does not depend on the published episodes."""
        acts_on_published_alone = self.published is not None and self.failure is not None
        return self.difference <= tolerance and not acts_on_published_alone and not self.knows_episodes


@dataclass(frozen=True)
class Check:
    """The outcome of a check.

    Attributes:
        differences: between the tables of the results and those that follow from the stored jobs, one text each.
        repetitions: the jobs that were run again.
        missing: policies whose jobs cannot run again here, one text each, with the files that are missing.
    """

    differences: tuple[str, ...]
    repetitions: tuple[Repetition, ...]
    missing: tuple[str, ...] = ()

    def agrees(self, tolerance: float = 0.0) -> bool:
        """Whether the tables follow from the jobs and all repeated jobs pass."""
        return not self.differences and all(repetition.passes(tolerance) for repetition in self.repetitions)

    def passes(self, tolerance: float = 0.0) -> bool:
        """Whether everything agrees, and the jobs of every policy can be run again."""
        return self.agrees(tolerance) and not self.missing


def check(
    results: Path,
    *,
    suite: Suite | None = None,
    sample: int = 5,
    seed: int | None = None,
    tolerance: float = 0.0,
    trust: bool = False,
    progress: Callable[[str, int], None] | None = None,
) -> Check:
    """Rebuild the tables of published results from the stored jobs, and run a random sample of the jobs again.

    Each job of the sample runs twice: on the published episodes, with a thorough audit of the decisions, and on fresh
    episodes, which no policy can know. Jobs that are recorded as failed or as n/a always run again.

    Args:
        results: a file ``results.json``, or its folder, with the stored jobs beside it; or an archive of that folder.
        suite: that was run, where its name in the results does not find it.
        sample: number of jobs with numbers; all if there are fewer.
        seed: of the choice and of the fresh episodes; unpredictable if left out.
        tolerance: largest |new − old|/(1 + |old|) of numbers in tables; the caller applies it to jobs.
        trust: whether code outside this library that the results name may be executed.
        progress: called with ``"track: policy"`` and the number of jobs to run when a job is done.

    Raises:
        FileNotFoundError: when there are no results, or the file of a job is missing. A policy whose file is missing
            is no error: see :attr:`Check.missing`.
        ValueError: when a file is damaged, of another kind or of another version, or names more than :data:`LARGEST`
            episodes or steps after the deadline, the suite is not the one that was run, the files of a policy differ,
            the results name foreign code and ``trust`` is not set, or a policy was an object of another process.
    """
    require_count("sample", sample, 1)
    path, data, listing = _read(results)
    if not trust and (foreign := listing.foreign_code(suite)):
        raise ValueError(
            f"{path} names code outside this library, which a check executes: {', '.join(foreign)}. Say that you "
            "trust it (--trust)"
        )
    policies = listing.policies()
    suite = listing.suite() if suite is None else suite
    if suite.content_hash != listing.content_hash:
        raise ValueError(
            f"{path} is of a {suite.name} with the content hash {listing.content_hash}; this library's is "
            f"{suite.content_hash}"
        )
    stored = _Stored(listing)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # forged numbers may overflow
            rebuilt = assemble(
                suite,
                listing.target,
                policies,
                {
                    name: suite.episode_set(name, count, seed=listing.seed, split=listing.split)
                    for name, count in listing.episodes.items()
                },
                run=stored,
            )
    except RuntimeError as error:
        raise ValueError(f"{path} cannot be the results of a run: {error}") from error
    tables = json.loads(rebuilt.to_json())
    differences = [
        *(text for key in _REBUILT for text in _differences(key, data[key], tables[key], tolerance)),
        *(f"{key} is no part of results" for key in sorted(data.keys() - tables.keys())),
        *stored.unused(),
    ]
    generator = np.random.default_rng(seed)
    present = rebuilt.jobs
    without = [job for job in present if not stored.of(job).samples]
    others = [job for job in present if stored.of(job).samples]
    chosen = [*without, *(others[index] for index in sorted(generator.permutation(len(others))[:sample].tolist()))]
    repetitions = []
    for job in chosen:
        fresh = replace(job.episodes, seed=int(generator.integers(1 << 32)))
        repetitions.append(_repeat(job, stored.of(job), fresh, SIGNIFICANCE / len(chosen)))
        if progress is not None:
            progress(f"{job.track.name}: {job.policy.name}", len(chosen))
    return Check(tuple(differences), tuple(repetitions))


def foreign_code(results: Path) -> list[str]:
    """What a check of results executes that is not of this library: targets, nested ones too, and paths of archives.

    Nothing is imported.

    Args:
        results: a file ``results.json``, its folder, or an archive.

    Raises:
        FileNotFoundError: when there are no results.
        ValueError: when the file is damaged, of another kind or of another version, or a policy was an object.
    """
    return _read(results)[2].foreign_code(None)


def _read(results: Path) -> tuple[Path, dict[str, Any], _Listing]:
    path = results / "results.json" if results.is_dir() else results
    require_file(path)
    data = read_results(path)
    return path, data, _Listing.of(path, data)


@dataclass(frozen=True)
class _Listing:
    """What results say about their run, before anything that they name is imported.

    Attributes:
        path: of the results.
        target: of the suite; ``None`` where it was an object.
        content_hash: of the suite.
        hold_steps: of a comparison of scenarios; ``None`` for another suite.
        tracks: names of all tracks of the suite.
        default_episodes: of the suite.
        specs: the policies as JSON objects.
        episodes: number of episodes by name of the track.
        seed, split: of the episode sets.
        keys: of the stored jobs, by track, policy and training seed.
        failures: reasons, by track and policy.
        metrics: whose samples were published.
        versions: of the libraries that computed the jobs.
    """

    path: Path
    target: str | None
    content_hash: str
    hold_steps: int | None
    tracks: tuple[str, ...]
    default_episodes: int
    specs: tuple[dict[str, Any], ...]
    episodes: dict[str, int]
    seed: int
    split: Split
    keys: dict[tuple[str, str, int], str | None]
    failures: dict[tuple[str, str], str]
    metrics: frozenset[str]
    versions: dict[str, str]

    @classmethod
    def of(cls, path: Path, data: Mapping[str, Any]) -> _Listing:
        """The listing of the content of ``path``.

        Raises:
            ValueError: when something is missing, of another type, or larger than :data:`LARGEST`.
        """
        try:
            suite, is_comparison = data["suite"], data["suite"]["rules"]["is_comparison"]
            jobs = [(job["track"], job["policy"], job["training_seed"], job["key"]) for job in data["jobs"]]
            listing = cls(
                path=path,
                target=suite["target"],
                content_hash=suite["content_hash"],
                hold_steps=suite["tracks"][0]["scenario"]["hold_steps"] if is_comparison else None,
                tracks=tuple(track["name"] for track in suite["tracks"]),
                default_episodes=suite["rules"]["episodes"],
                specs=tuple(data["policies"]),
                episodes=dict(data["episodes"]),
                seed=data["seed"],
                split=data["split"],
                keys={job[:3]: job[3] for job in jobs},
                failures={(item["track"], item["policy"]): str(item["reason"]) for item in data["failures"]},
                metrics=frozenset(_source(record["metric"]) for record in data["records"]),
                versions=dict(data["versions"]),
            )
        except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{path} is not a file of results: {error!r}") from error
        if len(listing.keys) < len(jobs):
            raise ValueError(f"{path} is not a file of results: a job is listed twice")
        sizes = {f"episodes of track {track!r}": count for track, count in listing.episodes.items()}
        for name, size in (sizes | {"hold_steps": listing.hold_steps or 0}).items():
            if require_count(name, size, 0) > LARGEST:
                raise ValueError(f"{path} names {size} {name}; a check runs at most {LARGEST}: publish a smaller run")
        return listing

    def foreign_code(self, suite: Suite | None) -> list[str]:
        """What a check executes that is not of this library; the target of the suite only where none is given.

        Raises:
            ValueError: when a policy was an object, or something else stands in its place.
        """
        suites = foreign_suites(self.target) if suite is None else []
        found = [code for spec in self.specs for code in PolicySpec.from_dict(spec).foreign_code]
        return list(dict.fromkeys([*suites, *found]))

    def suite(self) -> Suite:
        """The suite: by its address, or the comparison of the scenarios of the catalogue that the results name.

        Raises:
            ValueError: when there is no such suite or scenario.
        """
        if self.target is not None:
            return get_suite(self.target)
        if self.hold_steps is None:
            raise ValueError(f"the suite of {self.path} was an object: pass it to check()")
        if unknown := [name for name in self.tracks if name not in CATALOGUE]:
            raise ValueError(f"the scenarios {', '.join(unknown)} are not in the catalogue: pass the suite to check()")
        return comparison(self.tracks, episodes=self.default_episodes, hold_steps=self.hold_steps)

    def policies(self) -> list[PolicySpec]:
        """The policies of the results.

        A file that was run is looked for at its path, then among the copies beside the results; it may be missing.

        Raises:
            ValueError: when one was an object, or its files are not those that were run.
        """
        found = []
        for spec in self.specs:
            policy = PolicySpec.from_dict(spec)
            if policy.to_dict() != spec:
                raise ValueError(
                    f"the files of policy {policy.name!r} are not those that were run: bring those back, "
                    "or run the suite again"
                )
            found.append(policy)
        return found


def _source(metric: Any) -> str:
    """The metric whose samples a record summarises."""
    return METRICS[metric].source if metric in METRICS else str(metric)


class _Stored:
    """Gives the stored results of the jobs that results list, in place of a run."""

    def __init__(self, listing: _Listing) -> None:
        self._store = PublishedStore(listing.path.parent, listing.metrics)
        self._keys = dict(listing.keys)
        self._failures, self._versions = listing.failures, listing.versions
        self._found: dict[Job, JobResult] = {}

    def __call__(self, jobs: Sequence[Job]) -> list[JobResult]:
        for job in jobs:
            self._found[job] = self._load(job)
        return [self._found[job] for job in jobs]

    def of(self, job: Job) -> JobResult:
        """The stored result of a job that was asked for before."""
        return self._found[job]

    def _load(self, job: Job) -> JobResult:
        track, policy = job.track.name, job.policy.name
        failure = self._failures.get((track, policy))
        key = self._keys.pop((track, policy, job.training_seed), None)
        if failure is not None:
            return JobResult({}, {}, None, failure)
        if key is None:
            raise ValueError(
                f"no stored job of policy {policy!r} on track {track!r}: the results are of an object of another "
                "process, or jobs are missing from their list; run the suite again with policies named 'module:object'"
            )
        try:
            result = self._store.load(key)
        except FileNotFoundError as error:
            raise FileNotFoundError(
                f"no stored job of policy {policy!r} on track {track!r}: {error.filename} is missing; copy the folder "
                "jobs/ together with results.json, or run the suite again"
            ) from error
        mine = {**json.loads(json.dumps(job.to_dict())), "versions": self._versions}
        theirs = read_json(self._store.path(key), "the result of a job")["job"]
        if different := sorted(name for name in mine if mine[name] != theirs.get(name)):
            raise ValueError(
                f"the stored job of policy {policy!r} on track {track!r} is of another {', '.join(different)}: run "
                "the suite again"
            )
        return result

    def unused(self) -> Iterator[str]:
        """A text for each listed job that no table needs."""
        for track, policy, training_seed in self._keys:
            yield f"jobs: {policy} (training seed {training_seed}) on {track} belongs to no table"


def _repeat(job: Job, stored: JobResult, fresh: EpisodeSet, significance: float) -> Repetition:
    """Run a job again, on its own episodes and on fresh ones."""
    again = job.compute(thorough=True)
    failure, published, elsewhere, probability = again.failure, None, None, None
    if job.track.metric in stored.samples:
        scores = stored.samples[job.track.metric]
        published = float(scores.mean())
        if failure is None and job.track.world.is_random and len(scores) > 1:
            other = replace(job, episodes=fresh).compute()
            failure = other.failure or other.not_applicable
            if failure is None:
                elsewhere = float(other.samples[job.track.metric].mean())
                probability = _probability(job, stored, other)
    return Repetition(
        job,
        stored.difference(again),
        failure,
        published,
        elsewhere,
        probability,
        knows_episodes=probability is not None and probability < significance,
    )


def _probability(job: Job, published: JobResult, fresh: JobResult) -> float:
    """Of published results at least as good, where both come from one distribution.

    Ranks depend on the score, and of policies that saturate a track on the time to 1e-6. The smaller probability of the
    two counts twice.
    """
    scores = (result.samples[job.track.metric] for result in (published, fresh))
    times = (-np.nan_to_num(result.samples["settling_time_1e_6"], nan=np.inf) for result in (published, fresh))
    return min(1.0, 2 * min(_at_least_as_good(*scores), _at_least_as_good(*times)))


def _at_least_as_good(published: FloatArray, fresh: FloatArray) -> float:
    """The same of values, higher ones being better."""
    if len(np.unique([published, fresh])) == 1:
        return 1.0
    return float(stats.mannwhitneyu(published, fresh, alternative="greater").pvalue)


def _differences(place: str, found: Any, rebuilt: Any, tolerance: float) -> Iterator[str]:
    """The places where JSON values differ, one text each."""
    if isinstance(found, dict) and isinstance(rebuilt, dict) and found.keys() == rebuilt.keys():
        for key, value in found.items():
            yield from _differences(f"{place}.{key}", value, rebuilt[key], tolerance)
    elif isinstance(found, list) and isinstance(rebuilt, list) and len(found) == len(rebuilt):
        for index, value in enumerate(found):
            names = [value[key] for key in ("track", "policy", "metric") if key in value] if _is_row(value) else [index]
            label = ", ".join(map(str, names))
            yield from _differences(f"{place}[{label}]", value, rebuilt[index], tolerance)
    elif not _is_same(found, rebuilt, tolerance):
        yield f"{place} is {found!r:.60}, the jobs give {rebuilt!r:.60}"


def _is_row(value: Any) -> bool:
    """Whether a JSON value is a row of a table, which has the name of its policy."""
    return isinstance(value, dict) and "policy" in value


def _is_same(found: Any, rebuilt: Any, tolerance: float) -> bool:
    if type(found) is not type(rebuilt):  # an integer may be too large for a float
        return False
    if isinstance(found, float):
        return abs(found - rebuilt) <= tolerance * (1 + abs(rebuilt))
    return bool(found == rebuilt)
