"""Jobs: one policy with one training seed on one track and episode set, and its result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from ptne_env.evaluation.audit import USES_OTHER_LINKS, AuditError, Witness, rows_of_one, sample_rows, with_links_of
from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.metrics import measure
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.tracks import Track
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import LayoutError, ObservationLayout
from ptne_env.perception.policy import PolicyError
from ptne_env.shared.arrays import FloatArray
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

DECIMALS = 7
"""Significant decimals of the values of metrics. All tables follow from these numbers, which a file holds exactly."""


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

    def compute(self, *, thorough: bool = False) -> JobResult:
        """Run the episodes, and audit the decisions of policies of the user.

        Args:
            thorough: whether a witness per player audits, and not one for all, also where the policy ships.
        """
        world = self.track.world
        team = self.track.teammates
        taken = () if team is None else team.players
        deciding = [player for player in range(world.game.num_players) if player not in taken]
        audited = thorough or self.policy.is_own
        try:
            encoder = make_encoder(world, self.policy.interface)
            start = _initial_state(world, self.episodes)
            for fills in (False, True):
                policy = self.policy.build(encoder.layout, self.training_seed)
                witnesses = self._witnesses(encoder.layout, deciding, thorough=thorough, fills=fills) if audited else ()
                try:
                    teammates = None if team is None else team.join(world)
                    samples = measure(rollout(policy, encoder, start, teammates, witnesses=witnesses))
                    break
                except AuditError:  # perhaps of rounding, which a batch of the same size excludes
                    if fills:
                        raise
        except LayoutError as error:
            return JobResult(not_applicable=str(error))
        except PolicyError as error:
            return JobResult(failure=str(error))
        return JobResult({name: _rounded(values) for name, values in samples.items()})

    def _witnesses(
        self, layout: ObservationLayout, deciding: Sequence[int], *, thorough: bool, fills: bool
    ) -> list[Witness]:
        """Fresh policies that audit the decisions, the last one with the links of one player alone."""
        rows = sample_rows(self.episodes.count, len(deciding), thorough=thorough)
        found = [Witness(self.policy.build(layout, self.training_seed), chosen, fills=fills) for chosen in rows]
        place, chosen = rows_of_one(self.episodes.count, len(deciding))
        try:
            alone = self.policy.build(with_links_of(layout, deciding[place]), self.training_seed)
        except LayoutError as error:
            raise PolicyError(f"{USES_OTHER_LINKS}. It cannot be built from them: {error}") from None
        return [*found, Witness(alone, chosen, USES_OTHER_LINKS, fills=fills)]


def _rounded(values: FloatArray) -> FloatArray:
    return np.array([float(f"{value:.{DECIMALS}g}") for value in values.tolist()])


@lru_cache(maxsize=2)  # jobs with the same episodes follow each other
def _initial_state(world: World, episodes: EpisodeSet) -> State:
    return episodes.initial_state(world)


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


Run: TypeAlias = Callable[[Sequence[Job]], list[JobResult]]
"""Gives the results of jobs, in their order."""


def run_serially(jobs: Sequence[Job]) -> list[JobResult]:
    """Run jobs one after the other in this process."""
    return [job.compute() for job in jobs]
