"""The switch between numpy and the compiled step of :mod:`ptne_env.world.kernels`, whose numbers are the same.

Nothing depends on the switch but the time. The compiled step needs the extra ``pip install "ptne-env[fast]"``, and runs
where a world :func:`qualifies`. It is loaded after the steps that it could have made have taken as long as the load.
"""

from __future__ import annotations

import warnings
from functools import cache
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ptne_env.games import AffineGame, EnergyGame, Game
from ptne_env.perception.encoder import Encoder, PhysicalEncoder
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.world import RANGE_LIMIT, EpisodeRandomness

PATIENCE = 0.3
"""Seconds of numpy steps before numba is loaded, which takes about as long, so that a short run never waits for it."""

LARGEST_ALONE, LARGEST_TOGETHER = 5_000, 200_000
"""Most relative estimates D n N with which one environment, or each of several, is stepped faster than by numpy."""

_TILE, _TILE_ENTRIES = 64, 8192
"""Largest number of environments in a tile, and of estimates n N times environments: its numbers stay in a cache."""

_Arrays: TypeAlias = tuple[npt.NDArray[Any], ...]

_SINGLE = np.dtype(np.float32)

_spent = 0.0
"""Seconds so far; minus infinity keeps numpy for good."""


def spend(seconds: float) -> bool:
    """Count the time of a step that numpy made in a world that qualifies; whether later steps may be compiled."""
    global _spent  # noqa: PLW0603 - of the whole process, as a loaded module is
    _spent += seconds
    return _spent > -np.inf and (_spent < PATIENCE or _load() is not None)


def kernels() -> ModuleType | None:
    """The compiled functions, if they are worth their load, or ``None``."""
    return None if _spent < PATIENCE else _load()


@cache
def _load() -> ModuleType | None:
    """The compiled functions; ``None`` where numba is not installed, and with a warning where it is broken."""
    try:
        from numba import config

        if config.DISABLE_JIT:  # numba's switch for debugging, with which a step would take a thousand times as long
            return None
        from ptne_env.world import kernels as compiled

        compiled.is_inside(np.zeros((1, 1, 1), dtype=np.float32), 1.0)
    except ModuleNotFoundError as error:
        if error.name != "numba":
            _refuse(error)
        return None
    except Exception as error:  # noqa: BLE001 - a broken package may raise anything
        _refuse(error)
        return None
    return compiled


def _refuse(reason: Exception | str) -> None:
    """Keep numpy for all steps from here on, and warn."""
    global _spent  # noqa: PLW0603
    _spent = -np.inf
    if isinstance(reason, Exception):
        reason = f"{type(reason).__name__}: {reason}"
    message = f"the compiled step is left out, and numpy makes all steps, because numba does not work here: {reason}"
    warnings.warn(message, RuntimeWarning, stacklevel=2)


def qualifies(encoder: Encoder, num_envs: int) -> bool:
    """Whether a number of environments of a world, under an interface, have a compiled step.

    They have one in worlds that are not too large, without channel and disturbance, for games whose own
    gradients are those of :class:`~ptne_env.games.AffineGame` or :class:`~ptne_env.games.EnergyGame`, under
    ``physical``.
    """
    world = encoder.world
    return (
        type(encoder) is PhysicalEncoder
        and world.channel.is_perfect
        and world.disturbance is None
        and world.slots * encoder.layout.dimension * encoder.layout.num_players
        <= (LARGEST_ALONE if num_envs == 1 else LARGEST_TOGETHER)
        and _is_known(world.game)
    )


def _is_known(game: Game) -> bool:
    """Whether the kernels hold the formulas of a game, which a subclass may have changed."""
    kind = type(game)
    return kind.own_gradients in (AffineGame.own_gradients, EnergyGame.own_gradients) and kind.project is Game.project


