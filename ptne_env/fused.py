"""The switch between numpy and the compiled step of :mod:`ptne_env.kernels`, whose numbers are the same bit for bit.

Nothing depends on the switch but the time. The compiled step needs the extra ``pip install "ptne-env[fast]"``, and runs
where a world :func:`qualifies`. It is loaded after the steps that it could have made have taken as long as the load.
"""

from __future__ import annotations

import warnings
from functools import cache
from types import ModuleType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptne_env import dynamics
from ptne_env.arrays import Float32Array, FloatArray
from ptne_env.dynamics import State
from ptne_env.encoder import Encoder, LocalEncoder, PhysicalEncoder
from ptne_env.games import AffineGame, EnergyGame, Game

PATIENCE = 0.3
"""Seconds of numpy steps before numba is loaded, which takes about as long, so that a short run never waits for it."""

_TILE, _TILE_ENTRIES = 64, 8192
"""Largest number of environments in a tile, and of estimates n N times environments: its numbers stay in a cache."""

_spent = 0.0
"""Seconds so far; minus infinity keeps numpy for good."""


def spend(seconds: float) -> None:
    """Count the time of a step that numpy made in a world that qualifies."""
    global _spent  # noqa: PLW0603 - of the whole process, as a loaded module is
    _spent += seconds


def kernels() -> ModuleType | None:
    """The compiled functions, if they are worth their load, or ``None``."""
    return None if _spent < PATIENCE else _load()


@cache
def _load() -> ModuleType | None:
    """The compiled functions; ``None`` where numba is not installed, and with a warning where it is broken."""
    try:
        from numba import config
    except ModuleNotFoundError as error:
        return None if error.name == "numba" else _refuse(error)
    except Exception as error:  # noqa: BLE001 - a broken package may raise anything
        return _refuse(error)
    if config.DISABLE_JIT:  # a switch of numba for debugging: loops of Python would take a thousand times as long
        return None
    try:
        from ptne_env import kernels as compiled

        compiled.is_inside(np.zeros((1, 1, 1), dtype=np.float32), 1.0)
    except Exception as error:  # noqa: BLE001
        return _refuse(error)
    return compiled


def _refuse(reason: object) -> None:
    """Keep numpy for all steps from here on, and warn."""
    global _spent  # noqa: PLW0603
    _spent = -np.inf
    message = f"the compiled step is left out, and numpy makes all steps, because numba does not work here: {reason}"
    warnings.warn(message, RuntimeWarning, stacklevel=2)


def qualifies(encoder: Encoder) -> bool:
    """Whether a world and an interface have a compiled step.

    They have one without channel, disturbance, sensor and drift, for games whose own gradients are those of
    :class:`~ptne_env.games.AffineGame` or :class:`~ptne_env.games.EnergyGame`, under ``physical`` and ``local`` with
    actions as inputs and without ``own_payoff``.
    """
    world, interface = encoder.world, encoder.interface
    return (
        type(encoder) in (PhysicalEncoder, LocalEncoder)
        and interface.action_mode == "input"
        and not interface.own_payoff
        and world.channel.is_perfect
        and world.disturbance.is_absent
        and world.sensor is None
        and world.drift is None
        and _is_known(world.game)
    )


def _is_known(game: Game) -> bool:
    """Whether the kernels hold the formulas of a game, which a subclass may have changed."""
    kind = type(game)
    return (
        kind.own_gradients in (AffineGame.own_gradients, EnergyGame.own_gradients)
        and kind.project is Game.project
        and kind.nearest_equilibria is Game.nearest_equilibria
        and game.other_equilibria is None
    )


class Moved(NamedTuple):
    """The result of a compiled step.

    Attributes:
        state: x_{k+1}.
        distances: d^i of every player, shape (N, B), as :func:`ptne_env.distances.player_distances`.
    """

    state: State
    distances: FloatArray


