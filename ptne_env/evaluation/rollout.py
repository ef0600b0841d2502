"""Running a policy through a batch of episodes, and recording series on the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.evaluation.audit import Witness
from ptne_env.games import NoBestResponseError
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.policy import Policy, PolicyError, decision, describe
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray, ordered_sum
from ptne_env.shared.names import unknown_name
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import REWARD_LIMIT, limit_distance, measure_distances
from ptne_env.world.world import World

REGRET_INTERVALS = 20
"""Intervals between the instants at which regrets are recorded: in every step they would take as long as a law."""


@dataclass(frozen=True)
class Rollout:
    """B episodes of one policy.

    Attributes:
        world: in which they ran.
        series: numbers per episode by name, as :func:`at_instant`, :func:`regret` and :func:`in_step` record them, of
            shape (instants, B), (instants of regrets, B) and (steps to the deadline, B).
        diverged: whether the episode left the range, shape (B,).
        seconds_per_decision: wall time of the policy per player and step.
    """

    world: World
    series: dict[str, FloatArray]
    diverged: BoolArray
    seconds_per_decision: float

    def __getitem__(self, series: str) -> FloatArray:
        """A series by name, shape (instants or steps, B).

        Raises:
            KeyError: naming the series that there are, when there is no such one.
        """
        if series not in self.series:
            raise KeyError(unknown_name("series", series, self.series))
        return self.series[series]


def at_instant(state: State) -> dict[str, FloatArray]:
    """The series of every instant: relative distances of strategies and estimates, and the mean digits of players."""
    players, strategies = measure_distances(state), distances.strategy_distance(dynamics.strategies(state), state.game)
    return {
        "strategy_distance": limit_distance(state, strategies),
        "estimate_distance": distances.over_players(players),
        "mean_digits": ordered_sum(distances.digits(players)) / len(players),
    }


def regret_instants(world: World) -> IntArray:
    """The instants at which regrets are recorded, from the start to the deadline.

    The spaces between them grow, because regrets fall fast at first: with even ones, all fast policies look alike.
    """
    places = np.linspace(0, 1, REGRET_INTERVALS + 1)
    return np.unique((world.clock.steps * places**2).round().astype(np.int64))


def regret(state: State) -> dict[str, FloatArray]:
    """The series of the instants of regrets: the sum over players; NaN where the game has no best response."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # only a diverged environment overflows
            regrets = np.clip(state.game.regrets(dynamics.strategies(state)), 0, REWARD_LIMIT)
    except NoBestResponseError:
        return {"regret": np.full(dynamics.batch_size(state), np.nan)}
    return {"regret": ordered_sum(np.where(state.diverged, REWARD_LIMIT, regrets))}


def in_step(world: World, state: State, inputs: FloatArray, step: int) -> dict[str, FloatArray]:
    """The series of every step to the deadline: the efforts of the episodes in range."""
    dt, acting = world.clock.dt[step], ~state.diverged
    magnitudes = np.abs(inputs) * acting
    # The action box is float32, so an input at the limit may be the float32 just below it.
    limit = np.nextafter(np.float32(world.input_limit), np.float32(0))
    return {
        "input_energy": dt * (magnitudes**2).sum(axis=(0, 1)),
        "peak_input": magnitudes.max(axis=(0, 1)),
        "saturated": (magnitudes >= limit).sum(axis=(0, 1)),
        "components": acting * magnitudes[..., 0].size,
    }


