"""Jobs: one policy with one training seed on one track and episode set, and its result."""

from __future__ import annotations

import platform
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from math import isfinite
from typing import Any

import numpy as np

from ptne_env.evaluation.audit import USES_OTHER_LINKS, Witness, layout_of_one, rows_of_one, sample_rows
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.metrics import METRICS, Metric, adopt, measure, own_metrics
from ptne_env.evaluation.policy_specs import PolicySpec
from ptne_env.evaluation.provenance import content_hash, source_hashes, unhashed, versions
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.suite import Track
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import LayoutError, ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.counter_random import Draws
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

_STEP_COST = 5_000
"""Numbers of estimates that take about as long as what a step needs whatever their number."""


@dataclass(frozen=True)
class Job:
    """One policy with one training seed on one track: everything that its numbers depend on.

    Attributes:
        track: with the scenario.
        policy: with all training seeds.
        training_seed: index of the one that is run.
        episodes: the episode set.
    """

    track: Track
    policy: PolicySpec
    training_seed: int
    episodes: EpisodeSet

    def to_dict(self) -> dict[str, Any]:
        """Everything the numbers depend on, as a JSON object. Names of policies do not count."""
        policy = self.policy.to_dict()
        return {
            "track": {**self.track.to_dict(), "files": self.track.files()},
            "policy": {"interface": policy["interface"], **policy["training_seeds"][self.training_seed]},
            "episodes": asdict(self.episodes),
            "metrics": sorted(name for name, metric in METRICS.items() if metric.value is not None),
            "metric_files": source_hashes(metric.value for metric in own_metrics()),
            "versions": versions(),
        }

    @cached_property
    def key(self) -> str | None:
        """The hash of :meth:`to_dict`, by which the result is stored; ``None`` where the policy is an object."""
        return content_hash(self.to_dict()) if self.policy.is_repeatable else None

    @property
    def cost(self) -> int:
        """A rough measure of its work: the numbers in all estimates of all steps and episodes, and as much per step."""
        world = self.track.world
        numbers = world.game.dimension * world.game.num_players * self.episodes.count
        return world.clock.total_steps * (numbers + _STEP_COST)

    def compute(self, *, thorough: bool = False) -> JobResult:
        """Run the episodes, and audit the decisions of policies that do not ship with the library.

        Args:
            thorough: whether a witness per player audits, and not one for all, also where the policy ships.
        """
        world = self.track.world
        teammates = None if self.track.teammates is None else self.track.teammates.join(world)
        taken = () if teammates is None else teammates.players
        deciding = [player for player in range(world.game.num_players) if player not in taken]
        try:
            encoder = make_encoder(world, self.policy.interface)
            with ExitStack() as processes:

                def fresh(layout: ObservationLayout) -> Policy:
                    return processes.enter_context(self.policy.deciding(layout, self.training_seed))

                policy = fresh(encoder.layout)
                witnesses = []
                if thorough or not self.policy.ships:
                    rows = sample_rows(self.episodes.count, len(deciding), thorough=thorough)
                    witnesses = [Witness(fresh(encoder.layout), chosen) for chosen in rows]
                    place, chosen = rows_of_one(self.episodes.count, len(deciding))
                    alone = _of_own_links(fresh, layout_of_one(encoder.layout, deciding[place]))
                    witnesses.append(Witness(alone, chosen, USES_OTHER_LINKS))
                start = _initial_state(world, self.episodes)
                with _draws(world, self.episodes).kept():
                    samples = measure(rollout(policy, encoder, start, teammates, witnesses=witnesses))
        except LayoutError as error:
            return JobResult({}, {}, str(error))
        except PolicyError as error:
            return JobResult({}, {}, None, str(error))
        timings = {name: float(samples.pop(name)[0]) for name in METRICS if METRICS[name].is_timing}
        return JobResult(samples, timings, None)


def _of_own_links(make: Callable[[ObservationLayout], Policy], layout: ObservationLayout) -> Policy:
    """A policy for the layout that one player knows, after one was made for the whole layout."""
    try:
        return make(layout)
    except LayoutError as error:
        raise PolicyError(f"{USES_OTHER_LINKS}. It cannot be built from them: {error}") from None


@lru_cache(maxsize=2)  # jobs with the same episodes follow each other
def _initial_state(world: World, episodes: EpisodeSet) -> State:
    return episodes.initial_state(world)


@lru_cache(maxsize=1)
def _draws(world: World, episodes: EpisodeSet) -> Draws:  # noqa: ARG001 - whose numbers are kept
    return Draws()