class FusedStep:
    """The compiled step of one world and interface: decoding, transition, distances and observation in one pass.

    Args:
        encoder: of a world that :func:`qualifies`.
    """

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        world, layout = encoder.world, encoder.layout
        n, players = layout.dimension, layout.num_players
        order = layout.ego_order if isinstance(encoder, LocalEncoder) else np.tile(np.arange(n), (players, 1))
        theta = world.theta.reshape(-1, world.theta.shape[-1])
        # Copies, because numba compiles a function once more for arrays that are read-only.
        self._clocks = theta.copy(), encoder.clock_table.copy()
        self._schedule = world.modes[:, None].astype(np.int16), encoder.clock_table[4, 0][:, None].copy()
        self._links = world.mode_weights.copy(), world.neighbours.copy()
        rows, mask = encoder.gradient_rows, encoder.gradient_mask
        mask = np.ones(rows.shape) if mask is None else mask[:, :, 0].astype(np.float64)
        self._order = world.game.owners.copy(), order.copy(), rows.copy(), mask
        self._limits = layout.input_limit, layout.interface.action_scale
        self._largest_tile = min(_TILE, max(8, _TILE_ENTRIES // (n * players)))
        self._log_scale = layout.slices.get("log_scale", slice(0))
        self._none = np.empty((0, 0))
        self._game: Game | None = None
        self._batch, self._tile = 0, 0
        self._numbers: tuple[FloatArray, ...] = ()
        self._knows_game = self._is_checked = False

    def __call__(
        self, state: State, actions: npt.NDArray[np.floating], out: Float32Array, *, has_constants: bool = False
    ) -> Moved | None:
        """Make a step, and write the observations of the next state.

        Args:
            state: x_k; left as it is.
            actions: finite and within the action box, shape (B, N, n).
            out: where to write, shape (B, N, size), C-contiguous.
            has_constants: whether ``out`` holds the one-hots already.

        Returns:
            ``None`` where numpy has to make the step: the kernels are not loaded, an environment is out of range, or a
            drawn game has formulas of its own. Nothing has changed then, except the content of ``out``.
        """
        compiled = kernels()
        if compiled is None or state.any_diverged or not self._read(state.game, state.step.size):
            return None
        encoder, (n, players, batch), draws = self.encoder, state.estimates.shape, state.randomness
        is_local = isinstance(encoder, LocalEncoder)
        schedule = self._schedule
        if draws is not None and draws.modes is not None and draws.time_since_switch is not None:
            schedule = draws.modes, draws.time_since_switch
        old, step, new = np.ascontiguousarray(state.estimates), np.empty(batch, dtype=np.int64), np.empty((n, players, batch))
        gradients, distance = np.empty((n, batch)), np.empty((players, batch))
        sigma, next_sigma = (encoder.scale(state), np.empty((players, batch))) if is_local else (self._none, self._none)
        in_range = compiled.step(
            old, state.step, np.ascontiguousarray(actions, dtype=np.float32), sigma, *self._numbers, *self._clocks,
            *schedule, *self._links, *self._order, *self._limits, step, new, gradients, distance, next_sigma, out,
            has_constants, self._tile,
        )  # fmt: skip
        if not in_range:
            return None
        moved = Moved(State(step, state.game, new, gradients, state.diverged, False, draws), distance)
        if is_local:
            out[:, :, self._log_scale] = np.log10(next_sigma).T[:, :, None]
        if not self._is_checked:
            self._is_checked = True
            if not self._agrees(moved, state, actions, out):
                return _refuse("its numbers are not those of numpy")
        if is_local:
            encoder.remember_scale(moved.state, next_sigma)
        return moved

    def _read(self, game: Game, batch: int) -> bool:
        """Read the numbers of a game; whether the kernels hold its formulas."""
        if game is self._game and batch == self._batch:
            return self._knows_game
        self._game, self._batch, self._knows_game = game, batch, _is_known(game)
        self._tile = tile = min(self._largest_tile, batch)
        if not self._knows_game:
            return False

        def columns(table: FloatArray) -> FloatArray:
            return np.repeat(table, tile if table.shape[-1] == 1 else 1, axis=-1)

        nothing = np.empty((0, tile))
        if isinstance(game, EnergyGame):
            coupling = np.broadcast_to(game.coupling, (1, game.batch_size))
            formula = np.empty((0, 0, tile)), columns(coupling), columns(game.slope), columns(game.intercept)
        else:
            formula = columns(game.transposed), nothing, nothing, columns(game.offset)
        box = (nothing, nothing) if game.low is None or game.high is None else (columns(game.low), columns(game.high))
        self._numbers = *formula, *box, columns(game.nash_equilibria), columns(game.equilibrium_scale[None])
        return True

    def _agrees(self, moved: Moved, before: State, actions: npt.NDArray[np.floating], observed: Float32Array) -> bool:
        """Whether numpy comes to the same bits: the processor and the versions of compilers are not ours."""
        encoder = self.encoder
        expected = dynamics.step(encoder.world, before, encoder.inputs(actions, before))
        pairs = (
            (moved.state.step, expected.step),
            (moved.state.estimates, expected.estimates),
            (moved.state.own_gradients, expected.own_gradients),
            (observed, encoder.observe(expected)),
        )
        return all(ours.tobytes() == numpys.tobytes() for ours, numpys in pairs)
