"""Verification of published results: their tables are rebuilt, and some of their jobs run again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.comparison import Job, JobResult
from ptne_env.evaluation.metrics import METRICS
from ptne_env.evaluation.policy_spec import POLICIES
from ptne_env.evaluation.provenance import arithmetic, file_hash, versions
from ptne_env.evaluation.results import Results, read_results
from ptne_env.evaluation.statistics import estimate
from ptne_env.learn.policy_files import DATA
from ptne_env.shared.arrays import FloatArray, require_count
from ptne_env.shared.parts import foreign_targets
from ptne_env.suites.suite import REFERENCES, SUITES, get_suite

SAMPLE = 2
"""Number of jobs of every policy that run again; one of a reference policy."""

ROUNDING = 1e-6
"""Largest |new − old|/(1 + |old|) with which a value repeats, because values are rounded to seven decimals."""

_SUMS = 1e-9
"""Largest such difference of numbers in tables, in which only the order of sums differs."""


@dataclass(frozen=True)
class Repetition:
    """A job that was run again.

    Attributes:
        track: the name of the track.
        policy: the name of the policy.
        training_seed: the index of the training seed.
        difference: the largest |new − old|/(1 + |old|) of any value; ``None`` where only one of the runs has a value.
        agrees: whether the numbers repeat, or with another arithmetic, whether the 95 % intervals of all metrics
            overlap.
        reason: why the new run has no numbers; ``None`` where it has them.
    """

    track: str
    policy: str
    training_seed: int
    difference: float | None
    agrees: bool
    reason: str | None = None


@dataclass(frozen=True)
class Verification:
    """The outcome of a verification.

    Attributes:
        differences: a text for each fault of the tables and samples.
        repetitions: the jobs that were run again.
        jobs: the number of jobs in the results.
        same_arithmetic: whether this machine has the processor's extensions, the BLAS kernels and the versions of
            libraries with which the results were computed. Otherwise rounding differs, and jobs are judged by
            statistics.
    """

    differences: tuple[str, ...]
    repetitions: tuple[Repetition, ...]
    jobs: int
    same_arithmetic: bool

    @property
    def passes(self) -> bool:
        """Whether the tables follow from the samples, and all repeated jobs agree."""
        return not self.differences and all(repetition.agrees for repetition in self.repetitions)


def verify(
    path: Path,
    *,
    sample: int = SAMPLE,
    seed: int | None = None,
    trust: bool = False,
    progress: Callable[[str, int], None] | None = None,
) -> Verification:
    """Rebuild the tables of published results from their samples, and run some of their jobs again.

    The decisions in these jobs are audited thoroughly.

    Args:
        path: the path of a file ``results.json``, or of its folder. The files of policies are found by their SHA-256 in
            the folder, or at the paths that the results name.
        sample: the number of jobs of every policy that run again; one of a reference policy.
        seed: the seed of the choice of jobs; unpredictable if left out.
        trust: whether code from outside the library that the results name may run.
        progress: called when a job is done, with ``"track: policy"`` and the number of jobs to run.

    Raises:
        OSError: when there are no results, or a file of a policy is missing.
        ValueError: when the file is damaged, too large or of another kind, when the results name code from outside the
            library and ``trust`` is not set, or when a policy was an object of another process.
    """
    require_count("sample", sample, 1)
    data = read_results(path)
    if not trust and (foreign := foreign_targets(data)):
        raise ValueError(
            f"{path} names code from outside the library, which a verification runs: {', '.join(foreign)}. Say that "
            "you trust it (--trust)"
        )
    folder = path if path.is_dir() else path.parent
    data = {**data, "policies": [_locate_files(policy, folder) for policy in data["policies"]]}
    results = Results.from_dict(data)
    differences = [*_differences_of_rules(results, data), *_differences_of_samples(results)]
    if not differences:
        differences = list(_differences_of_tables(results, data))
    same = data["arithmetic"] == arithmetic() and data["versions"] == versions(data["versions"])
    sampled, jobs = _sample_jobs(results, sample, np.random.default_rng(seed))
    repetitions = []
    for job in sampled:
        repetitions.append(_repeat(results, job, same_arithmetic=same))
        if progress is not None:
            progress(f"{job.track.name}: {job.policy.name}", len(sampled))
    return Verification(tuple(differences), tuple(repetitions), jobs, same)


def _locate_files(policy: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the policy with the paths of the same files in the folder of the results, where there are such files."""
    here = {file_hash(file): str(file) for file in folder.rglob("*") if file.suffix in DATA.endings}
    seeds = []
    for seed in policy["training_seeds"]:
        if seed.get("target") == DATA.target and seed["sha256"] in here:
            seed = {**seed, "arguments": {**seed["arguments"], DATA.argument: here[seed["sha256"]]}}  # noqa: PLW2901
        seeds.append(seed)
    return {**policy, "training_seeds": seeds}


