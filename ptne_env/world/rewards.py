"""The reward: a weighted sum of the terms in :data:`TERMS`, the one table that numpy and JAX read; or a function.

Terms use x*, which no observation shows: a privilege of training.

A diverged environment receives, for the step and all remaining steps, the reward at the range limit. No state in range
has a lower reward, so divergence never pays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from inspect import signature
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ptne_env.games import Game, NoBestResponseError
from ptne_env.shared.arrays import FloatArray, array_namespace, is_numpy, require_non_negative
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import RANGE_LIMIT, World

REWARD_LIMIT = RANGE_LIMIT**2
"""Payoff and regret are clipped to ±REWARD_LIMIT, the order of a quadratic cost at the range limit."""


class Term(NamedTuple):
    """A term of the reward, whose functions compute with the library of their arrays.

    Attributes:
        meaning: what player i receives for a step, one line.
        value: called with a state and its d^i = ‖x^i − x*‖/‖x*‖, shape (N, B); returns the same shape.
        worst: called with a game; returns a number, or shape (G,), that ``value`` exceeds in every state in range. It
            is the value of an environment that has diverged.
        is_gain: whether players receive the increase of ``value`` in the step instead of ``value`` after it.
        needs_best_response: whether the term is refused for a game whose best response does not exist everywhere.
    """

    meaning: str
    value: Callable[[State, FloatArray], FloatArray]
    worst: Callable[[Game], FloatArray | float]
    is_gain: bool = False
    needs_best_response: bool = False


def _minus(loss: Callable[[FloatArray], FloatArray], state: State) -> FloatArray:
    """Return minus the loss at the real strategies, clipped to ±REWARD_LIMIT."""
    with np.errstate(over="ignore", invalid="ignore"):  # a cost may overflow where no own gradient does
        reward = -loss(dynamics.strategies(state))
    result: FloatArray = array_namespace(reward).clip(reward, -REWARD_LIMIT, REWARD_LIMIT)
    return result


TERMS: Mapping[str, Term] = {
    "digits": Term(
        "log10 d^i before the step − log10 d^i after it, with d^i floored at 1e-12; the return is the digits gained",
        value=lambda _, distance: distances.digits(distance),
        worst=lambda game: distances.digits(dynamics.distance_limit(game)),
        is_gain=True,
    ),
    "tracking": Term(
        "−d^i after the step", value=lambda _, distance: -distance, worst=lambda game: -dynamics.distance_limit(game)
    ),
    "payoff": Term(
        "−J_i(x) of the real strategies x after the step",
        value=lambda state, _: _minus(state.game.costs, state),
        worst=lambda _: -REWARD_LIMIT,
    ),
    "regret": Term(
        "min over y of J_i(y, x_{−i}) − J_i(x) after the step, minus the gain of a best response, over its mean at a "
        "distance of 1 from x*; an error for games that have none, such as Example 2",
        value=lambda state, _: _minus(state.game.regrets, state) / state.game.regret_scale,
        worst=lambda game: -REWARD_LIMIT / game.regret_scale,
        needs_best_response=True,
    ),
}
"""The terms of the reward by name. A new term is one entry here and its row in docs/environment.md."""


RewardFunction: TypeAlias = Callable[[State, State, World], Any]
"""``reward(before, after, world)``: the rewards of the steps of B environments from one state to the next, (N, B), or
(B,) for one that all players share. States have environments last and are not to be changed; B may differ by call. An
environment that leaves the range, ``after.diverged``, is clipped to it, and nothing is paid afterwards."""

RewardChoice: TypeAlias = str | Mapping[str, float] | RewardFunction
"""The name of a term, weights by name, or a function."""


class Reward:
    """The reward of one world, with a memory of the previous instant; it computes with the library of its states.

    Attributes:
        weights: by term; those of a function are ``{"function": 1.0}``.
        distances: d^i at the present instant, shape (N, B), with the limit where an environment has diverged.

    Raises:
        TypeError: for anything but a name, a mapping and a function of three arguments.
        ValueError: for an unknown term, no term, a weight that is negative (divergence would pay) or not finite, or
            a term that needs a best response on a game without one.
    """

    def __init__(self, world: World, reward: RewardChoice = "digits") -> None:
        is_named = isinstance(reward, str | Mapping)
        if not (is_named or _takes_a_step(reward)):
            raise TypeError(
                f"reward is one of {', '.join(TERMS)}, or weights by name such as {{'digits': 1.0, 'payoff': 0.1}}, or "
                f"a function of (before, after, world), got {reward!r}"
            )
        self._world = world
        self._function: Any = None if is_named else reward
        weights: Any = {} if not is_named else {reward: 1.0} if isinstance(reward, str) else reward
        if (unknown := sorted(set(weights) - set(TERMS))) or (is_named and not weights):
            raise ValueError(f"unknown reward {', '.join(map(repr, unknown)) or '{}'}; choose from {', '.join(TERMS)}")
        self.weights = {name: require_non_negative(f"the weight of reward {name!r}", weights[name]) for name in weights}
        refused = [name for name in weights if TERMS[name].needs_best_response and not world.game.has_best_response]
        if refused:
            others = [name for name, term in TERMS.items() if not term.needs_best_response]
            raise NoBestResponseError(
                f"reward {refused[0]!r} needs a best response, which {type(world.game).__name__} does not have "
                f"everywhere; choose {', '.join(others[:-1])} or {others[-1]}"
            )
        if self._function is not None:
            self.weights = {"function": 1.0}
        self._names, self._gains = [*weights], [name for name in weights if TERMS[name].is_gain]
        self._steps = world.clock.total_steps
        self._values: dict[str, FloatArray] = {}
        self._state: Any = None
        self.distances = np.empty((0, 0))

    def reset(self, state: State) -> None:
        """Measure ``state``, from which the next step is rewarded."""
        self._values, self._state = self._measure(state, self._gains), state

    def step(self, state: State) -> dict[str, FloatArray]:
        """Return the value of each term for the step that ended in ``state``, each of shape (N, B).

        An episode that diverges in the step is charged for all that remain, and no more afterwards. It is a
        ``ValueError`` when a function returns something else than finite numbers of shape (N, B) or (B,).
        """
        before, values = self._values, self._measure(state, self._names)
        self._values, terms = values, values.copy()
        for name in self._gains:
            terms[name] = values[name] - before[name]
        if state.any_diverged:
            xp = array_namespace(state.diverged)
            remaining = xp.where(self._state.diverged, 0, 1 + self._steps - state.step)
            charged = xp.where(state.diverged, remaining, 1)
            terms = {name: term if TERMS[name].is_gain else term * charged for name, term in terms.items()}
        if self._function is not None:
            shape, paid = state.estimates.shape[1:], self._function(self._state, state, self._world)
            if np.shape(paid) not in (shape, shape[1:]) or (is_numpy(paid) and not np.isfinite(paid).all()):
                raise ValueError(f"a reward function returns finite numbers, {shape} or {shape[1:]}, got {paid!r}")
            xp = array_namespace(state.estimates)
            terms["function"] = xp.where(self._state.diverged, 0.0, xp.broadcast_to(paid, shape)).astype(np.float64)
        self._state = state
        return terms

    def total(self, terms: Mapping[str, FloatArray]) -> FloatArray:
        """Return the weighted sum of the terms, shape (N, B)."""
        weighted = [terms[name] if weight == 1 else weight * terms[name] for name, weight in self.weights.items()]
        return sum(weighted[1:], start=weighted[0])

    def _measure(self, state: State, names: Iterable[str]) -> dict[str, FloatArray]:
        """Return the values of terms in a state, the worst ones where an environment has diverged."""
        self.distances, values = measure_distances(state), {}
        if not state.any_diverged:
            for name in names:  # a comprehension would take longer
                values[name] = TERMS[name].value(state, self.distances)
            return values
        xp, game, diverged = array_namespace(state.estimates), state.game, state.diverged
        # At x*, because the costs of a diverged game may overflow, and would bring NaN into gradients of JAX.
        safe = state._replace(estimates=xp.where(diverged, game.nash_equilibria[:, None], state.estimates))
        for name in names:
            values[name] = xp.where(diverged, TERMS[name].worst(game), TERMS[name].value(safe, self.distances))
        return values


def _takes_a_step(reward: Any) -> bool:
    """Return whether an object can be called with (before, after, world)."""
    try:
        signature(reward).bind(None, None, None)
    except (TypeError, ValueError):
        return False
    return True


def measure_distances(state: State) -> FloatArray:
    """Return d^i, shape (N, B), with the limit where an environment has diverged."""
    return limit_distance(state, distances.player_distances(state.estimates, state.game))


def limit_distance(state: State, distance: FloatArray) -> FloatArray:
    """Return a relative distance (..., B), with the limit where an environment has diverged."""
    if not state.any_diverged:
        return distance
    return array_namespace(distance).where(state.diverged, dynamics.distance_limit(state.game), distance)
