"""What is the next state? One pure transition for every batch size; the only place that advances time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ptne_env import distances
from ptne_env.arrays import BoolArray, FloatArray, IntArray, frozen
from ptne_env.scenario import Scenario
from ptne_env.sources import Sources

RANGE_LIMIT = 5e5
"""An estimate or own gradient outside ±RANGE_LIMIT, or not finite, has diverged."""


class State(NamedTuple):
    """The state of B environments, and what follows from it before anybody acts. Environments last.

    Attributes:
        step: index of the coming step, 0..K+H, shape (B,), int64.
        mode: index of the active graph, shape (B,), int64.
        estimates: x^i in column i, shape (n, N, B); the diagonal blocks are the strategies.
        own_gradients: ∂J_i/∂x_i(x^i), blocks stacked, shape (n, B).
        relative_estimates: x^j − x^i per neighbour slot in float64, 0 where the link is down, shape (D, n, N, B).
        weights: a_ij per neighbour slot, shape (D, N, B), or (D, N, 1) where the graph is fixed.
        diverged: whether the environment has left the range; it stays where it is from then on. Shape (B,).
    """

    step: IntArray
    mode: IntArray
    estimates: FloatArray
    own_gradients: FloatArray
    relative_estimates: FloatArray
    weights: FloatArray
    diverged: BoolArray


class Dynamics:
    """The transition x_{k+1} = x_k + Θ_k u_k with the switching graph and the clock, exact for the held input.

    Attributes:
        scenario: what it simulates.
        game, signal, clock: its parts, built.
        neighbours: player in each slot, shape (D, N); D is the largest degree in the union graph, and a padded slot
            points at the player itself with weight 0.
        mode_weights: a_ij per slot and mode, shape (D, N, modes).
        modes: active mode at each instant, shape (K+H+1,).
        time_since_switch: over the mean dwell, clipped to 1, 0 for a fixed graph; shape (K+H+1,).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.game = scenario.built_game
        self.signal = scenario.built_signal
        self.clock = scenario.built_clock
        n, players = self.game.dimension, self.game.num_players

        union = self.signal.union.adjacency
        degree = int((union > 0).sum(axis=1).max())
        self.neighbours = np.tile(np.arange(players), (degree, 1))
        for player, row in enumerate(union):
            others = np.flatnonzero(row)
            self.neighbours[: others.size, player] = others
        everybody = np.arange(players)
        self.mode_weights = frozen(
            np.stack([graph.adjacency[everybody, self.neighbours] for graph in self.signal.graphs], axis=-1)
        )
        schedule = self.signal.schedule(self.clock.signal_times[self.signal.clock])
        self.modes, self.time_since_switch = schedule.modes, schedule.age

        components = np.arange(n)
        # Rows of estimates.reshape(n N, B): the neighbours' estimates, and everybody's strategies.
        self._neighbour_rows = components[None, :, None] * players + self.neighbours[:, None, :]
        self._strategy_rows = components * players + self.game.owners

    @property
    def slots(self) -> int:
        """D, neighbour slots per player."""
        return self.neighbours.shape[0]

    def draw_estimates(self, sources: Sequence[Sources]) -> FloatArray:
        """Initial estimates, one environment per entry of ``sources``: shape (n, N, B)."""
        start = self.scenario.built_start
        players, dimension = self.game.num_players, self.game.dimension
        return np.stack([start.draw(players, dimension, source.start) for source in sources], axis=-1)

    def start(self, estimates: FloatArray) -> State:
        """The state at t = 0 with the given initial estimates, shape (n, N, B).

        Raises:
            ValueError: when the shape is wrong or an estimate is not finite or outside the range.
        """
        expected = (self.game.dimension, self.game.num_players)
        if estimates.ndim != 3 or estimates.shape[:2] != expected:
            raise ValueError(f"initial estimates have the shape {(*expected, 'B')}, got {estimates.shape}")
        if not np.all(np.abs(estimates) <= RANGE_LIMIT):
            raise ValueError(f"initial estimates must be finite and within ±{RANGE_LIMIT:g}")
        batch = estimates.shape[2]
        estimates = np.array(estimates, dtype=np.float64)  # a copy: the state is not the caller's
        return self._complete(estimates, np.zeros(batch, dtype=np.int64), np.zeros(batch, dtype=np.bool_))

    def step(self, state: State, inputs: FloatArray) -> State:
        """The next state, from held inputs u of shape (n, N, B), finite. ``state`` is left as it was."""
        theta = self.clock.theta[state.step]
        diverged = state.diverged
        if diverged.any():
            theta = np.where(diverged, 0.0, theta)
        estimates = theta * inputs
        estimates += state.estimates
        return self._complete(estimates, np.minimum(state.step + 1, self.clock.total_steps), diverged)

    def strategies(self, state: State) -> FloatArray:
        """The real strategies x, shape (n, B)."""
        return self._rows(state.estimates).take(self._strategy_rows, axis=0)

    def is_over(self, state: State) -> BoolArray:
        """Whether each environment has reached its end or diverged, shape (B,)."""
        return (state.step >= self.clock.total_steps) | state.diverged

    @property
    def distance_limit(self) -> float:
        """The relative distance that is charged to a diverged environment: no estimate in range is farther away."""
        equilibrium = self.game.nash_equilibrium
        corner = RANGE_LIMIT * np.sqrt(self.game.dimension) + np.linalg.norm(equilibrium)
        return float(corner / distances.scale(equilibrium))

    @staticmethod
    def _rows(estimates: FloatArray) -> FloatArray:
        return estimates.reshape(-1, estimates.shape[2])

    def _complete(self, estimates: FloatArray, step: IntArray, diverged: BoolArray) -> State:
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging game may overflow; it is caught below
            gradients = self.game.own_gradients(estimates)
        farthest = np.maximum(np.abs(estimates).max(axis=(0, 1)), np.abs(gradients).max(axis=0))
        in_range = farthest <= RANGE_LIMIT  # False for NaN too
        if not in_range.all():
            diverged = diverged | ~in_range
            estimates = np.clip(np.nan_to_num(estimates, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)
            gradients = np.clip(np.nan_to_num(gradients, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)

        relative = self._rows(estimates).take(self._neighbour_rows, axis=0)
        relative -= estimates
        mode = self.modes[step]
        if self.signal.is_fixed:
            weights = self.mode_weights
        else:
            weights = self.mode_weights.take(mode, axis=2)
            relative *= (weights > 0)[:, None]
        return State(step, mode, estimates, gradients, relative, weights, diverged)