def _differences_of_rules(results: Results, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield where the files of policies, or the rules of a published suite, differ from ours."""
    for spec, published in zip(results.policies.values(), data["policies"], strict=True):
        hashes = [[seed.get("sha256") for seed in policy["training_seeds"]] for policy in (spec.to_dict(), published)]
        if hashes[0] != hashes[1]:
            yield f"the files of policy {spec.name} are not those that were run"
        if spec.name in REFERENCES and spec != POLICIES[spec.name]:
            yield f"policy {spec.name} is not the reference policy of this name"
    if results.target is None or results.target not in SUITES:
        return
    suite = get_suite(results.target)
    for name in set(REFERENCES) - results.policies.keys():
        yield f"the reference policy {name} is missing"
    for track in results.tracks:
        count = results.episodes[track.name]
        if track not in suite.tracks:
            yield f"track {track.name} is not that of {suite.name}"
        elif results.episode_sets[track.name] != suite.episode_set(track.name, count, seed=results.seed):
            yield f"the episodes of track {track.name} are not those of {suite.name}"


def _differences_of_samples(results: Results) -> Iterator[str]:
    """Yield where samples are missing, or could not come from a run."""
    names = {name for name, metric in METRICS.items() if metric.value is not None}
    for track in results.tracks:
        for policy, spec in results.policies.items():
            place, shape = (track.name, policy), (len(spec.training_seeds), results.episodes[track.name])
            kinds = (results.samples, results.not_applicable, results.failures)
            if sum(place in kind for kind in kinds) != 1:
                yield f"{policy} on {track.name} has no result, or more than one"
                continue
            samples = results.samples.get(place, {})
            if place in results.samples and samples.keys() != names:
                yield f"{policy} on {track.name} has other metrics than a run gives"
            for metric, values in samples.items():
                if values.shape != shape:
                    yield f"{metric} of {policy} on {track.name} has the shape {values.shape}, expected {shape}"
                elif metric in METRICS and not METRICS[metric].admits(values):
                    yield f"{metric} of {policy} on {track.name} is outside its range {METRICS[metric].range}"


def _differences_of_tables(results: Results, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield where a record does not follow from the samples."""
    rebuilt = {_name(record): record for record in results.records if not METRICS[record["metric"]].is_timing}
    published = {_name(record): record for record in data["records"]}
    for name in rebuilt.keys() | published.keys():
        mine, theirs = rebuilt.get(name), published.get(name)
        if mine is None or theirs is None or len(published) != len(data["records"]):
            yield f"the record of {name} is missing, or there are too many"
        elif mine.keys() != theirs.keys() or not all(_is_same(theirs[key], mine[key]) for key in mine):
            yield f"the record of {name} is {theirs}, the samples give {mine}"


def _name(record: Mapping[str, Any]) -> str:
    return f"{record.get('metric')} of {record.get('policy')} on {record.get('track')}"


def _is_same(published: Any, rebuilt: Any) -> bool:
    if isinstance(rebuilt, float) and isinstance(published, float):
        return abs(published - rebuilt) <= _SUMS * (1 + abs(rebuilt))
    return type(published) is type(rebuilt) and bool(published == rebuilt)


def _sample_jobs(results: Results, sample: int, generator: np.random.Generator) -> tuple[list[Job], int]:
    """Return some jobs of every policy, and the number of jobs in the results."""
    sampled, total = [], 0
    for spec in results.policies.values():
        jobs = [
            Job(track, spec, training_seed, results.episode_sets[track.name])
            for track in results.tracks
            for training_seed in range(len(spec.training_seeds))
        ]
        count = 1 if spec.name in REFERENCES else sample
        sampled += [jobs[index] for index in sorted(generator.permutation(len(jobs))[:count])]
        total += len(jobs)
    return sampled, total


def _repeat(results: Results, job: Job, *, same_arithmetic: bool) -> Repetition:
    place, new = (job.track.name, job.policy.name), job.compute(thorough=True)
    repetition = partial(Repetition, *place, job.training_seed, reason=new.not_applicable or new.failure)
    if place in results.not_applicable:
        return repetition(difference=0.0, agrees=new.not_applicable is not None)
    if place in results.failures:  # of several training seeds, another one may have failed
        return repetition(difference=0.0, agrees=new.failure is not None or len(job.policy.training_seeds) > 1)
    if not new.samples:
        return repetition(difference=None, agrees=False)
    old = {name: values[job.training_seed] for name, values in results.samples.get(place, {}).items()}
    difference = _difference(old, new)
    if same_arithmetic:
        return repetition(difference=difference, agrees=difference is not None and difference <= ROUNDING)
    agrees = all(_overlap(old[name], new.samples[name]) for name in _comparable_metrics(old))
    return repetition(difference=difference, agrees=agrees and old.keys() == new.samples.keys())


def _comparable_metrics(samples: Mapping[str, FloatArray]) -> list[str]:
    """Return the metrics that another run repeats: all but timings."""
    return [name for name in samples if name in METRICS and not METRICS[name].is_timing]


def _difference(old: Mapping[str, FloatArray], new: JobResult) -> float | None:
    """Return the largest |new − old|/(1 + |old|); ``None`` where only one of the runs has a value."""
    largest = 0.0
    for name in _comparable_metrics(old):
        mine, theirs = new.samples.get(name), old[name]
        if mine is None or mine.shape != theirs.shape or (np.isnan(mine) != np.isnan(theirs)).any():
            return None
        largest = max(largest, float(np.nanmax(np.abs(mine - theirs) / (1 + np.abs(theirs)), initial=0.0)))
    return largest


def _overlap(old: FloatArray, new: FloatArray) -> bool:
    """Return whether the 95 % intervals of two means overlap up to rounding; single episodes always do."""
    if old.size < 2 or old.shape != new.shape:
        return old.shape == new.shape
    mine, theirs = estimate([new[None]]), estimate([old[None]])
    if mine.low is None or theirs.mean is None or theirs.low is None:
        return (mine.mean is None) == (theirs.mean is None)
    slack = 1e-3 * (1 + abs(theirs.mean))
    return mine.low - slack <= theirs.high and theirs.low - slack <= mine.high  # type: ignore[operator]
