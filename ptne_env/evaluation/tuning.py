"""Tuned laws: the strongest laws of the field on validation episodes, with which learned policies are compared."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from scipy import optimize
from scipy.stats import qmc

from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.jobs import Job, JobResult
from ptne_env.evaluation.metrics import METRICS
from ptne_env.evaluation.policy_specs import PolicySpec
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.rollout import Member, Rollout
from ptne_env.evaluation.series import SERIES, Moment
from ptne_env.evaluation.store import TaskStore
from ptne_env.evaluation.suite import Track
from ptne_env.perception.encoder import Encoder, make_encoder
from ptne_env.perception.observation import Interface, LayoutError
from ptne_env.perception.policy import Policy, PolicyError
from ptne_env.shared.arrays import BoolArray, FloatArray
from ptne_env.shared.parts import FactorySpec, resolve
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics

VALIDATION_EPISODES = 200
"""Number of validation episodes by which the best member is chosen, of seed 0 whatever the seed of the comparison."""

CANDIDATE = "candidate law"
"""Name of every tuned member while it is tried."""

GROUPS = {"paper": "best of the paper's laws", "all": "best of all laws"}
"""Groups of laws, and the name under which the best of each stands in tables, which no other policy may have."""

PUBLISHED = Path(__file__).with_name("tuned_laws.json")
"""The tuned laws of the catalogue and their trials, written by ``baselines/tune_field.py --suite catalogue``."""

_DIGITS = 4
"""Significant digits of tuned parameters."""

_EDGE = 0.02
"""Share of a range within which a parameter counts as being at its edge."""


@dataclass(frozen=True)
class Tunable:
    """A member of the field: a law, and the ranges of its parameters.

    Attributes:
        law: its target.
        ranges: lowest and highest value by parameter; logarithmic, but linear where the lowest value is 0. A member
            without ranges is not tuned.
        is_of_paper: whether it is a law of the paper.
    """

    law: str
    ranges: tuple[tuple[str, tuple[float, float]], ...]
    is_of_paper: bool

    @classmethod
    def of(cls, law: str, *, is_of_paper: bool = False, **ranges: tuple[float, float]) -> Tunable:
        """The member whose law is a class of ``ptne_env.laws``, or another target ``"module:object"``."""
        return cls(law if ":" in law else f"ptne_env.laws:{law}", tuple(ranges.items()), is_of_paper)

    def at(self, place: FloatArray) -> FactorySpec:
        """The law at a place of the unit cube, a number per parameter from 0 (lowest) to 1 (highest)."""
        return FactorySpec.of(
            self.law,
            **{
                name: float(f"{_between(*limits, share):.{_DIGITS}g}")
                for (name, limits), share in zip(self.ranges, place.tolist(), strict=True)
            },
        )

    def edges(self, arguments: Mapping[str, float]) -> list[str]:
        """The parameters whose values lie within 2 % of an edge of their range."""
        return [name for name, limits in self.ranges if not _EDGE < _share(*limits, arguments[name]) < 1 - _EDGE]


def _between(low: float, high: float, share: float) -> float:
    return high * share if low == 0 else low * (high / low) ** share


def _share(low: float, high: float, value: float) -> float:
    return value / high if low == 0 else float(np.log(value / low) / np.log(high / low))


FIELD: tuple[Tunable, ...] = (
    Tunable.of("Static", is_of_paper=True, kappa=(0.05, 50.0)),
    Tunable.of("Adaptive", is_of_paper=True, initial_gain=(0.05, 50.0), gamma=(1e-6, 1.0)),
    Tunable.of("CorollaryOne", is_of_paper=True, kappa=(0.05, 500.0)),
    Tunable.of("Static", kappa=(0.05, 50.0), gradient_gain=(0.05, 50.0)),
    Tunable.of("Grounded", kappa=(0.05, 50.0)),
    Tunable.of("AdaptiveGrounded", initial_gain=(0.05, 50.0), gamma=(1e-6, 1.0)),
    Tunable.of("ProjectedGradient", step=(0.003, 3.0), mixing=(0.01, 3.0)),
    Tunable.of("ProximalBestResponse", step=(0.05, 500.0), mixing=(0.01, 3.0)),
    Tunable.of("Routed", step=(0.003, 3.0)),
    Tunable.of("RoutedUnknown", step=(0.003, 3.0)),
    Tunable.of("Freshest", step=(0.003, 3.0)),
    Tunable.of("MultiRate", step=(0.003, 3.0), price_step=(0.003, 3.0), lead=(0.05, 50.0)),
    Tunable.of("Relay", patience=(2.0, 200.0), forgetting=(0.5, 50.0)),
    Tunable.of("LinkRelay", patience=(2.0, 200.0), forgetting=(0.5, 50.0)),
    Tunable.of("ContactRelay", patience=(2.0, 200.0), forgetting=(0.5, 50.0)),
    Tunable.of("ObserverRelay"),
)
"""The honest laws that are tuned. A new member is a new line."""


@dataclass(frozen=True)
class Budget:
    """The effort of one search, the same for every member.

    Attributes:
        population: candidates per generation, at least 5.
        generations: after the first population.
        episodes: of every candidate, the same for all.
        final_episodes: of every candidate of the last population; other episodes, the same for all.
    """

    population: int = 8
    generations: int = 6
    episodes: int = 12
    final_episodes: int = 24


BUDGET = Budget()
"""The budget of every member of the field on every track."""


@dataclass(frozen=True)
class Tuned:
    """The result of a search.

    Attributes:
        law: the best one; ``None`` where the member cannot act on the track.
    """

    law: FactorySpec | None

    def to_dict(self) -> dict[str, Any]:
        """A JSON object."""
        return {"law": None if self.law is None else self.law.to_dict()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], task: Any) -> Tuned:
        """The inverse of :meth:`to_dict`.

        Raises:
            ValueError: when no search of the member gives ``data``.
        """
        if set(data) != {"law"}:
            raise ValueError("expected the tuned law alone")
        if data["law"] is None:
            return cls(None)
        law = FactorySpec.from_dict(data["law"])
        ranges, arguments = dict(task["member"]["ranges"]), dict(law.arguments)
        if law.target != task["member"]["law"] or arguments.keys() != ranges.keys():
            raise ValueError("the law is of another member")
        for name, (low, high) in ranges.items():
            if type(arguments[name]) is not float or not low <= arguments[name] <= high:
                raise ValueError(f"the parameter {name} is not in its range")
        return cls(law)


@dataclass(frozen=True)
class Tuning:
    """The search for the best parameters of one member on one track.

    Attributes:
        track: with the scenario.
        member: of the field.
        episodes: validation episodes, of which the first ones are used.
        budget: of the search.
    """

    track: Track
    member: Tunable
    episodes: EpisodeSet
    budget: Budget = field(default_factory=lambda: BUDGET)

    def to_dict(self) -> dict[str, Any]:
        """Everything that the result depends on, as a JSON object."""
        return {
            "track": {**self.track.to_dict(), "files": self.track.files()},
            "member": asdict(self.member),
            "episodes": asdict(self.episodes),
            "budget": asdict(self.budget),
            "versions": versions(),
        }

    @cached_property
    def key(self) -> str:
        """The hash of :meth:`to_dict`, by which the result is stored."""
        return content_hash(self.to_dict())

    @cached_property
    def name(self) -> str:
        """The hash of everything but files and versions, by which a published law is found."""
        return content_hash([*self._parts, asdict(self.member), asdict(self.budget), asdict(self.episodes)])

    @cached_property
    def _parts(self) -> tuple[Any, ...]:
        """The content of the track on which a law depends: not the action space, nor steps after digits are counted."""
        track, hold_steps = self.track, 0 if self.track.metric == "digits" else self.track.scenario.hold_steps
        scenario = track.scenario.to_dict() | {"hold_steps": hold_steps}
        scenario.pop("action_limit", None)
        return scenario, track.teammates and track.teammates.to_dict(), track.metric

    @property
    def _middle(self) -> FactorySpec:
        return self.member.at(np.full(len(self.member.ranges), 0.5))

    @property
    def is_published(self) -> bool:
        """Whether the law and its mean over the validation episodes ship with the library."""
        laws = published()["laws"]
        if self.name not in laws:
            return False
        law = self.find().law
        return law is None or self.reached(law) is not None

    @property
    def cost(self) -> int:
        """Its work in the unit of :attr:`~ptne_env.evaluation.jobs.Job.cost`; 0 where it is published."""
        if self.name in published()["laws"]:
            return 0
        budget = self.budget
        episodes = budget.episodes * (budget.generations + 1) + budget.final_episodes
        return self.trial(self._middle).cost * budget.population * episodes // self.episodes.count

    def trial(self, law: FactorySpec) -> Job:
        """The job that plays a tuned law on the validation episodes."""
        return Job(self.track, PolicySpec(CANDIDATE, law), 0, self.episodes)

    def trial_name(self, law: FactorySpec) -> str:
        """The hash of everything but files and versions on which the mean of a trial depends."""
        return content_hash([*self._parts, law.to_dict(), asdict(self.episodes)])

    def reached(self, law: FactorySpec) -> float | None:
        """The published mean of the track's metric over the validation episodes; ``None`` where the trial has to run.

        Args:
            law: the tuned one.
        """
        mean: float | None = published()["trials"].get(self.trial_name(law))
        return mean

    def find(self) -> Tuned:
        """The published result of the search, else a new one."""
        laws = published()["laws"]
        if self.name not in laws:
            return self.compute()
        return Tuned.from_dict({"law": laws[self.name]}, self.to_dict())

    def compute(self) -> Tuned:
        """Search by differential evolution, deterministic: maximise the mean of the track's metric.

        The best of the last population on other episodes wins, so a law at the edge of stability that diverges in a
        few episodes does not. Candidates of a generation run side by side in one batch, on the same episodes.
        """
        budget, member = self.budget, self.member
        try:
            self._middle.build(layout=self._encoder().layout)
        except LayoutError:
            return Tuned(None)
        if not member.ranges:
            return Tuned(member.at(np.empty(0)))
        seen, unseen = range(budget.episodes), range(budget.episodes, budget.episodes + budget.final_episodes)
        start = qmc.LatinHypercube(len(member.ranges), rng=0).random(budget.population)
        found = optimize.differential_evolution(
            lambda places: -self.digits([member.at(place) for place in places.T], seen),
            [(0.0, 1.0)] * len(member.ranges),
            init=start,
            maxiter=budget.generations,
            tol=0,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=0,
        )
        laws = list(dict.fromkeys(member.at(place) for place in found.population))
        return Tuned(laws[int(self.digits(laws, unseen).argmax())])

    def digits(self, laws: Sequence[FactorySpec], episodes: range) -> FloatArray:
        """The mean of the track's metric over the same episodes, by their numbers; −∞ where a law fails. Shape (L,).

        The laws are those of the member, with other parameters; they run in one batch.
        """
        world, encoder = self.track.world, self._encoder()
        teammates = [] if self.track.teammates is None else [self.track.teammates.join(world)]
        taken = {player for mate in teammates for player in mate.players.tolist()}
        others = [player for player in range(world.game.num_players) if player not in taken]
        portfolio = Portfolio([law.build(layout=encoder.layout) for law in laws])
        members = [Member(portfolio, encoder, others), *teammates]
        seeds = [self.episodes.episode_seed(episode) for _ in laws for episode in episodes]
        state = dynamics.draw_initial_state(world, [RandomStreams.from_seed(seed) for seed in seeds])
        clock, metric = world.clock, METRICS[self.track.metric]
        if metric.value is None:
            raise ValueError(f"{metric.name} follows from other metrics; expected a metric of a rollout")
        first, last = (clock.steps, clock.steps) if metric.name == "digits" else (0, clock.total_steps)
        recorded = np.empty((clock.total_steps + 1, len(seeds)))
        try:
            for step in range(last + 1):
                if step >= first:
                    recorded[step] = SERIES["estimate_distance"].value(Moment(world, state, None, step))
                if step < last:
                    inputs = np.add.reduce([member.decide(state) for member in members])
                    state = dynamics.step(world, state, inputs)
        except PolicyError:
            if len(laws) == 1:
                return np.array([-np.inf])
            return np.concatenate([self.digits([law], episodes) for law in laws])
        found = metric.value(Rollout(world, {"estimate_distance": recorded}, state.diverged, 0.0))
        return np.mean(found.reshape(len(laws), -1), axis=1)

    def _encoder(self) -> Encoder:
        law = resolve(self.member.law)
        return make_encoder(self.track.world, getattr(law, "interface", Interface()))


@cache
def published() -> dict[str, dict[str, Any]]:
    """The content of :data:`PUBLISHED`.

    Under ``"laws"``, the tuned laws by :attr:`Tuning.name` as JSON objects, ``None`` where n/a; under ``"trials"``, the
    mean of the track's metric over the validation episodes by :meth:`Tuning.trial_name`.
    """
    found: dict[str, dict[str, Any]] = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    return found


def mean_of(trial: Job, result: JobResult) -> float:
    """The mean of the track's metric over the episodes of a trial; −∞ where the law failed."""
    return -np.inf if result.failure is not None else float(result.samples[trial.track.metric].mean())


