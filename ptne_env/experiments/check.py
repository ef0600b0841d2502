"""Checking published results: running a random sample of their jobs again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.arrays import require_count
from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments.jobs import Job
from ptne_env.experiments.policy_specs import ARCHIVE, PolicySpec
from ptne_env.experiments.results import read_results
from ptne_env.experiments.store import Store
from ptne_env.experiments.suite import PAPER_START, Suite, comparison, get_suite
from ptne_env.factory import FactorySpec


@dataclass(frozen=True)
class Repetition:
    """A job that was run again.

    Attributes:
        job: the job.
        difference: as :meth:`~ptne_env.experiments.jobs.JobResult.difference`.
    """

    job: Job
    difference: float


def check(
    results: Path,
    *,
    suite: Suite | None = None,
    sample: int = 5,
    seed: int | None = None,
    trust: bool = False,
    progress: Callable[[str, int], None] | None = None,
) -> list[Repetition]:
    """Run a random sample of the jobs of published results again.

    Args:
        results: a file ``results.json``, or its folder, with the stored jobs beside it.
        suite: that was run, where its name in the results does not find it.
        sample: number of jobs; all if there are fewer.
        seed: of the choice; fresh if left out.
        trust: whether code that is stored in ``.zip`` files may be executed.
        progress: called with ``"track: policy"`` and the number of jobs to run when a job is done.

    Raises:
        FileNotFoundError: when there are no results, or the file of a job is missing.
        ValueError: when a file is damaged, of another kind or of another version, the suite is not the one that was
            run, the files of a policy differ, or no job was stored.
    """
    path = results / "results.json" if results.is_dir() else results
    data = read_results(path)
    suite = _suite(data) if suite is None else suite
    if suite.content_hash != data["suite"]["content_hash"]:
        raise ValueError(
            f"{path} is of a {suite.name} with the content hash {data['suite']['content_hash']}; this library's is "
            f"{suite.content_hash}"
        )
    sources = [source for policy in _policies(data) for source in policy["training_seeds"]]
    if not trust and any(source["target"] == ARCHIVE for source in sources):
        raise ValueError(f"{path} has policies from .zip files, which execute code: say that you trust them (--trust)")
    for source in sources:
        if "arguments" in source:  # its module may register a metric, which the jobs of all policies have
            FactorySpec.of(source["target"]).resolve()
    stored = [job for job in data["jobs"] if job["key"] is not None]
    if not stored:
        raise ValueError(f"{path} has no job that can be run again: its policies were objects of another process")
    chosen = np.random.default_rng(seed).permutation(len(stored))[: require_count("sample", sample, 1)]
    repetitions = []
    for index in sorted(chosen.tolist()):
        listed = stored[index]
        policy = _policy(data, listed)
        track = suite.track(listed["track"])
        episodes = suite.episode_set(track.name, data["episodes"][track.name], seed=data["seed"], split=data["split"])
        job = Job(track, policy, listed["training_seed"], episodes)
        repetitions.append(Repetition(job, Store(path.parent).load(listed["key"]).difference(job.compute())))
        if progress is not None:
            progress(f"{track.name}: {policy.name}", len(chosen))
    return repetitions


def _suite(data: Mapping[str, Any]) -> Suite:
    """The suite of results: by its address, or the comparison of the scenarios of the catalogue that they name."""
    stored = data["suite"]
    if stored["target"] is not None:
        return get_suite(stored["target"])
    if not stored["rules"]["is_comparison"]:
        raise ValueError(f"the suite {stored['suite']!r} was an object: pass it to check()")
    names = list(dict.fromkeys(track["name"].removesuffix(PAPER_START) for track in stored["tracks"]))
    if unknown := [name for name in names if name not in CATALOGUE]:
        raise ValueError(f"the scenarios {', '.join(unknown)} are not in the catalogue: pass the suite to check()")
    hold_steps = stored["tracks"][0]["scenario"]["hold_steps"]
    return comparison(names, episodes=stored["rules"]["episodes"], hold_steps=hold_steps)


def _policies(data: Mapping[str, Any], track: str | None = None) -> list[dict[str, Any]]:
    """The policies of results, with the tuned laws of a track, or of all tracks."""
    chosen = data["tuned_laws"].values() if track is None else [data["tuned_laws"].get(track, {})]
    return [*data["policies"], *(law for laws in chosen for law in laws.values())]


def _policy(data: Mapping[str, Any], job: Mapping[str, Any]) -> PolicySpec:
    """The policy of a job, if its files are those that were run."""
    found = next(policy for policy in _policies(data, job["track"]) if policy["name"] == job["policy"])
    policy = PolicySpec.from_dict(found)
    if policy.to_dict() != found:
        raise ValueError(f"the files of policy {policy.name!r} are not those that were run")
    return policy
