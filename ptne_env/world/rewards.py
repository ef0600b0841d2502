"""Reward terms by name; the reward is their weighted sum.

========== =====================================================================================================
term       value for player i at step k
========== =====================================================================================================
digits     log10 d^i_k − log10 d^i_{k+1} with d^i = ‖x^i − x*‖/‖x*‖ floored at 1e-12; the return is digits gained
tracking   −d^i_{k+1}
payoff     −J_i at the real strategies after the step
regret     −(J_i(x) − min over y of J_i(y, x_{-i})) after the step; over players it sums to minus the Nikaido–Isoda
           regret. Only for games whose best response exists everywhere.
========== =====================================================================================================

Rewards use x*, which no observation shows: a privilege of training.

A diverged environment receives, for the step and all remaining steps, the reward at the range limit. No state in range
has a lower reward, so divergence never pays.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.games import Game, NoBestResponseError
from ptne_env.shared.arrays import FloatArray, array_namespace, require_non_negative
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import RANGE_LIMIT, World

TERMS = ("digits", "tracking", "payoff", "regret")
"""The names of the reward terms."""

REWARD_LIMIT = RANGE_LIMIT**2
"""Payoff and regret are clipped to ±REWARD_LIMIT, the order of a quadratic cost at the range limit."""


class Reward:
    """The reward of one world, with a memory of the distances at the previous instant.

    Args:
        world: the world.
        reward: a term's name, or weights by name.

    Attributes:
        weights: by term.
        is_plain: whether the reward is one term, of weight 1.
        distances: d^i at the present instant, shape (N, B), with the limit where an environment has diverged.

    Raises:
        TypeError: for anything but a name and a mapping.
        ValueError: for an unknown term, no term, a weight that is negative (divergence would pay) or not finite, or
            ``regret`` on a game without best response.
    """

    def __init__(self, world: World, reward: str | Mapping[str, float] = "digits") -> None:
        if not isinstance(reward, str | Mapping):
            raise TypeError(
                f"reward is one of {', '.join(TERMS)}, or weights by name such as {{'digits': 1.0, 'payoff': 0.1}}, "
                f"got {reward!r}; another reward is a wrapper of the environment (docs/adding-parts.md)"
            )
        given = {reward: 1.0} if isinstance(reward, str) else reward
        if (unknown := sorted(set(given) - set(TERMS))) or not given:
            raise ValueError(f"unknown reward {', '.join(map(repr, unknown)) or '{}'}; choose from {', '.join(TERMS)}")
        self.weights = {name: require_non_negative(f"the weight of reward {name!r}", given[name]) for name in given}
        self.world = world
        if "regret" in self.weights and not world.game.has_best_response:
            raise NoBestResponseError(
                f"reward 'regret' needs a best response, which {type(world.game).__name__} does not have "
                "everywhere; choose digits, tracking or payoff"
            )
        (self._first, weight), *others = self.weights.items()
        self.is_plain = weight == 1 and not others
        self.distances = self._digits = np.empty((0, 0))

    def reset(self, state: State) -> None:
        """Measure the distances of ``state``, from which the next step is rewarded."""
        self.distances = measured(state)
        self._digits = distances.digits(self.distances)

    def step(self, state: State) -> dict[str, FloatArray]:
        """The value of each term for the step that ended in ``state``, each of shape (N, B)."""
        before, self.distances = self._digits, measured(state)
        self._digits = distances.digits(self.distances)
        if self.is_plain:  # a comprehension would take longer
            terms = {self._first: self._term(self._first, state, before)}
        else:
            terms = {name: self._term(name, state, before) for name in self.weights}
        if state.any_diverged:
            remaining = 1 + self.world.clock.total_steps - state.step
            for name, value in terms.items():
                if name != "digits":
                    terms[name] = np.where(state.diverged, worst(name, state.game) * remaining, value)
        return terms

    def total(self, terms: Mapping[str, FloatArray]) -> FloatArray:
        """The weighted sum of the terms, shape (N, B)."""
        if self.is_plain:
            return terms[self._first]
        (first, weight), *others = self.weights.items()
        total = weight * terms[first]
        for name, weight in others:
            total += weight * terms[name]
        return total

    def _term(self, name: str, state: State, digits_before: FloatArray) -> FloatArray:
        if name == "digits":
            return self._digits - digits_before
        if name == "tracking":
            return -self.distances
        return minus_loss(name, state.game, dynamics.strategies(self.world, state))


def measured(state: State) -> FloatArray:
    """d^i, shape (N, B), with the limit where an environment has diverged."""
    return limited(state, distances.player_distances(state.estimates, state.game))


def limited(state: State, distance: FloatArray) -> FloatArray:
    """A relative distance (..., B), with the limit where an environment has diverged."""
    if not state.any_diverged:
        return distance
    return array_namespace(distance).where(state.diverged, dynamics.distance_limit(state.game), distance)


def worst(name: str, game: Game) -> FloatArray | float:
    """The reward per remaining step at the range limit, of the terms but the digits, whose is 0 there; shape (G,)."""
    return -dynamics.distance_limit(game) if name == "tracking" else -REWARD_LIMIT


def minus_loss(name: str, game: Game, strategies: FloatArray) -> FloatArray:
    """The terms ``payoff`` and ``regret``: strategies (n, B) to (N, B)."""
    with np.errstate(over="ignore", invalid="ignore"):  # only a diverged environment overflows
        loss = game.costs(strategies) if name == "payoff" else game.regrets(strategies)
    result: FloatArray = array_namespace(loss).clip(-loss, -REWARD_LIMIT, REWARD_LIMIT)
    return result
