"""Comparisons: from policies and scenarios to jobs, and from the results of jobs to results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ptne_env.evaluation.entries import PolicySpec, get_policy_spec
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.jobs import Job, JobResult, Run, run_serially
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.tracks import Track, compared_tracks
from ptne_env.perception.policy import Policy
from ptne_env.shared.arrays import require_count
from ptne_env.world.scenario import Scenario

EPISODES = 100
"""Episodes of a scenario in a comparison, unless another number is asked for."""


def evaluate(
    policies: str | PolicySpec | Policy | Iterable[str | PolicySpec | Policy],
    scenarios: str | Scenario | Track | Iterable[str | Scenario | Track],
    *,
    episodes: int = EPISODES,
    seed: int = 0,
    split: Split = "test",
    run: Run = run_serially,
) -> Results:
    """Run every policy on every scenario from the same seeded starts.

    A policy that fails on a track (it raises, answers in another form or does not pass the audit of its decisions)
    costs that track: :attr:`~ptne_env.evaluation.results.Results.failures` holds the reason.

    Args:
        policies: names, specs, or objects with ``predict``, as :func:`~ptne_env.evaluation.entries.get_policy_spec`
            takes them; one or several, or a dictionary of policies by name.
        scenarios: scenarios, names of the catalogue, ``"module:object"`` or tracks; one of them, or several.
        episodes: number of random starts; a track in which nothing is random has one episode.
        seed: of the episode sets.
        split: ``"test"``, ``"validation"`` or ``"train"``, which share no episode.
        run: gives the results of jobs: one after the other in this process, or as :class:`ptne_env.execution.Runner`
            does, which stores them in a folder, runs many at a time and shows progress.

    Raises:
        ValueError: for unknown or repeated names, or when no policy fits any track.
        TypeError: for an argument of a wrong kind.
        OSError, ImportError, ConnectionError, ChildProcessError: of ``run``.
    """
    require_count("episodes", episodes, 1)
    if not callable(run):
        raise TypeError(f"run takes jobs, as ptne_env.execution.Runner(folder, Workers(4)) does; got {run!r}")
    tracks = compared_tracks(as_list(scenarios))
    sets = {track.name: EpisodeSet(track.episodes or episodes, seed, split) for track in tracks}
    return compare("comparison", tracks, [get_policy_spec(policy) for policy in as_list(policies)], sets, run)


def as_list(given: Any) -> list[Any]:
    """Return one thing, or several, as a list.

    Raises:
        TypeError: for an object that is none of the things to compare, such as an environment.
    """
    if isinstance(given, str | PolicySpec | Scenario | Track) or hasattr(given, "predict"):
        return [given]
    if isinstance(given, Mapping):
        known = PolicySpec | Scenario | Track
        return [each if isinstance(each, known) else PolicySpec(name, each) for name, each in given.items()]
    if isinstance(given, type) or not isinstance(given, Iterable):
        kind = f"the class {given.__name__}" if isinstance(given, type) else f"a {type(given).__name__}"
        raise TypeError(
            f"expected names, policies or scenarios, got {kind}; the scenario of an environment is env.scenario, that "
            "of a function what it returns, and a policy is an object with predict, or PolicySpec(name, function of "
            "the layout)"
        )
    return list(given)


def compare(
    name: str,
    tracks: Sequence[Track],
    policies: Sequence[PolicySpec],
    episodes: Mapping[str, EpisodeSet],
    run: Run = run_serially,
    target: str | None = None,
) -> Results:
    """The results of policies on tracks.

    Args:
        name: of the comparison or suite.
        tracks: in the order of tables.
        policies: in the order of tables.
        episodes: the episode set of each track.
        run: as for :func:`evaluate`.
        target: of the suite, by which it is found again.

    Raises:
        ValueError: for repeated names or no policy, or when a policy fits no track.
    """
    specs = {spec.name: spec for spec in policies}
    if not specs:
        raise ValueError("a comparison needs at least one policy")
    if len(specs) < len(policies):
        names = ", ".join(spec.name for spec in policies)
        raise ValueError(
            f"a comparison needs different names, got {names}; a file gets another name by 'name=path', and an object "
            "by PolicySpec(name, object)"
        )
    jobs = [
        Job(track, spec, training_seed, episodes[track.name])
        for track in tracks
        for spec in specs.values()
        for training_seed in range(len(spec.training_seeds))
    ]
    found: dict[tuple[str, str], list[JobResult]] = {}
    for job, result in zip(jobs, run(jobs), strict=True):
        found.setdefault((job.track.name, job.policy.name), []).append(result)
    failures = {place: each.failure for place, results in found.items() for each in results if each.failure}
    refusals = {
        place: each.not_applicable for place, results in found.items() for each in results if each.not_applicable
    }
    samples = {
        place: {metric: np.stack([each.samples[metric] for each in results]) for metric in results[0].samples}
        for place, results in found.items()
        if place not in failures and place not in refusals
    }
    if not samples and refusals and not failures:
        (_, policy), reason = next(iter(refusals.items()))
        raise ValueError(f"policy {policy!r} fits no track: {reason}")
    return Results(name, target, tuple(tracks), specs, dict(episodes), samples, refusals, failures)