@dataclass(frozen=True)
class JobResult:
    """The result of a job.

    Attributes:
        samples: per metric, one value per episode, NaN where there is none; shape (B,).
        timings: per metric that is a timing, its value.
        not_applicable: why the policy cannot act on this track; ``None`` where it can.
        failure: the error of the policy, with the step; ``None`` where it acted. A failed job is never stored.
    """

    samples: dict[str, FloatArray]
    timings: dict[str, float]
    not_applicable: str | None
    failure: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """A JSON object; numbers keep every bit, NaN is ``null``."""
        lists = {
            name: [value if np.isfinite(value) else None for value in values.tolist()]
            for name, values in self.samples.items()
        }
        return {"samples": lists, "not_applicable": self.not_applicable, "timings": self.timings}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], job: Any, published: Collection[str] | None = None) -> JobResult:
        """The inverse of :meth:`to_dict`, for a job that did not fail.

        Args:
            data: the JSON object.
            job: :meth:`Job.to_dict` of the job.
            published: the metrics of which there are samples; all of the job if left out.

        Raises:
            ValueError: when no run of the job gives ``data``: on other keys, metrics, types or numbers of values.
        """
        try:
            metrics, count = set(job["metrics"]), job["episodes"]["count"]
        except (KeyError, TypeError) as error:
            raise ValueError("the job names no metrics or no number of episodes") from error
        keys = ("samples", "timings", "not_applicable")
        samples, timings, not_applicable = (data.get(key, {}) for key in keys)
        if not_applicable is not None:
            metrics = set()
        timed = {name for name in metrics if name in METRICS and METRICS[name].is_timing}
        measured = metrics - timed if published is None else (metrics - timed).intersection(published)
        is_whole = (
            data.keys() == set(keys)
            and isinstance(not_applicable, str | None)
            and isinstance(samples, dict)
            and isinstance(timings, dict)
            and samples.keys() == measured
            and timings.keys() == timed
            and all(isinstance(values, list) and len(values) == count for values in samples.values())
            and all(value is None or _is_number(value) for values in samples.values() for value in values)
            and all(map(_is_number, timings.values()))
        )
        if not is_whole:
            raise ValueError(f"expected {count} numbers of each metric of the job, or the reason why there are none")
        arrays = {name: np.array(values, dtype=np.float64) for name, values in samples.items()}
        return cls(arrays, timings, not_applicable)

    def by_metric(self) -> dict[str, FloatArray]:
        """The samples of every metric, or its timing for every episode, in the order of tables; shape (B,)."""
        timings = {name: np.full(self.samples["digits"].shape, value) for name, value in self.timings.items()}
        found = self.samples | timings
        return {name: found[name] for name in METRICS if name in found}

    def of_metrics(self, names: Collection[str]) -> JobResult:
        """The same with the samples of some metrics alone, and all timings."""
        return replace(self, samples={name: values for name, values in self.samples.items() if name in names})

    def difference(self, other: JobResult) -> float:
        """The largest |other − this|/(1 + |this|) of any episode and metric of this result, timings apart.

        It is infinite where one has a value and the other has none.
        """
        if not self.samples.keys() <= other.samples.keys() or self.not_applicable != other.not_applicable:
            return float("inf")
        if (self.failure is None) != (other.failure is None):
            return float("inf")
        largest = 0.0
        for name, values in self.samples.items():
            if not np.array_equal(np.isfinite(values), np.isfinite(other.samples[name])):
                return float("inf")
            difference = np.abs(other.samples[name] - values) / (1 + np.abs(values))
            largest = max(largest, float(np.nanmax(difference, initial=0.0)))
        return largest


def _is_number(value: Any) -> bool:
    return type(value) is float and isfinite(value)  # an integer or a boolean was not written by to_dict


def run_job(job: Job, key: str | None, metrics: Iterable[Metric] = ()) -> JobResult:
    """Run a job on a worker, after making sure that the worker has the same library and files.

    Args:
        job: to be run.
        key: of the job, as the machine that asks computed it.
        metrics: :func:`~ptne_env.evaluation.metrics.own_metrics` of the machine that asks.

    Raises:
        ValueError: when the worker's library, dependencies or files differ.
    """
    adopt(metrics)
    if key is not None and content_hash(job.to_dict()) != key:
        raise ValueError(
            f"a worker on {platform.node()} has another version of the library, its dependencies or the files of "
            f"policy {job.policy.name!r} than the machine that asks: install the same on both"
        )
    try:
        return job.compute()
    except Exception as error:
        error.add_note(f"in track {job.track.name!r}, policy {job.policy.name!r}")
        raise


def require_hashed(jobs: Iterable[Job]) -> None:
    """Check that a change of the sources of jobs would be seen, so that no stored result is stale.

    Raises:
        ValueError: naming the policy and the track, and what cannot be hashed.
    """
    for job in jobs:
        if job.key is None:
            continue
        content = job.to_dict()
        files = content["policy"]["files"] | content["track"]["files"] | content["metric_files"]
        if missing := unhashed(files):
            reasons = "; ".join(f"{name} cannot be hashed: {reason}" for name, reason in missing.items())
            raise ValueError(
                f"a change of policy {job.policy.name!r} or of track {job.track.name!r} would not be seen, so its "
                f"stored results may be stale ({reasons}); --rerun (rerun=True) computes it again each time"
            )