class Member:
    """A policy that decides for some of the players through its own encoder.

    The policy is called with ``deterministic=True``, and its memory is passed back to it unread.

    Args:
        policy: built for the layout of ``encoder``.
        encoder: makes its observations and decodes its actions.
        players: indices of the players for which it decides.
        witnesses: audit the decisions.

    Attributes:
        seconds: wall time of the policy so far.
    """

    def __init__(
        self, policy: Policy, encoder: Encoder, players: Sequence[int], witnesses: Sequence[Witness] = ()
    ) -> None:
        self.policy, self.encoder = policy, encoder
        self.players = np.array(players, dtype=np.int64)
        self.witnesses = witnesses
        self.seconds = 0.0
        self._memory: Any = None
        self._episode_start = np.zeros(0, dtype=np.bool_)  # before the first decision

    def decide(self, state: State) -> FloatArray:
        """Inputs u of shape (n, N, B), 0 for all other players.

        Raises:
            PolicyError: when the policy raises, returns actions of another shape or actions that are not finite, or
                does not pass the audit.
        """
        layout, batch = self.encoder.layout, dynamics.batch_size(state)
        rows = len(self.players) * batch
        is_alone = len(self.players) == layout.num_players
        if not self._episode_start.size:
            self._episode_start = np.ones(rows, dtype=np.bool_)
        observations = self.encoder.observe(state)
        if not is_alone:
            observations = observations[:, self.players]
        shape = (batch, len(self.players), layout.action_size)
        try:
            chosen = self._ask(observations.reshape(rows, -1)).reshape(shape)
        except PolicyError as error:
            raise type(error)(f"step {int(state.step[0])}: {error}") from error
        except MemoryError:
            raise
        except Exception as error:  # of the policy or of a witness
            raise PolicyError(f"step {int(state.step[0])}: {describe(error)}") from error
        if is_alone:
            return self.encoder.decode(chosen, state)
        actions_of_all = np.zeros((batch, layout.num_players, layout.action_size), dtype=chosen.dtype)
        actions_of_all[:, self.players] = chosen
        inputs = np.zeros_like(state.estimates)
        inputs[:, self.players] = self.encoder.decode(actions_of_all, state)[:, self.players]
        return inputs

    def _ask(self, observations: Float32Array) -> npt.NDArray[Any]:
        """The actions for observations of shape (R, size), checked and audited: shape (R, action size)."""
        started = perf_counter()
        actions, self._memory = decision(self.policy, observations, self._memory, self._episode_start)
        self.seconds += perf_counter() - started
        self._episode_start = np.zeros_like(self._episode_start)
        chosen, expected = np.asarray(actions), (len(observations), self.encoder.layout.action_size)
        if chosen.shape != expected:
            raise PolicyError(
                f"it answered {expected[0]} observations with actions of shape {chosen.shape}; expected {expected}"
            )
        if not np.isfinite(chosen).all():
            raise PolicyError("it answered with an action that is not finite; expected numbers without NaN or inf")
        for witness in self.witnesses:
            witness.compare(observations, chosen)
        return chosen


def rollout(
    policy: Policy,
    encoder: Encoder,
    start: State,
    teammates: Member | None = None,
    watch: Callable[[State, FloatArray | None], None] | None = None,
    witnesses: Sequence[Witness] = (),
) -> Rollout:
    """Run ``policy`` from the state ``start`` at t = 0 to the end of every episode.

    Args:
        policy: the policy that is measured.
        encoder: makes its observations and decodes its actions.
        start: initial state of all episodes.
        teammates: decide for their players in place of ``policy``, which decides for the other players only.
        watch: called with every state and the inputs (n, N, B) that are held from it, ``None`` with the last state.
        witnesses: audit the decisions of ``policy``.

    Raises:
        PolicyError: when a policy raises, returns actions of another shape or actions that are not finite, or does not
            pass the audit.
    """
    world, batch = encoder.world, dynamics.batch_size(start)
    clock, players = world.clock, range(world.game.num_players)
    taken = set() if teammates is None else set(teammates.players.tolist())
    member = Member(policy, encoder, [player for player in players if player not in taken], witnesses)
    recorded: dict[str, list[FloatArray]] = {}
    observed = set(regret_instants(world).tolist())
    state = start
    for step in range(clock.total_steps + 1):
        inputs = member.decide(state) if step < clock.total_steps else None
        if teammates is not None and inputs is not None:
            inputs += teammates.decide(state)
        if watch is not None:
            watch(state, inputs)
        found = at_instant(state)
        if step in observed:
            found |= regret(state)
        if inputs is not None and step < clock.steps:
            found |= in_step(world, state, inputs, step)
        for name, values in found.items():
            recorded.setdefault(name, []).append(values)
        if inputs is not None:
            state = dynamics.step(world, state, inputs)
    series = {name: np.array(values, dtype=np.float64) for name, values in recorded.items()}
    seconds = member.seconds / (clock.total_steps * len(member.players) * batch)
    return Rollout(world, series, state.diverged, seconds)
