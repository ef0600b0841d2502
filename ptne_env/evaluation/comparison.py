"""Comparisons: jobs, of one policy on one track, and how their results become those of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ptne_env.evaluation.audit import (
    DOES_NOT_REPEAT,
    NOT_ROW_WISE,
    USES_OTHER_LINKS,
    AuditError,
    Witness,
    rows_of_one,
    sample_rows,
    with_links_of,
)
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.metrics import METRICS, OPTIONAL, measure
from ptne_env.evaluation.policy_spec import POLICIES, PolicySpec, get_policy_spec
from ptne_env.evaluation.results import COMPARISON, Place, Results, Samples
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.tracks import Suite, Track, compared_tracks, get_suite
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import LayoutError, ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.parts import FactorySpec, names_of
from ptne_env.world.scenario import Scenario

ZERO, LAW, ORACLE = REFERENCES = "zero-input", "static", "oracle"
"""The reference policies that every run of a suite includes: zero input with score 0, the paper's law, an oracle."""


@dataclass(frozen=True)
class JobResult:
    """The result of a job.

    Attributes:
        samples: per metric, one value per episode, NaN where there is none; shape (B,). A timing repeats its value.
        not_applicable: why the policy cannot act on this track; ``None`` where it can.
        failure: the error of the policy, with the step; ``None`` where it acted. A failed job is never stored.
    """

    samples: dict[str, FloatArray] = field(default_factory=dict)
    not_applicable: str | None = None
    failure: str | None = None


@dataclass(frozen=True)
class Job:
    """One policy with one training seed on one track: everything that its numbers depend on.

    The training seed is the index of one of those of the policy.
    """

    track: Track
    policy: PolicySpec
    training_seed: int
    episodes: EpisodeSet

    def __post_init__(self) -> None:
        object.__setattr__(self, "policy", self.policy.on_scenario(self.track.scenario.name))

    def compute(self, *, audits: bool | None = None) -> JobResult:
        """Run the episodes, and audit the decisions: those of a user's policy, if ``audits`` is left out."""
        world, team = self.track.world, self.track.teammates
        taken = () if team is None else team.players
        deciding = [player for player in range(world.game.num_players) if player not in taken]
        audits = self.policy.is_own if audits is None else audits
        try:
            encoder = Encoder(world, self.policy.interface)
            start = self.episodes.initial_state(world)
            for fills in (False, True):
                policy = self.policy.build(encoder.layout, self.training_seed)
                witnesses = self._witnesses(encoder.layout, deciding, fills=fills) if audits else ()
                try:
                    teammates = None if team is None else team.join(world)
                    counts = not OPTIONAL.keys().isdisjoint(METRICS)  # which takes a fifth of the time of a law
                    played = rollout(policy, encoder, start, teammates, witnesses=witnesses, counts_messages=counts)
                    samples = measure(played)
                    break
                except AuditError:  # perhaps of rounding, which a batch of the same size excludes
                    if fills:
                        raise
        except LayoutError as error:
            return JobResult(not_applicable=str(error))
        except PolicyError as error:
            return JobResult(failure=str(error))
        return JobResult({name: _round_values(values) for name, values in samples.items()})

    def _witnesses(self, layout: ObservationLayout, deciding: Sequence[int], *, fills: bool) -> list[Witness]:
        """Build fresh policies that audit the decisions; the last one knows the links of one player alone.

        Where they fill the batch, the first one gets the batch as it is, and shows whether the policy repeats at all.
        """
        samples = [(sample_rows(self.episodes.count, len(deciding)), NOT_ROW_WISE)]
        if fills:
            samples.insert(0, (np.arange(self.episodes.count * len(deciding)), DOES_NOT_REPEAT))
        witnesses = [
            Witness(self.policy.build(layout, self.training_seed), rows, reason, fills=fills)
            for rows, reason in samples
        ]
        place, rows = rows_of_one(self.episodes.count, len(deciding))
        try:
            alone = self.policy.build(with_links_of(layout, deciding[place]), self.training_seed)
        except LayoutError as error:
            raise PolicyError(f"{USES_OTHER_LINKS}. It cannot be built from them: {error}") from None
        return [*witnesses, Witness(alone, rows, USES_OTHER_LINKS, fills=fills)]


