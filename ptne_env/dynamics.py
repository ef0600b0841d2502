"""What is the next state? One pure transition for every batch size; the only place that advances time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray, IntArray, frozen
from ptne_env.games import Game
from ptne_env.scenario import Scenario
from ptne_env.sources import Sources

RANGE_LIMIT = 5e5
"""An estimate or own gradient outside ±RANGE_LIMIT, or not finite, has diverged."""

Array = TypeVar("Array", FloatArray, IntArray, BoolArray)


class State:
    """The state of B environments, and what follows from it before anybody acts. Environments last; never changed.

    Attributes:
        step: index of the coming step, 0..K+H, shape (B,), int64.
        game: the games being played, one for all or one per environment.
        estimates: x^i in column i, shape (n, N, B); the diagonal blocks are the strategies.
        own_gradients: ∂J_i/∂x_i(x^i), blocks stacked, shape (n, B).
        diverged: whether the environment has left the range; it stays where it is from then on. Shape (B,).
        any_diverged: whether any of them has.
    """

    __slots__ = (
        "_dynamics",
        "_instants",
        "_relative",
        "_weights",
        "any_diverged",
        "diverged",
        "estimates",
        "game",
        "own_gradients",
        "step",
    )

    def __init__(
        self,
        dynamics: Dynamics,
        step: IntArray,
        game: Game,
        estimates: FloatArray,
        own_gradients: FloatArray,
        diverged: BoolArray,
    ) -> None:
        self._dynamics = dynamics
        self._instants: IntArray | None = None
        self._relative: FloatArray | None = None
        self._weights: FloatArray | None = None
        self.step = step
        self.game = game
        self.estimates = estimates
        self.own_gradients = own_gradients
        self.diverged = diverged
        self.any_diverged = np.count_nonzero(diverged) > 0

    @property
    def batch_size(self) -> int:
        """B."""
        return self.estimates.shape[2]

    @property
    def instants(self) -> IntArray:
        """``step``, but one entry for environments in lockstep, the usual case: shape (1,) or (B,)."""
        if self._instants is None:
            step = self.step
            in_lockstep = step.size == 1 or np.count_nonzero(step != step[0]) == 0
            self._instants = step[:1] if in_lockstep else step
        return self._instants

    @property
    def mode(self) -> IntArray:
        """Index of the active graph, shape (B,), int64."""
        return self._dynamics.modes[self.step]

    @property
    def weights(self) -> FloatArray:
        """a_ij per neighbour slot, shape (D, N, B), or (D, N, 1) where all environments have the same."""
        if self._weights is None:
            table = self._dynamics.mode_weights
            self._weights = table if table.shape[2] == 1 else table.take(self._dynamics.modes[self.instants], axis=2)
        return self._weights

    @property
    def relative_estimates(self) -> FloatArray:
        """x^j − x^i per neighbour slot in float64, 0 where the link is down, shape (D, n, N, B)."""
        if self._relative is None:
            self._relative = self._dynamics.relative_estimates(self)
        return self._relative

    @property
    def strategies(self) -> FloatArray:
        """The real strategies x, shape (n, B)."""
        return _rows(self.estimates).take(self._dynamics.strategy_rows, axis=0)


class Dynamics:
    """The transition x_{k+1} = x_k + Θ_k u_k with the switching graph and the clock, exact for the held input.

    Where a box confines the strategies, the players' own blocks of x_k + Θ_k u_k, and of x_0, are projected into it.

    Attributes:
        scenario: what it simulates.
        game: the game, or a typical member of the family; states hold the games that are played.
        signal, clock: the other parts, built.
        neighbours: player in each slot, shape (D, N); D is the largest degree in the union graph, and a padded slot
            points at the player itself with weight 0.
        mode_weights: a_ij per slot and mode, shape (D, N, modes).
        modes: active mode at each instant, shape (K+H+1,).
        time_since_switch: over the mean dwell, clipped to 1, 0 for a fixed graph; shape (K+H+1,).
        strategy_rows: rows of estimates.reshape(n N, B) that are strategies, shape (n,).
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
        # Looking up an instant's successor costs one environment a quarter of computing it.
        instants, last = np.arange(self.clock.total_steps + 1), self.clock.total_steps
        self._next_step, self._finished = np.minimum(instants + 1, last), instants >= last

        components = np.arange(n)
        self._neighbour_rows = components[None, :, None] * players + self.neighbours[:, None, :]
        self.strategy_rows = components * players + self.game.owners

    @property
    def slots(self) -> int:
        """D, neighbour slots per player."""
        return self.neighbours.shape[0]

    def draw_game(self, sources: Sequence[Sources]) -> Game:
        """The games of an episode, one environment per entry of ``sources``."""
        return self.scenario.built_family.draw([source.game for source in sources])

    def draw_estimates(self, sources: Sequence[Sources]) -> FloatArray:
        """Initial estimates, one environment per entry of ``sources``: shape (n, N, B)."""
        start = self.scenario.built_start
        players, dimension = self.game.num_players, self.game.dimension
        return np.stack([start.draw(players, dimension, source.start) for source in sources], axis=-1)

    def start(self, estimates: FloatArray, game: Game | None = None) -> State:
        """The state at t = 0.

        Args:
            estimates: initial, shape (n, N, B); strategies outside the game's box are projected into it.
            game: what is played, one game or B; needed where the scenario draws games.

        Raises:
            ValueError: when a shape is wrong, an estimate is not finite or outside the range, or the game is missing.
        """
        expected = (self.game.dimension, self.game.num_players)
        if estimates.ndim != 3 or estimates.shape[:2] != expected:
            raise ValueError(f"initial estimates have the shape {(*expected, 'B')}, got {estimates.shape}")
        if not np.all(np.abs(estimates) <= RANGE_LIMIT):
            raise ValueError(f"initial estimates must be finite and within ±{RANGE_LIMIT:g}")
        batch = estimates.shape[2]
        if game is None:
            if self.scenario.has_random_game:
                raise ValueError(f"scenario {self.scenario.name!r} draws games: pass the ones to play, see draw_game()")
            game = self.game
        if game.batch_size not in (1, batch) or game.action_dims != self.game.action_dims:
            raise ValueError(f"{batch} environments need one game or {batch}, got {game.batch_size}")
        estimates = np.array(estimates, dtype=np.float64)  # a copy: the state is not the caller's
        self._confine(estimates, game)
        return self._complete(estimates, game, np.zeros(batch, dtype=np.int64), np.zeros(batch, dtype=np.bool_))

    def step(self, state: State, inputs: FloatArray) -> State:
        """The next state, from held inputs u of shape (n, N, B), finite. ``state`` is left as it was."""
        theta = self.clock.theta[state.instants]
        if state.any_diverged:
            theta = np.where(state.diverged, 0.0, theta)
        estimates = theta * inputs
        estimates += state.estimates
        self._confine(estimates, state.game)
        return self._complete(estimates, state.game, self._next_step[state.step], state.diverged)

    def merge(self, state: State, fresh: State, mask: BoolArray) -> State:
        """``state`` with the environments in ``mask`` (B,) replaced by those of ``fresh``, in order."""

        def replaced(old: Array, new: Array) -> Array:
            result = old.copy()
            result[..., mask] = new
            return result

        return State(
            self,
            replaced(state.step, fresh.step),
            state.game.merged(fresh.game, mask),
            replaced(state.estimates, fresh.estimates),
            replaced(state.own_gradients, fresh.own_gradients),
            replaced(state.diverged, fresh.diverged),
        )

    def relative_estimates(self, state: State) -> FloatArray:
        """x^j − x^i per neighbour slot in float64, 0 where the link is down, shape (D, n, N, B)."""
        relative = _rows(state.estimates).take(self._neighbour_rows, axis=0)
        relative -= state.estimates
        if not self.signal.is_fixed:
            relative *= (state.weights > 0)[:, None]
        return relative

    def is_over(self, state: State) -> BoolArray:
        """Whether each environment has reached its end or diverged, shape (B,)."""
        finished = self._finished[state.step]
        return finished | state.diverged if state.any_diverged else finished

    @staticmethod
    def distance_limit(game: Game) -> FloatArray:
        """The relative distance charged to a diverged environment, no less than any in range; shape (G,)."""
        return (RANGE_LIMIT * np.sqrt(game.dimension) + game.equilibrium_scale) / game.equilibrium_scale

    def _confine(self, estimates: FloatArray, game: Game) -> None:
        """Project the real strategies into the game's box, in place; what players think of others stays."""
        if game.has_bounds:
            own = np.arange(game.dimension), game.owners
            estimates[own] = game.project(estimates[own])

    def _complete(self, estimates: FloatArray, game: Game, step: IntArray, diverged: BoolArray) -> State:
        if game.is_affine:
            gradients = game.own_gradients(estimates)
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # a diverging game may overflow; it is caught below
                gradients = game.own_gradients(estimates)
        if not (_in_range(estimates) and _in_range(gradients)):
            farthest = np.maximum(np.abs(estimates).max(axis=(0, 1)), np.abs(gradients).max(axis=0))
            diverged = diverged | ~(farthest <= RANGE_LIMIT)
            estimates = np.clip(np.nan_to_num(estimates, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)
            gradients = np.clip(np.nan_to_num(gradients, nan=RANGE_LIMIT), -RANGE_LIMIT, RANGE_LIMIT)
        return State(self, step, game, estimates, gradients, diverged)


def _rows(estimates: FloatArray) -> FloatArray:
    return estimates.reshape(-1, estimates.shape[2])


def _in_range(array: FloatArray) -> bool:
    """Whether every entry is a number within ±RANGE_LIMIT."""
    flat = array.reshape(-1)
    # Σ x² ≤ limit² is enough, costs one pass and is False for NaN. (einsum and not dot: BLAS would wake its threads.)
    if np.einsum("i,i->", flat, flat) <= RANGE_LIMIT**2:
        return True
    return bool(np.maximum.reduce(flat) <= RANGE_LIMIT and np.minimum.reduce(flat) >= -RANGE_LIMIT)