class FusedStep:
    """The compiled step of environments of one world under ``physical``, and the state that it has reached.

    A step is decoding, transition, distances and observation in one pass. States stand in two sets of arrays that take
    turns, and become a :class:`~ptne_env.world.dynamics.State` when it is asked for.

    Args:
        encoder: of a world that :func:`qualifies`.
        num_envs: B.
    """

    def __init__(self, encoder: Encoder, num_envs: int) -> None:
        self._encoder = encoder
        world, layout = encoder.world, encoder.layout
        theta = world.clock.theta[None]
        self._schedule = world.modes[:, None].astype(np.int16), encoder.clock_table[4, 0][:, None].copy()
        rows, padded = encoder.gradient_rows, encoder.gradient_mask
        mask = np.ones(rows.shape) if padded is None else padded[:, :, 0]
        places = np.concatenate([world.neighbours, rows, mask]).astype(np.int64)
        # Copies, because numba compiles a function once more for arrays that are read-only or in another order.
        tables = (table.copy() for table in (theta, encoder.clock_table, world.mode_weights, world.game.owners))
        self._tables = (*tables, places, layout.action_bound, RANGE_LIMIT)
        self._shape = layout.dimension, layout.num_players, num_envs
        self._tile = min(_TILE, max(8, _TILE_ENTRIES // (layout.dimension * layout.num_players)), num_envs)
        self._constants: tuple[Any, ...] = ()
        self._is_checked = False
        self._game: Game | None = None
        self._draws: EpisodeRandomness | None = None
        self._diverged = np.zeros(0, dtype=np.bool_)
        self._now: _Arrays = ()
        self._sets: list[_Arrays] = []

    def move(
        self, state: State | None, actions: npt.NDArray[np.floating], out: Float32Array
    ) -> tuple[IntArray, FloatArray, BoolArray] | None:
        """Make a step, and write the observations of the next state.

        Args:
            state: x_k, which is left as it is; ``None`` for the state that the step before has reached.
            actions: shape (B, N, n); rounded to float32.
            out: where to write, shape (B, N, size), C-contiguous.

        Returns:
            For each environment the index of the coming step, shape (B,); d^i of every player, shape (N, B) with
            players next to each other in memory; and whether the episode has reached its end, shape (B,). The step
            after the next overwrites them. ``None`` where numpy has to make the step, because no state is there yet,
            the kernels are not loaded, an action is outside the action box, an environment is out of range, or a drawn
            game has formulas of its own; nothing has changed then, except the content of ``out``.
        """
        compiled = kernels()
        if compiled is None or not (self._now if state is None else self._load(state)):
            return None
        if actions.dtype is not _SINGLE or not actions.flags.carray:  # read-only arrays are another type to numba
            actions = np.array(actions, dtype=np.float32, order="C")
        step = compiled.step if self._is_checked else self._first_step
        after = self._sets[0]
        if not step(actions, out, *self._now, *after, *self._constants):
            return None
        if state is not None and not (self._is_checked or self._is_confirmed(state, after, actions, out)):
            return None
        instants, estimates, _, distance, is_last = after
        self._now = instants, estimates
        self._sets.reverse()
        return instants, distance.T, is_last

    def hand_over(self) -> State | None:
        """The state that the last step has reached, whose arrays no step will change; ``None`` before the first."""
        if self._game is None:
            return None
        instants, estimates, gradients, *_ = self._sets[1]
        self._sets[1] = self._new_arrays()
        return State(instants, self._game, estimates, gradients, self._diverged, randomness=self._draws)

    def _load(self, state: State) -> bool:
        """Start from a state; ``False`` where numpy has to make the step."""
        game, draws = state.game, state.randomness
        if state.any_diverged:
            return False
        if game is not self._game or draws is not self._draws:
            if not _is_known(game):
                return False
            self._game, self._draws = game, draws
            graphs = self._schedule
            if draws is not None and draws.modes is not None and draws.time_since_switch is not None:
                graphs = draws.modes, draws.time_since_switch
            self._constants = *graphs, *self._read(game), *self._tables
        self._diverged = state.diverged
        self._now = tuple(np.require(array, requirements=["C", "A", "W"]) for array in (state.step, state.estimates))
        self._sets = self._sets or [self._new_arrays(), self._new_arrays()]
        return True

    def _new_arrays(self) -> _Arrays:
        """Memory for the instants and estimates of a state, and the own gradients, d^i and ends of a step."""
        n, players, batch = self._shape
        gradients, distance = np.empty((n, batch)), np.empty((batch, players))
        return np.empty(batch, np.int64), np.empty(self._shape), gradients, distance, np.empty(batch, np.bool_)

    def _first_step(self, *arguments: Any) -> bool:
        """The first step, or ``False`` and a warning where it cannot be compiled."""
        from ptne_env.world.kernels import step

        try:
            return bool(step(*arguments))
        except Exception as error:  # noqa: BLE001 - a broken compiler, or a full disk, may raise anything
            _refuse(error)
            return False

    def _read(self, game: Game) -> tuple[Any, ...]:
        """The numbers of the games, as the step takes them."""
        box = [] if game.low is None or game.high is None else [game.low, game.high]
        tables = [game.nash_equilibria, game.equilibrium_scale[None], *box]
        if isinstance(game, AffineGame):
            tables += [game.transposed.reshape(-1, game.transposed.shape[-1]), game.offset]
        elif isinstance(game, EnergyGame):
            tables += [np.broadcast_to(game.coupling, (1, game.batch_size)), game.slope, game.intercept]
        columns = self._tile if game.batch_size == 1 else self._shape[2]  # one per environment, or a tile of the same
        table = np.concatenate([np.broadcast_to(rows, (len(rows), columns)) for rows in tables])
        return table, 2 * game.dimension if box else 0, isinstance(game, AffineGame), self._tile

    def _is_confirmed(
        self, before: State, after: _Arrays, actions: npt.NDArray[np.floating], observed: Float32Array
    ) -> bool:
        """Whether numpy comes to the same bits here: nothing is assumed of processors and compilers."""
        self._is_checked, encoder = True, self._encoder
        expected = dynamics.step(encoder.world, before, encoder.inputs(actions, before))
        numpys: _Arrays = expected.step, expected.estimates, expected.own_gradients, encoder.observe(expected)
        agrees = all(a.tobytes() == b.tobytes() for a, b in zip((*after[:3], observed), numpys, strict=True))
        if not agrees:
            _refuse("its numbers are not those of numpy")
        return agrees