class Portfolio:
    """Several policies of one layout: each decides for an equal share of the rows, in order."""

    def __init__(self, policies: list[Policy]) -> None:
        self._policies = policies

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions, and the memories of all policies; see :meth:`ptne_env.perception.policy.Policy.predict`."""
        count = len(self._policies)
        starts = [None] * count if episode_start is None else np.split(episode_start, count)
        answers = [
            policy.predict(rows, memory, start, deterministic)
            for policy, rows, memory, start in zip(
                self._policies, np.split(observation, count), state or [None] * count, starts, strict=True
            )
        ]
        return np.concatenate([actions for actions, _ in answers]), [memory for _, memory in answers]


class Tunings(TaskStore[Tuned]):
    """Results of searches."""

    kind: ClassVar[str] = "tuning"
    result = Tuned


def best(digits: Mapping[Tunable, tuple[FactorySpec, float]]) -> dict[str, PolicySpec]:
    """For each group, the member with the most digits; the first of equals wins.

    Args:
        digits: the tuned law of every member that can act on the track, and its mean digits on validation episodes.
    """

    def winner(members: Iterable[Tunable]) -> FactorySpec:
        return digits[max(members, key=lambda member: digits[member][1])][0]

    chosen: dict[str, Callable[[Tunable], bool]] = {"paper": lambda member: member.is_of_paper, "all": lambda _: True}
    return {group: PolicySpec(name, winner(filter(chosen[group], digits))) for group, name in GROUPS.items()}
