"""Rollouts: a policy plays a batch of episodes, and series of numbers are recorded on the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.evaluation.audit import Witness
from ptne_env.games import NoBestResponseError
from ptne_env.perception.encoder import Encoder, find_action_fault
from ptne_env.perception.policy import Policy, PolicyError, RunningPolicy, describe
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray, ordered_sum
from ptne_env.shared.names import unknown_name
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import REWARD_LIMIT, limit_distance, measure_distances
from ptne_env.world.world import World


@dataclass(frozen=True)
class Rollout:
    """What was recorded in B episodes of one policy.

    Attributes:
        world: the world of the episodes.
        series: the series by name, as :func:`record_instant`, :func:`record_regret`, and :func:`record_step` and
            :func:`record_messages` record them, of shape (instants, B), (instants of regrets, B) and (steps to the
            deadline, B).
        diverged: whether the episode left the range, shape (B,).
        seconds_per_decision: the wall time of the policy per player and step.
    """

    world: World
    series: dict[str, FloatArray]
    diverged: BoolArray
    seconds_per_decision: float

    def __getitem__(self, series: str) -> FloatArray:
        """Return a series by name, shape (instants or steps, B); ``KeyError`` with all names where there is none."""
        if series not in self.series:
            raise KeyError(unknown_name("series", series, self.series))
        return self.series[series]


def record_instant(state: State) -> dict[str, FloatArray]:
    """Return the series of an instant: distances of strategies and estimates, and the mean digits of players."""
    players, strategies = measure_distances(state), distances.strategy_distance(dynamics.strategies(state), state.game)
    return {
        "strategy_distance": limit_distance(state, strategies),
        "estimate_distance": distances.over_players(players),
        "mean_digits": ordered_sum(distances.digits(players)) / len(players),
    }


def regret_instants(world: World) -> IntArray:
    """Return the 21 instants at which regrets are recorded: in every step they would cost as much as a law.

    The spaces between them grow, because regrets fall fast at first: with even ones, all fast policies look alike.
    """
    places = np.linspace(0, 1, 21)
    return np.unique((world.clock.steps * places**2).round().astype(np.int64))


def record_regret(state: State) -> dict[str, FloatArray]:
    """Return the regret of an instant, summed over players; NaN where the game has no best response."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # only a diverged environment overflows
            regrets = np.clip(state.game.regrets(dynamics.strategies(state)), 0, REWARD_LIMIT)
    except NoBestResponseError:
        return {"regret": np.full(dynamics.batch_size(state), np.nan)}
    return {"regret": ordered_sum(np.where(state.diverged, REWARD_LIMIT, regrets))}


def record_step(world: World, state: State, inputs: FloatArray, step: int) -> dict[str, FloatArray]:
    """Return the series of a step before the deadline: the efforts of the episodes in range."""
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


def record_messages(world: World, before: State | None, state: State) -> dict[str, FloatArray]:
    """Return the messages that links carry at an instant, and the new ones among them.

    A message is new unless the same link carried the same estimates one step ``before``.
    """
    shape = *world.neighbours.shape, dynamics.batch_size(state)
    new = up = np.broadcast_to(dynamics.graph_weights(world, state) > 0, shape)
    if before is not None:
        moved = (state.estimates != before.estimates).any(axis=0)
        new = up & (moved[world.neighbours] | (dynamics.graph_weights(world, before) == 0))
    return {"messages": up.sum(axis=(0, 1)), "new_messages": new.sum(axis=(0, 1))}


