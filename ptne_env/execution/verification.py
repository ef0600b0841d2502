"""Verification of published results: they follow from their samples, jobs repeat, and fresh episodes give no less."""

from __future__ import annotations

import json
import secrets
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.comparison import REFERENCES, Job
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.metrics import METRICS
from ptne_env.evaluation.policy_spec import POLICIES
from ptne_env.evaluation.provenance import arithmetic, file_hash, unequal, versions
from ptne_env.evaluation.results import SHOWN, Place, Results, read_results
from ptne_env.evaluation.statistics import chance, differ_by_rounding
from ptne_env.evaluation.tracks import Suite, get_suite
from ptne_env.learn.policy_files import DATA, LARGEST_FILE
from ptne_env.shared.arrays import FloatArray, require_count
from ptne_env.shared.parts import foreign_targets, names_of

SAMPLE = 2
"""Number of jobs of every policy that run again, beside those without numbers."""

ROUNDING = 1e-6
"""Largest |new − old|/(1e-9 + |old|) with which a value repeats, because values are rounded to seven decimals."""

FALSE_ALARM = 1e-3
"""Probability with which chance makes honest results fail the tests of all jobs against fresh episodes."""


@dataclass(frozen=True)
class Repetition:
    """A job that was run again.

    Attributes:
        track: the name of the track.
        policy: the name of the policy.
        training_seed: the index of the training seed.
        difference: the largest |new − old|/(1e-9 + |old|) of any value; ``None`` where only one run has a value.
        agrees: whether the numbers repeat, and those of fresh episodes are not lower than chance explains.
        reason: why a run has no numbers, or which numbers of fresh episodes are lower; ``None`` otherwise.
        fresh: the mean digits of fresh episodes; ``None`` where none were played, as by a policy that ships.
    """

    track: str
    policy: str
    training_seed: int
    difference: float | None
    agrees: bool
    reason: str | None = None
    fresh: float | None = None


@dataclass(frozen=True)
class Verification:
    """The outcome of a verification.

    Attributes:
        differences: a text for each fault of the file. If there is one, no job runs again.
        repetitions: the jobs that were run again.
        jobs: the number of jobs in the results.
        same_arithmetic: whether this machine has the processor's extensions, the BLAS kernels and the versions of
            libraries with which the results were computed. Otherwise rounding differs, and jobs are judged by
            statistics of the differences in each episode.
        seed: the seed of the choice of jobs and of the fresh episodes.
    """

    differences: tuple[str, ...]
    repetitions: tuple[Repetition, ...]
    jobs: int
    same_arithmetic: bool
    seed: int

    @property
    def passes(self) -> bool:
        """Whether the file has no fault, and all repeated jobs agree."""
        return not self.differences and all(repetition.agrees for repetition in self.repetitions)