def _round_values(values: FloatArray) -> FloatArray:
    """Round to 7 significant decimals, which a file holds exactly; all tables follow from these numbers."""
    return np.array([float(f"{value:.7g}") for value in values.tolist()])


Policies: TypeAlias = "str | Path | PolicySpec | FactorySpec | Policy | Iterable[Any] | Mapping[str, Any]"
"""Policies as :func:`evaluate` takes them."""

Run: TypeAlias = Callable[[Sequence[Job]], list[JobResult]]
"""A function from jobs to their results, in the same order."""


def run_serially(jobs: Sequence[Job]) -> list[JobResult]:
    """Run jobs one after the other in this process."""
    return [job.compute() for job in jobs]


def evaluate(
    policies: Policies,
    scenarios: str | Suite | Scenario | Track | Iterable[str | Scenario | Track] = "ptne-v1",
    *,
    episodes: int | None = None,
    seed: int = 0,
    split: Split = "test",
    run: Run = run_serially,
    trust: bool = False,
) -> Results:
    """Run every policy on every scenario from the same seeded starts.

    A suite is played by :func:`run_suite`, with its reference policies. The name of one track of a suite, such as
    ``"ptne-v1/rounding"``, stands for its scenario, its episodes and its teammates.

    A policy that fails on a track (it raises, answers in another form or does not pass the audit of its decisions)
    has no numbers there: :attr:`~ptne_env.evaluation.results.Results.failures` holds the reason.

    Args:
        policies: one or several names, specs or objects with ``predict``, as
            :func:`~ptne_env.evaluation.policy_spec.get_policy_spec` takes them; or a dictionary of these, or of
            functions of the layout, by name.
        scenarios: one or several scenarios, tracks, or names as :func:`ptne_env.get_scenario` takes them; or one suite,
            or its name.
        episodes: the number of random starts; 100, or the suite's own number, if left out. A track with a number of its
            own keeps it, and a scenario in which nothing is random has one episode.
        seed: the seed of the episode sets.
        split: ``"test"``, ``"validation"`` or ``"train"``, which share no episode.
        run: how jobs are run. They run one after the other in this process by default;
            :class:`ptne_env.execution.Runner` stores them in a folder, runs many at a time and shows progress.
        trust: whether code that is stored in a ``.zip`` may be executed.

    Raises:
        ValueError: for unknown or repeated names, for a ``.zip`` that is not trusted, or when no policy fits any track.
        TypeError: for an argument of a wrong kind.
        OSError, ImportError, ConnectionError, ChildProcessError: when ``run`` raises them.
    """
    if not callable(run):
        raise TypeError(f"run takes jobs, as ptne_env.execution.Runner(folder, Workers(4)) does; got {run!r}")
    if isinstance(scenarios, Suite) or (isinstance(scenarios, str) and scenarios in names_of("suite")):
        return run_suite(scenarios, policies, episodes=episodes, seed=seed, split=split, run=run, trust=trust)
    tracks = compared_tracks(as_list(scenarios), episodes, seed, split)
    sets = {track.name: drawn for track, drawn in tracks.items()}
    return compare(COMPARISON, list(tracks), _policy_specs(policies, trust=trust), sets, run)