class Member:
    """A policy that decides for some of the players through its own encoder.

    Attributes:
        players: the indices of the players for which it decides.
        witnesses: the witnesses that audit its decisions.
        seconds: the wall time of the policy so far.
    """

    def __init__(
        self, policy: Policy, encoder: Encoder, players: Sequence[int], witnesses: Sequence[Witness] = ()
    ) -> None:
        self.encoder, self.witnesses, self._policy = encoder, witnesses, RunningPolicy(policy)
        self.players = np.array(players, dtype=np.int64)
        self.seconds = 0.0

    def decide(self, state: State) -> FloatArray:
        """Return inputs u of shape (n, N, B), which are 0 for all other players.

        Raises:
            PolicyError: when the policy raises, answers with anything but finite actions of the right shape, or
                does not pass the audit.
        """
        layout, batch = self.encoder.layout, dynamics.batch_size(state)
        observations = self.encoder.observe(state)[:, self.players]
        try:
            actions = self._ask(observations.reshape(-1, layout.size)).reshape(batch, -1, layout.action_size)
        except PolicyError as error:
            raise type(error)(f"step {int(state.step[0])}: {error}") from error
        except (Exception, SystemExit) as error:  # of the policy or of a witness
            raise PolicyError(f"step {int(state.step[0])}: {describe(error)}") from error
        actions_of_all = np.zeros((batch, layout.num_players, layout.action_size), dtype=actions.dtype)
        actions_of_all[:, self.players] = actions
        inputs = np.zeros_like(state.estimates)
        inputs[:, self.players] = self.encoder.decode(actions_of_all, state)[:, self.players]
        return inputs

    def _ask(self, observations: Float32Array) -> npt.NDArray[Any]:
        """Ask the policy for actions (R, action size) at observations (R, size), check and audit them."""
        started = perf_counter()
        given = observations.copy() if self.witnesses else observations  # a policy may write into what it is given
        answer = self._policy.decide(given)
        self.seconds += perf_counter() - started
        rows = len(observations)
        if fault := find_action_fault(answer, (rows, self.encoder.layout.action_size)):
            raise PolicyError(f"its answer to {rows} observations {fault}")
        actions = np.asarray(answer)
        for witness in self.witnesses:
            witness.compare(observations, actions)
        return actions


def rollout(
    policy: Policy,
    encoder: Encoder,
    start: State,
    teammates: Member | None = None,
    watch: Callable[[State, FloatArray | None], None] | None = None,
    witnesses: Sequence[Witness] = (),
    *,
    counts_messages: bool = True,
) -> Rollout:
    """Run a policy from the state at t = 0 to the end of every episode.

    Args:
        policy: the policy that is measured, built for the layout of ``encoder``.
        encoder: the encoder, which makes its observations and decodes its actions.
        start: the initial state of all episodes.
        teammates: a member that decides for its players; ``policy`` then decides for the other players only.
        watch: a function that is called with every state and the inputs (n, N, B) that are held from it, ``None`` with
            the last state.
        witnesses: the witnesses that audit the decisions of ``policy``.
        counts_messages: whether :func:`record_messages` is among the series, which the optional metrics need.

    Raises:
        PolicyError: as :meth:`Member.decide`.
        ValueError: when the teammates fail.
    """
    world, batch = encoder.world, dynamics.batch_size(start)
    clock, players = world.clock, range(world.game.num_players)
    taken = set() if teammates is None else set(teammates.players.tolist())
    member = Member(policy, encoder, [player for player in players if player not in taken], witnesses)
    series: dict[str, list[FloatArray]] = {}
    instants = set(regret_instants(world).tolist())
    before, state = None, start
    for step in range(clock.total_steps + 1):
        inputs = member.decide(state) if step < clock.total_steps else None
        if teammates is not None and inputs is not None:
            try:
                inputs += teammates.decide(state)
            except PolicyError as error:  # which is no failure of the policy
                raise ValueError(f"the teammates fail: {error}") from error
        if watch is not None:
            watch(state, inputs)
        numbers = record_instant(state)
        if step in instants:
            numbers |= record_regret(state)
        if inputs is not None and step < clock.steps:
            numbers |= record_step(world, state, inputs, step)
            if counts_messages:
                numbers |= record_messages(world, before, state)
        for name, values in numbers.items():
            series.setdefault(name, []).append(values)
        if inputs is not None:
            before, state = state, dynamics.step(world, state, inputs)
    arrays = {name: np.array(values, dtype=np.float64) for name, values in series.items()}
    seconds = member.seconds / (clock.total_steps * len(member.players) * batch)
    return Rollout(world, arrays, state.diverged, seconds)