def verify(
    path: Path,
    *,
    sample: int = SAMPLE,
    seed: int | None = None,
    trust: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Verification:
    """Build published results again from their samples, run some of their jobs again, and play fresh episodes.

    The decisions in these jobs are audited thoroughly. Where a policy does not ship, its jobs also play as many fresh
    episodes, which it cannot have seen. Published digits, and those on the way, must not be higher than chance explains
    (Welch's one-sided tests, Bonferroni's correction, :data:`FALSE_ALARM`).

    Args:
        path: the path of a file ``results.json``, or of its folder. The files of policies are found by their SHA-256 in
            the folder, or at the paths that the results name.
        sample: the number of jobs of every policy that run again, beside those that have failed or are n/a.
        seed: the seed of the choice of jobs and of fresh episodes, not that of the results; unpredictable if left out.
        trust: whether code from outside the library that the results name may run.
        progress: called when a job is done, with ``"track: policy"``, the number of finished jobs, and of all.

    Raises:
        OSError: when there are no results, or a file of a policy is missing.
        ValueError: when the file is damaged, too large or of another kind, when it names code from outside the library
            and ``trust`` is not set, when a policy was an object of another process, or for the seed of the results.
    """
    require_count("sample", sample, 1)
    seed = EpisodeSet(1, secrets.randbelow(1 << 32) if seed is None else seed).seed  # which checks it
    data = read_results(path)
    if not trust and (foreign := foreign_targets(data)):
        raise ValueError(
            f"{path} names code from outside the library, which a verification runs: {', '.join(foreign)}. Say that "
            "you trust it (--trust)"
        )
    _locate_files(data, path if path.is_dir() else path.parent)
    results = Results.from_dict(data)
    if seed in {episodes.seed for episodes in results.episode_sets.values()}:
        raise ValueError(f"the results have the seed {seed}: fresh episodes need another one")
    declared = data.get("versions")
    same = data.get("arithmetic") == arithmetic() and isinstance(declared, dict) and declared == versions(declared)
    total = sum(len(spec.training_seeds) for spec in results.policies.values()) * len(results.tracks)
    if faults := [*_faults_of_samples(results)] or [*_faults_of_content(results, data)]:
        return Verification(tuple(faults), (), total, same, seed)
    generator, sampled = np.random.default_rng(seed), []
    for spec in results.policies.values():
        pairs = [*product(results.tracks, range(len(spec.training_seeds)))]
        drawn = generator.permutation(len(pairs))[:sample]
        for index, (track, training_seed) in enumerate(pairs):
            if index in drawn or (training_seed == 0 and (track.name, spec.name) in results.reasons):
                sampled.append(Job(track, spec, training_seed, results.episode_sets[track.name]))
    level = FALSE_ALARM / (len(sampled) * len(METRICS))
    repetitions = []
    for job in sampled:
        repetitions.append(_repeat(results, job, seed, level, same_arithmetic=same))
        if progress is not None:
            progress(f"{job.track.name}: {job.policy.name}", len(repetitions), len(sampled))
    return Verification((), tuple(repetitions), total, same, seed)


def _locate_files(data: dict[str, Any], folder: Path) -> None:
    """Change the paths of files of policies to those of the same files in a folder, where there are such files."""
    files = [file for file in folder.rglob("*") if file.suffix in DATA.endings and file.is_file()]
    here = {file_hash(file): str(file) for file in files if file.stat().st_size <= LARGEST_FILE}
    try:
        for source in [source for policy in data["policies"] for source in policy["training_seeds"]]:
            arguments = source.get("arguments")
            if source.get("target") == DATA.target and Path(arguments[DATA.argument]).suffix:  # no shipped one
                arguments[DATA.argument] = here.get(source["sha256"], arguments[DATA.argument])
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"not results: {type(error).__name__}: {error}") from error


def _faults_of_samples(results: Results) -> Iterator[str]:
    """Yield where numbers are missing, belong to nothing that is listed, or could not come from a run."""
    tracks = [track.name for track in results.tracks]
    listed = {*product(tracks, results.policies)}
    if not listed:
        yield "no track or no policy is listed"
    if len(set(tracks)) < len(tracks) or results.episodes.keys() != set(tracks):
        yield f"the tracks are {', '.join(tracks)}, but there are episodes of {', '.join(results.episodes)}"
        return
    reasons = results.not_applicable | results.failures
    counts = Counter([*results.samples, *results.not_applicable, *results.failures])
    for place in sorted(listed | counts.keys()):
        at = f"{place[1]} on {place[0]}"
        if counts[place] != (place in listed):
            yield f"{at} has {counts[place]} results; each listed policy has one on each track, and no other one"
        elif place in results.samples:
            yield from _faults_of_values(results, place, at)
        elif not (isinstance(reasons[place], str) and reasons[place]):
            yield f"{at} has no numbers and no reason"


def _faults_of_values(results: Results, place: Place, at: str) -> Iterator[str]:
    """Yield where the samples of a policy on a track have another form or range than those of a run."""
    samples = results.samples[place]
    measured = {name for name, metric in METRICS.items() if metric.value is not None}
    shape = (len(results.policies[place[1]].training_seeds), results.episodes[place[0]])
    if samples.keys() != measured:
        yield f"{at} has other metrics than a run gives: {', '.join(sorted(samples.keys() ^ measured))}"
    for metric in samples.keys() & measured:
        values = samples[metric]
        if values.shape != shape:
            yield f"{metric} of {at} has the shape {values.shape}, expected {shape}"
        elif not METRICS[metric].admits(values) or (metric in SHOWN and np.isnan(values).any()):
            yield f"{metric} of {at} is outside its range {METRICS[metric].range}"


