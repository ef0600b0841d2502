"""Running a policy through a batch of episodes, and keeping what the metrics need."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from ptne_env import distances
from ptne_env.arrays import BoolArray, FloatArray, ordered_sum
from ptne_env.dynamics import Dynamics, State
from ptne_env.interface import Port
from ptne_env.policy import Policy


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


def rollout(policy: Policy, port: Port, start: State) -> Rollout:
    """Run ``policy`` from the state ``start`` at t = 0 to the end of every episode.

    The policy is asked with ``deterministic=True`` and its memory is passed back to it unread.

    Raises:
        ValueError: when the policy answers with actions of another shape, or with ones that are not finite.
    """
    dynamics = port.dynamics
    clock, players, batch = dynamics.clock, dynamics.game.num_players, start.batch_size
    recorder = _Recorder(dynamics, start)
    state = start
    recorder.record(0, state)
    memory = None
    episode_start = np.ones(players * batch, dtype=np.bool_)
    seconds = 0.0
    for step in range(clock.total_steps):
        observations = port.observe(state).reshape(players * batch, -1)
        started = perf_counter()
        actions, memory = policy.predict(observations, memory, episode_start, deterministic=True)
        seconds += perf_counter() - started
        episode_start = np.zeros_like(episode_start)
        inputs = port.decode(_checked(np.asarray(actions), port, batch), state).inputs
        if step < clock.steps:
            recorder.spend(step, inputs, ~state.diverged)
        state = dynamics.step(state, inputs)
        recorder.record(step + 1, state)
    return recorder.finish(state, seconds / (clock.total_steps * players * batch))


def _checked(actions: FloatArray, port: Port, batch: int) -> FloatArray:
    shape = (batch, port.dynamics.game.num_players, port.layout.action_size)
    if actions.shape != (shape[0] * shape[1], shape[2]):
        raise ValueError(
            f"the policy answered {shape[0] * shape[1]} observations with actions of shape {actions.shape}; expected "
            f"{(shape[0] * shape[1], shape[2])}"
        )
    if not np.isfinite(actions).all():
        raise ValueError("the policy answered with an action that is not finite; expected numbers without NaN or inf")
    return actions.reshape(shape)


class _Recorder:
    """Collects a rollout as it happens, so that trajectories need not be kept."""

    def __init__(self, dynamics: Dynamics, start: State) -> None:
        self.dynamics = dynamics
        batch = start.batch_size
        self._game = start.game
        self._limit = dynamics.distance_limit(start.game)
        instants = dynamics.clock.total_steps + 1
        self._strategy_distance = np.empty((instants, batch))
        self._estimate_distance = np.empty((instants, batch))
        self._consensus_error = np.zeros(batch)
        self._log_distances: list[FloatArray] = []
        self._input_energy, self._velocity_energy = np.zeros(batch), np.zeros(batch)
        self._peak_input, self._peak_velocity = np.zeros(batch), np.zeros(batch)
        self._saturated, self._acted = np.zeros(batch), np.zeros(batch)

    def record(self, instant: int, state: State) -> None:
        """Measure the distances of ``state``."""
        players = distances.player_distances(state.estimates, self._game)
        players = np.where(state.diverged, self._limit, players)
        strategies = distances.strategy_distance(state.strategies, self._game)
        self._strategy_distance[instant] = np.where(state.diverged, self._limit, strategies)
        self._estimate_distance[instant] = np.sqrt(ordered_sum(players**2) / len(players))
        if instant == self.dynamics.clock.steps:
            consensus = distances.consensus_error(state.estimates, self._game)
            self._consensus_error = np.where(state.diverged, self._limit, consensus)
        if instant in (0, self.dynamics.clock.total_steps):
            self._log_distances.append(ordered_sum(distances.digits(players)) / len(players))

    def spend(self, step: int, inputs: FloatArray, running: BoolArray) -> None:
        """Add the effort of a step to the deadline, of the episodes that are ``running``."""
        clock, limit = self.dynamics.clock, self.dynamics.scenario.input_limit
        theta, dt = clock.theta[step], clock.dt[step]
        sizes = np.abs(inputs)
        sizes *= running
        squared = (sizes**2).sum(axis=(0, 1))
        peak = sizes.max(axis=(0, 1))
        self._input_energy += dt * squared
        np.maximum(self._peak_input, peak, out=self._peak_input)
        if self.dynamics.theta.ndim == 2:  # the players' clocks disagree, and each multiplies by its own Θ
            moves = sizes * (self.dynamics.theta[:, [step]] / theta)
            squared, peak = (moves**2).sum(axis=(0, 1)), moves.max(axis=(0, 1))
        self._velocity_energy += theta**2 / dt * squared
        np.maximum(self._peak_velocity, theta / dt * peak, out=self._peak_velocity)
        # The action box is float32, so an input at the limit may be the float32 just below it.
        self._saturated += (sizes >= np.nextafter(np.float32(limit), np.float32(0))).sum(axis=(0, 1))
        self._acted += running * inputs.shape[0] * inputs.shape[1]

    def finish(self, state: State, seconds_per_decision: float) -> Rollout:
        """The rollout that ended in ``state``."""
        first, last = self._log_distances
        return Rollout(
            times=self.dynamics.clock.t,
            deadline_step=self.dynamics.clock.steps,
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
        )