def run_suite(
    suite: str | Suite,
    policies: Policies,
    *,
    tracks: str | Iterable[str] | None = None,
    episodes: int | None = None,
    seed: int = 0,
    split: Split = "test",
    run: Run = run_serially,
    trust: bool = False,
) -> Results:
    """Run policies, and the reference policies of the suite, on the tracks of a suite.

    Args:
        suite: a suite, its name, or a ``"module:object"``.
        policies: the policies, as for :func:`evaluate`.
        tracks: the name of one track or the names of several; all tracks if left out.
        episodes: the number of episodes per track; the suite's own number if left out.
        seed: the seed of the episode sets; that of published results is 0.
        split: as for :func:`evaluate`.
        run: likewise.
        trust: likewise.

    Errors are those of :func:`evaluate`, ``ValueError`` for a policy with the name of a reference policy, and
    ``RuntimeError`` when a reference policy fails.
    """
    suite = get_suite(suite)
    names = [track.name for track in suite.tracks] if tracks is None else list(dict.fromkeys(as_list(tracks)))
    sets = {name: suite.episode_set(name, episodes, seed=seed, split=split) for name in names}
    specs = _policy_specs(policies, trust=trust)
    for name in REFERENCES:
        same = [spec for spec in specs if spec.name == name]
        if any(spec != POLICIES[name] for spec in same):
            raise ValueError(f"{name!r} is the name of a reference policy: give your policy another name")
        specs += [] if same else [POLICIES[name]]
    results = compare(suite.name, [suite.track(name) for name in names], specs, sets, run)
    for (track, policy), reason in results.failures.items():
        if policy in REFERENCES:
            raise RuntimeError(f"the reference policy {policy!r} fails on track {track!r}: {reason}")
    return results


def as_list(things: Any) -> list[Any]:
    """Return one thing, or several, as a list; ``TypeError`` for what cannot be compared, such as an environment."""
    if isinstance(things, str | Path | PolicySpec | FactorySpec | Scenario | Track) or hasattr(things, "predict"):
        return [things]
    if isinstance(things, type) or not isinstance(things, Iterable):
        kind = f"the class {things.__name__}" if isinstance(things, type) else f"a {type(things).__name__}"
        raise TypeError(
            f"expected names, policies or scenarios, got {kind}; the scenario of an environment is env.scenario, that "
            "of a function what it returns, and a policy is an object with predict, or PolicySpec(name, function of "
            "the layout)"
        )
    return list(things)


def _policy_specs(policies: Policies, *, trust: bool) -> list[PolicySpec]:
    """Return the specs of policies as :func:`evaluate` takes them."""
    if not isinstance(policies, Mapping):
        return [get_policy_spec(policy, trust=trust) for policy in as_list(policies)]
    return [
        replace(get_policy_spec(policy, trust=trust), name=name)
        if isinstance(policy, str | Path | PolicySpec)
        else PolicySpec(name, policy)
        for name, policy in policies.items()
    ]


def compare(
    name: str,
    tracks: Sequence[Track],
    policies: Sequence[PolicySpec],
    episodes: Mapping[str, EpisodeSet],
    run: Run = run_serially,
) -> Results:
    """Run every policy on every track, in the order of tables; the rest is as in :class:`Results`.

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
            "by a dictionary, {'mine': object}"
        )
    jobs = [
        Job(track, spec, training_seed, episodes[track.name])
        for track in tracks
        for spec in specs.values()
        for training_seed in range(len(spec.training_seeds))
    ]
    by_place: dict[Place, list[JobResult]] = {}
    for job, result in zip(jobs, run(jobs), strict=True):
        by_place.setdefault((job.track.name, job.policy.name), []).append(result)
    samples: dict[Place, Samples] = {}
    refusals: dict[Place, str] = {}
    failures: dict[Place, str] = {}
    for place, results in by_place.items():
        refusals |= [(place, result.not_applicable) for result in results if result.not_applicable]
        failures |= [(place, result.failure) for result in results if result.failure]
        if place not in failures and place not in refusals:
            metrics = results[0].samples
            samples[place] = {metric: np.stack([result.samples[metric] for result in results]) for metric in metrics}
    if refusals and not (samples or failures):
        (_, policy), reason = next(iter(refusals.items()))
        raise ValueError(f"policy {policy!r} fits no track: {reason}")
    return Results(name, tuple(tracks), specs, dict(episodes), samples, refusals, failures)