def _faults_of_content(results: Results, data: Mapping[str, Any]) -> Iterator[str]:
    """Yield where the file is not what its samples, the files of its policies, and published names give."""
    names = [name for name in names_of("suite") if name in (results.name, results.target)]
    usual = max((results.episodes[track.name] for track in results.tracks if not track.episodes), default=1)
    suite = get_suite(names[0]) if names else Suite(results.name, results.tracks, usual)
    split: Split = "test" if names else results.split
    episodes = {track.name: suite.episode_set(track.name, seed=results.seed, split=split) for track in suite.tracks}
    if results.is_comparison and not names:
        episodes = {name: replace(drawn, track=results.episode_sets[name].track) for name, drawn in episodes.items()}
    machine = {key: data[key] for key in ("versions", "arithmetic") if isinstance(data.get(key), dict)}
    expected = results.to_dict() | {
        "name": suite.name,
        "suite": names[0] if names else results.target,
        "tracks": [track.to_dict() for track in suite.tracks],
        "episodes": {name: asdict(drawn) for name, drawn in episodes.items()},
        "policies": [POLICIES.get(name, spec).to_dict() for name, spec in results.policies.items()],
        "checksum": data["checksum"],
        **machine,  # which only chooses how jobs are judged
    }
    for policy in expected["policies"]:
        sources = [source["sha256"] or str(source) for source in policy["training_seeds"]]
        if len(set(sources)) < len(sources):
            yield f"training seeds of policy {policy['name']} are the same policy"
    for reference in set(REFERENCES) - results.policies.keys() if names else ():
        yield f"the reference policy {reference} is missing"
    yield from unequal(data, json.loads(json.dumps(expected)))


def _repeat(results: Results, job: Job, seed: int, level: float, *, same_arithmetic: bool) -> Repetition:
    """Run a job again, and fresh episodes where the policy does not ship; ``level`` is that of every test."""
    place = job.track.name, job.policy.name
    repetition = Repetition(*place, job.training_seed, None, agrees=False)
    if place not in results.samples:  # another training seed may be the reason
        outcome = "failure" if place in results.failures else "not_applicable"
        seeds = range(len(job.policy.training_seeds))
        repeats = (getattr(replace(job, training_seed=index).compute(thorough=True), outcome) for index in seeds)
        return replace(repetition, difference=0.0, agrees=any(repeats))
    new = job.compute(thorough=True)
    if not new.samples:
        return replace(repetition, reason=new.not_applicable or new.failure)
    old = {name: values[job.training_seed] for name, values in results.samples[place].items()}
    pairs = [(values, new.samples[name]) for name, values in old.items() if not METRICS[name].is_timing]
    values, again = map(np.concatenate, zip(*pairs, strict=True))
    changes = np.abs(again - values) / (1e-9 + np.abs(values))
    same_holes = bool((np.isnan(values) == np.isnan(again)).all())
    difference = float(np.nanmax(changes, initial=0.0)) if same_holes else None
    exact = difference is not None and difference <= ROUNDING
    agrees = exact if same_arithmetic else all(differ_by_rounding(*pair, level) for pair in pairs)
    repetition = replace(repetition, difference=difference, agrees=agrees)
    return repetition if job.policy.name in POLICIES or not agrees else _play_fresh(repetition, job, old, seed, level)


def _play_fresh(repetition: Repetition, job: Job, old: Mapping[str, FloatArray], seed: int, level: float) -> Repetition:
    """Run a job with a fresh seed, and complete its repetition: published numbers must not be higher."""
    fresh = replace(job, episodes=replace(job.episodes, seed=seed)).compute()
    reasons = [reason for reason in (fresh.not_applicable, fresh.failure) if reason]
    for name in {"digits", "digits_on_the_way"} & fresh.samples.keys():
        before, after = old[name], fresh.samples[name]
        if chance(float(before.mean() - after.mean()), before, after) < level:
            reasons.append(f"{before.mean():.2f} {METRICS[name].heading} are {after.mean():.2f}")
    reason = f"with the fresh seed: {', '.join(sorted(reasons))}" if reasons else None
    digits = float(fresh.samples["digits"].mean()) if fresh.samples else None
    return replace(repetition, agrees=not reasons, reason=reason, fresh=digits)
