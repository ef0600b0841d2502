"""Series: the quantities that a rollout records at each instant or step, one number per episode, for the metrics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ptne_env.shared.arrays import FloatArray, IntArray, ordered_sum
from ptne_env.world import distances, dynamics
from ptne_env.world.clock import StepClock
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import REWARD_LIMIT
from ptne_env.world.world import World

When: TypeAlias = Literal["instants", "steps", "deadline", "ends"]
"""Every instant, every step to the deadline, the instant T, or the first and the last instant."""


class Moment:
    """One instant of a rollout of B episodes, with the intermediate results that several series share.

    Attributes:
        world: of the rollout.
        state: at the instant.
        step: index of the instant.
        player_distances: ‖x^i − x*‖/‖x*‖, at the range limit in a diverged episode; shape (N, B).
        inputs: u that are held from the instant on, shape (n, N, B). They, and what follows from them, exist before
            the deadline only.
    """

    def __init__(self, world: World, state: State, inputs: FloatArray | None, step: int) -> None:
        self.world, self.state, self.step = world, state, step
        self._has_diverged = state.any_diverged
        self.player_distances = self.limited(distances.player_distances(state.estimates, state.game))
        if inputs is not None and step < world.clock.steps:
            self.inputs = inputs

    @cached_property
    def magnitudes(self) -> FloatArray:
        """|u|, 0 in a diverged episode; shape (n, N, B)."""
        magnitudes = np.abs(self.inputs)
        if self._has_diverged:
            magnitudes *= ~self.state.diverged
        return magnitudes

    @cached_property
    def squared_input(self) -> FloatArray:
        """‖u‖², shape (B,)."""
        return _squared(self.magnitudes)

    @cached_property
    def largest_input(self) -> FloatArray:
        """The largest |u| of any component, shape (B,)."""
        largest: FloatArray = self.magnitudes.max(axis=(0, 1))
        return largest

    @property
    def strategies(self) -> FloatArray:
        """The real strategies x, shape (n, B)."""
        return dynamics.strategies(self.world, self.state)

    @property
    def scaled_magnitudes(self) -> FloatArray | None:
        """|u| times each player's own Θ over the true Θ; ``None`` where all clocks are right."""
        theta = self.world.theta
        if theta.ndim == 1:
            return None
        return self.magnitudes * (theta[:, [self.step]] / self.world.clock.theta[self.step])

    def limited(self, distance: FloatArray) -> FloatArray:
        """``distance`` (..., B) with the range limit where an episode has diverged."""
        if not self._has_diverged:
            return distance
        return np.where(self.state.diverged, dynamics.distance_limit(self.state.game), distance)


@dataclass(frozen=True)
class Series:
    """A quantity that is recorded along a rollout.

    Attributes:
        name: by which metrics read it.
        value: of a moment, shape (B,).
        when: at which instants it is recorded.
    """

    name: str
    value: Callable[[Moment], FloatArray | IntArray]
    when: When = "steps"

    def instants(self, clock: StepClock) -> Sequence[int]:
        """The indices of the instants at which it is recorded, in order."""
        return {
            "instants": range(clock.total_steps + 1),
            "steps": range(clock.steps),
            "deadline": range(clock.steps, clock.steps + 1),
            "ends": (0, clock.total_steps),
        }[self.when]


def _squared(array: FloatArray) -> FloatArray:
    """The sum of squares over components and players: (n, N, B) to (B,)."""
    total: FloatArray = (array**2).sum(axis=(0, 1))
    return total


def _strategy_distance(moment: Moment) -> FloatArray:
    return moment.limited(distances.strategy_distance(moment.strategies, moment.state.game))


def _estimate_distance(moment: Moment) -> FloatArray:
    players = moment.player_distances
    return np.sqrt(ordered_sum(players**2) / len(players))


def _mean_digits(moment: Moment) -> FloatArray:
    players = moment.player_distances
    return ordered_sum(distances.digits(players)) / len(players)


def _consensus_error(moment: Moment) -> FloatArray:
    return moment.limited(distances.consensus_error(moment.state.estimates, moment.state.game))


def _regret(moment: Moment) -> FloatArray:
    state = moment.state
    if not state.game.has_best_response:
        return np.full(dynamics.batch_size(state), np.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # only a diverged environment overflows
        regrets = np.clip(state.game.regrets(moment.strategies), 0, REWARD_LIMIT)
    return ordered_sum(np.where(state.diverged, REWARD_LIMIT, regrets))


def _input_energy(moment: Moment) -> FloatArray:
    energy: FloatArray = moment.world.clock.dt[moment.step] * moment.squared_input
    return energy


def _velocity_energy(moment: Moment) -> FloatArray:
    clock, scaled = moment.world.clock, moment.scaled_magnitudes
    theta, dt = clock.theta[moment.step], clock.dt[moment.step]
    energy: FloatArray = theta**2 / dt * (moment.squared_input if scaled is None else _squared(scaled))
    return energy


def _peak_velocity(moment: Moment) -> FloatArray:
    clock, scaled = moment.world.clock, moment.scaled_magnitudes
    theta, dt = clock.theta[moment.step], clock.dt[moment.step]
    peak: FloatArray = theta / dt * (moment.largest_input if scaled is None else scaled.max(axis=(0, 1)))
    return peak


def _saturated(moment: Moment) -> IntArray:
    # The action box is float32, so an input at the limit may be the float32 just below it.
    limit = np.nextafter(np.float32(moment.world.input_limit), np.float32(0))
    if not (moment.largest_input >= limit).any():
        return np.zeros(moment.largest_input.shape, dtype=np.int64)
    count: IntArray = (moment.magnitudes >= limit).sum(axis=(0, 1))
    return count


def _components(moment: Moment) -> IntArray:
    components, players, _ = moment.magnitudes.shape
    return ~moment.state.diverged * (components * players)


def _messages(moment: Moment) -> IntArray:
    links: IntArray = (dynamics.weights(moment.world, moment.state) > 0).sum(axis=(0, 1))
    return ~moment.state.diverged * links


SERIES: dict[str, Series] = {
    series.name: series
    for series in [
        Series("strategy_distance", _strategy_distance, "instants"),
        Series("estimate_distance", _estimate_distance, "instants"),
        Series("mean_digits", _mean_digits, "ends"),
        Series("consensus_error", _consensus_error, "deadline"),
        Series("regret", _regret, "deadline"),
        Series("input_energy", _input_energy),
        Series("velocity_energy", _velocity_energy),
        Series("peak_input", lambda moment: moment.largest_input),
        Series("peak_velocity", _peak_velocity),
        Series("saturated", _saturated),
        Series("components", _components),
        Series("messages", _messages),
    ]
}
"""The recorded series by name. Efforts are those of the episodes in range."""
