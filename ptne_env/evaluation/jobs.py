"""Jobs: one policy with one training seed on one track and episode set, and its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import numpy as np

from ptne_env.evaluation.audit import USES_OTHER_LINKS, Witness, rows_of_one, sample_rows, with_links_of
from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.metrics import METRICS, measure
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.tracks import Track
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import PolicyError
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.counter_random import Draws
from ptne_env.shared.parts import foreign_targets
from ptne_env.world.dynamics import PHYSICS, State
from ptne_env.world.world import World

DECIMALS = 7
"""Significant decimals of the values of metrics. All tables follow from these numbers, which a file holds exactly."""

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
        policy, track = self.policy.to_dict(), self.track.to_dict()
        return {
            "physics": PHYSICS,
            "versions": versions(self.policy.libraries),
            "track": {key: track[key] for key in ("scenario", "metric", "teammates")},
            "policy": {"interface": policy["interface"], **policy["training_seeds"][self.training_seed]},
            "episodes": asdict(self.episodes),
            "metrics": sorted(name for name, metric in METRICS.items() if metric.value is not None),
        }

    @cached_property
    def key(self) -> str | None:
        """The hash of :meth:`to_dict`, by which the result is stored.

        ``None`` where code of the user takes part: an object, a ``"module:object"`` or a metric, whose change no key
        shows. Such a job runs every time.
        """
        content = self.to_dict()
        own = not self.policy.is_repeatable or foreign_targets(content) or any(map(_is_own, METRICS))
        return None if own else content_hash(content)

    @property
    def cost(self) -> int:
        """A rough measure of its work: the numbers in all estimates of all steps and episodes, and as much per step."""
        world = self.track.world
        numbers = world.game.dimension * world.game.num_players * self.episodes.count
        return world.clock.total_steps * (numbers + _STEP_COST)

    def compute(self, *, thorough: bool = False) -> JobResult:
        """Run the episodes, and audit the decisions of policies of the user.

        Args:
            thorough: whether a witness per player audits, and not one for all, also where the policy ships.
        """
        world = self.track.world
        teammates = None if self.track.teammates is None else self.track.teammates.join(world)
        taken = () if teammates is None else teammates.players
        deciding = [player for player in range(world.game.num_players) if player not in taken]
        try:
            encoder = make_encoder(world, self.policy.interface)
            policy = self.policy.build(encoder.layout, self.training_seed)
            witnesses = []
            if thorough or self.policy.is_own:
                witnesses = self._witnesses(encoder.layout, deciding, thorough=thorough)
            with _draws(world, self.episodes).kept():
                start = _initial_state(world, self.episodes)
                samples = measure(rollout(policy, encoder, start, teammates, witnesses=witnesses))
        except LayoutError as error:
            return JobResult(not_applicable=str(error))
        except PolicyError as error:
            return JobResult(failure=str(error))
        return JobResult({name: _rounded(values) for name, values in samples.items()})

    def _witnesses(self, layout: Any, deciding: Sequence[int], *, thorough: bool) -> list[Witness]:
        """Fresh policies that audit the decisions, the last one with the links of one player alone."""
        rows = sample_rows(self.episodes.count, len(deciding), thorough=thorough)
        found = [Witness(self.policy.build(layout, self.training_seed), chosen) for chosen in rows]
        place, chosen = rows_of_one(self.episodes.count, len(deciding))
        try:
            alone = self.policy.build(with_links_of(layout, deciding[place]), self.training_seed)
        except LayoutError as error:
            raise PolicyError(f"{USES_OTHER_LINKS}. It cannot be built from them: {error}") from None
        return [*found, Witness(alone, chosen, USES_OTHER_LINKS)]


def _is_own(metric: str) -> bool:
    return METRICS[metric].is_own


def _rounded(values: FloatArray) -> FloatArray:
    return np.array([float(f"{value:.{DECIMALS}g}") for value in values.tolist()])


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
        samples: per metric, one value per episode, NaN where there is none; shape (B,). A timing repeats its value.
        not_applicable: why the policy cannot act on this track; ``None`` where it can.
        failure: the error of the policy, with the step; ``None`` where it acted. A failed job is never stored.
    """

    samples: dict[str, FloatArray] = field(default_factory=dict)
    not_applicable: str | None = None
    failure: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """A JSON object; numbers keep every bit, NaN is ``null``."""
        lists = {name: to_json_list(values) for name, values in self.samples.items()}
        return {"samples": lists, "not_applicable": self.not_applicable}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], job: Job) -> JobResult:
        """The inverse of :meth:`to_dict`.

        Raises:
            ValueError: when no run of the job gives ``data``: on other metrics, or other numbers of values.
        """
        try:
            reason = data["not_applicable"]
            samples = {name: np.array(values, dtype=np.float64) for name, values in data["samples"].items()}
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"not a result: {error!r}") from None
        names = {name for name, metric in METRICS.items() if metric.value is not None} if reason is None else set()
        if samples.keys() != names or any(values.shape != (job.episodes.count,) for values in samples.values()):
            raise ValueError(f"expected {job.episodes.count} numbers of each metric, or the reason why there are none")
        return cls({name: samples[name] for name in METRICS if name in samples}, reason)


def to_json_list(values: FloatArray) -> list[Any]:
    """Numbers as a list of any depth, in which NaN is ``None``."""
    return np.where(np.isfinite(values), values, None).tolist()


Run: TypeAlias = Callable[[Sequence[Job]], list[JobResult]]
"""Gives the results of jobs, in their order."""


def run_serially(jobs: Sequence[Job]) -> list[JobResult]:
    """Run jobs one after the other in this process."""
    return [job.compute() for job in jobs]
