"""Running a policy through a batch of episodes, and keeping what the metrics need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from ptne_env import distances, dynamics
from ptne_env.arrays import BoolArray, FloatArray, ordered_sum
from ptne_env.dynamics import State
from ptne_env.encoder import Encoder
from ptne_env.policy import Policy
from ptne_env.rewards import REWARD_LIMIT
from ptne_env.world import World

NUMBER_BITS = 32
"""Bits of a number in a message: estimates are sent as float32."""


@dataclass(frozen=True)
class Rollout:
    """What happened in B episodes of one policy. Distances of a diverged episode are at the range limit from then on.

    Attributes:
        times: t at each instant in seconds, shape (K+H+1,).
        deadline_step: K, the instant at which t = T.
        strategy_distance: ‖x − x*‖/‖x*‖ at each instant, shape (K+H+1, B).
        estimate_distance: ‖𝐱 − 1⊗x*‖/(√N ‖x*‖) at each instant, shape (K+H+1, B).
        consensus_error: ‖𝐱 − 1⊗x̄‖/(√N ‖x*‖) at the deadline, shape (B,).
        digits_gained: mean over players of the summed ``digits`` reward, shape (B,).
        input_energy: Σ Δt ‖u‖² over the steps to the deadline, shape (B,).
        velocity_energy: Σ Θ² ‖u‖²/Δt over the steps to the deadline, shape (B,).
        peak_input: largest |u| of any component in any step to the deadline, shape (B,).
        peak_velocity: largest Θ|u|/Δt likewise, shape (B,).
        saturated_share: share of input components at the input limit in the steps to the deadline, shape (B,).
        diverged: shape (B,).
        seconds_per_decision: wall time of the policy per player and step.
        regret: Nikaido–Isoda gap of the strategies at the deadline, at most the range limit squared per player; NaN
            where the game has no best response. Shape (B,).
        log_error_area: ∫ log10 of the estimate distance dt / T over [0, T], distances floored at 1e-12, shape (B,).
        messages: estimates sent over live links until the deadline, shape (B,).
        bits: in these messages, shape (B,).
    """

    times: FloatArray
    deadline_step: int
    strategy_distance: FloatArray
    estimate_distance: FloatArray
    consensus_error: FloatArray
    digits_gained: FloatArray
    input_energy: FloatArray
    velocity_energy: FloatArray
    peak_input: FloatArray
    peak_velocity: FloatArray
    saturated_share: FloatArray
    diverged: BoolArray
    seconds_per_decision: float
    regret: FloatArray
    log_error_area: FloatArray
    messages: FloatArray
    bits: FloatArray


class Member:
    """A policy that decides for some of the players, whom it sees through its own encoder.

    The policy is asked with ``deterministic=True`` and its memory is passed back to it unread.

    Args:
        policy: built for the layout of ``encoder``.
        encoder: through which it sees and acts.
        players: for whom it decides.

    Attributes:
        seconds: wall time of the policy so far.
    """

    def __init__(self, policy: Policy, encoder: Encoder, players: Sequence[int]) -> None:
        self.policy, self.encoder = policy, encoder
        self.players = np.array(players, dtype=np.int64)
        self.seconds = 0.0
        self._memory: Any = None
        self._episode_start: BoolArray | None = None

    def decide(self, state: State) -> FloatArray:
        """Inputs u of shape (n, N, B), 0 for the players of others.

        Raises:
            ValueError: when the policy answers with actions of another shape, or with ones that are not finite.
        """
        layout, batch, rows = (
            self.encoder.layout,
            dynamics.batch_size(state),
            len(self.players) * dynamics.batch_size(state),
        )
        is_alone = len(self.players) == layout.num_players
        if self._episode_start is None:
            self._episode_start = np.ones(rows, dtype=np.bool_)
        observations = self.encoder.observe(state)
        if not is_alone:
            observations = observations[:, self.players]
        started = perf_counter()
        actions, self._memory = self.policy.predict(
            observations.reshape(rows, -1), self._memory, self._episode_start, deterministic=True
        )
        self.seconds += perf_counter() - started
        self._episode_start = np.zeros_like(self._episode_start)
        chosen = _checked(np.asarray(actions), (batch, len(self.players), layout.action_size))
        if is_alone:
            return self.encoder.decode(chosen, state)
        everybody = np.zeros((batch, layout.num_players, layout.action_size), dtype=chosen.dtype)
        everybody[:, self.players] = chosen
        inputs = np.zeros_like(state.estimates)
        inputs[:, self.players] = self.encoder.decode(everybody, state)[:, self.players]
        return inputs


def rollout(
    policy: Policy,
    encoder: Encoder,
    start: State,
    teammates: Member | None = None,
    watch: Callable[[State, FloatArray | None], None] | None = None,
) -> Rollout:
    """Run ``policy`` from the state ``start`` at t = 0 to the end of every episode.

    Args:
        policy: that is measured.
        encoder: through which it sees and acts.
        start: of all episodes.
        teammates: decide for their players in place of ``policy``, which is asked for the others only.
        watch: called with every state and the inputs (n, N, B) that are held from it, ``None`` with the last state.

    Raises:
        ValueError: when a policy answers with actions of another shape, or with ones that are not finite.
    """
    world, batch = encoder.world, dynamics.batch_size(start)
    clock, everybody = world.clock, range(world.game.num_players)
    taken = set() if teammates is None else set(teammates.players.tolist())
    member = Member(policy, encoder, [player for player in everybody if player not in taken])
    recorder = _Recorder(world, start)
    state = start
    recorder.record(0, state)
    for step in range(clock.total_steps):
        inputs = member.decide(state)
        if teammates is not None:
            inputs += teammates.decide(state)
        if watch is not None:
            watch(state, inputs)
        if step < clock.steps:
            recorder.spend(step, state, inputs)
        state = dynamics.step(world, state, inputs)
        recorder.record(step + 1, state)
    if watch is not None:
        watch(state, None)
    return recorder.finish(state, member.seconds / (clock.total_steps * len(member.players) * batch))


def _checked(actions: FloatArray, shape: tuple[int, int, int]) -> FloatArray:
    expected = (shape[0] * shape[1], shape[2])
    if actions.shape != expected:
        raise ValueError(
            f"the policy answered {expected[0]} observations with actions of shape {actions.shape}; expected {expected}"
        )
    if not np.isfinite(actions).all():
        raise ValueError("the policy answered with an action that is not finite; expected numbers without NaN or inf")
    return actions.reshape(shape)


class _Recorder:
    """Collects a rollout as it happens, so that trajectories need not be kept."""

    def __init__(self, world: World, start: State) -> None:
        self.world = world
        batch = dynamics.batch_size(start)
        self._game = start.game
        self._limit = dynamics.distance_limit(start.game)
        instants = world.clock.total_steps + 1
        self._strategy_distance = np.empty((instants, batch))
        self._estimate_distance = np.empty((instants, batch))
        self._consensus_error = np.zeros(batch)
        self._log_distances: list[FloatArray] = []
        self._input_energy, self._velocity_energy = np.zeros(batch), np.zeros(batch)
        self._peak_input, self._peak_velocity = np.zeros(batch), np.zeros(batch)
        self._saturated, self._acted = np.zeros(batch), np.zeros(batch)
        self._regret = np.full(batch, np.nan)
        self._messages = np.zeros(batch)

    def record(self, instant: int, state: State) -> None:
        """Measure the distances of ``state``."""
        players = distances.player_distances(state.estimates, self._game)
        players = np.where(state.diverged, self._limit, players)
        strategies = distances.strategy_distance(dynamics.strategies(self.world, state), self._game)
        self._strategy_distance[instant] = np.where(state.diverged, self._limit, strategies)
        self._estimate_distance[instant] = np.sqrt(ordered_sum(players**2) / len(players))
        if instant == self.world.clock.steps:
            consensus = distances.consensus_error(state.estimates, self._game)
            self._consensus_error = np.where(state.diverged, self._limit, consensus)
            if self._game.has_best_response:
                with np.errstate(over="ignore", invalid="ignore"):  # only a diverged environment overflows
                    regrets = np.clip(self._game.regrets(dynamics.strategies(self.world, state)), 0, REWARD_LIMIT)
                self._regret = ordered_sum(np.where(state.diverged, REWARD_LIMIT, regrets))
        if instant in (0, self.world.clock.total_steps):
            self._log_distances.append(ordered_sum(distances.digits(players)) / len(players))

    def spend(self, step: int, state: State, inputs: FloatArray) -> None:
        """Add the effort of a step to the deadline, of the episodes that are still in range."""
        running = ~state.diverged
        clock, limit = self.world.clock, self.world.scenario.input_limit
        theta, dt = clock.theta[step], clock.dt[step]
        sizes = np.abs(inputs)
        sizes *= running
        squared = (sizes**2).sum(axis=(0, 1))
        peak = sizes.max(axis=(0, 1))
        self._input_energy += dt * squared
        np.maximum(self._peak_input, peak, out=self._peak_input)
        if self.world.theta.ndim == 2:  # the players' clocks disagree, and each multiplies by its own Θ
            moves = sizes * (self.world.theta[:, [step]] / theta)
            squared, peak = (moves**2).sum(axis=(0, 1)), moves.max(axis=(0, 1))
        self._velocity_energy += theta**2 / dt * squared
        np.maximum(self._peak_velocity, theta / dt * peak, out=self._peak_velocity)
        # The action box is float32, so an input at the limit may be the float32 just below it.
        self._saturated += (sizes >= np.nextafter(np.float32(limit), np.float32(0))).sum(axis=(0, 1))
        self._acted += running * inputs.shape[0] * inputs.shape[1]
        self._messages += running * (dynamics.weights(self.world, state) > 0).sum(axis=(0, 1))

    def finish(self, state: State, seconds_per_decision: float) -> Rollout:
        """The rollout that ended in ``state``."""
        first, last = self._log_distances
        clock = self.world.clock
        to_deadline = slice(clock.steps + 1)
        log_errors = -distances.digits(self._estimate_distance[to_deadline])
        widths = np.diff(clock.t[to_deadline])[:, None]
        area = ordered_sum(widths * (log_errors[1:] + log_errors[:-1]) / 2)  # the trapezoidal rule
        return Rollout(
            times=clock.t,
            deadline_step=clock.steps,
            strategy_distance=self._strategy_distance,
            estimate_distance=self._estimate_distance,
            consensus_error=self._consensus_error,
            digits_gained=last - first,
            input_energy=self._input_energy,
            velocity_energy=self._velocity_energy,
            peak_input=self._peak_input,
            peak_velocity=self._peak_velocity,
            saturated_share=self._saturated / np.maximum(self._acted, 1),
            diverged=state.diverged,
            seconds_per_decision=seconds_per_decision,
            regret=self._regret,
            log_error_area=area / clock.deadline,
            messages=self._messages,
            bits=self._messages * self._game.dimension * NUMBER_BITS,
        )
