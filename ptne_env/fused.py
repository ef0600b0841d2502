"""The switch between numpy and the compiled step of :mod:`ptne_env.kernels`, whose numbers are the same bit for bit.

Nothing depends on the switch but the time. The compiled step needs the extra ``pip install "ptne-env[fast]"``, and runs
where a world :func:`qualifies`. It is loaded after the steps that it could have made have taken as long as the load.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env import dynamics
from ptne_env.arrays import BoolArray, Float32Array, FloatArray
from ptne_env.dynamics import State
from ptne_env.encoder import Encoder, LocalEncoder, PhysicalEncoder
from ptne_env.games import AffineGame, EnergyGame, Game
from ptne_env.observation import SMALLEST_SCALE
from ptne_env.world import RANGE_LIMIT, EpisodeRandomness

PATIENCE = 0.3
"""Seconds of numpy steps before numba is loaded, which takes about as long, so that a short run never waits for it."""

LARGEST_ALONE, LARGEST_TOGETHER = 5_000, 200_000
"""Most relative estimates D n N with which one environment, or each of several, is stepped faster than by numpy."""

_TILE, _TILE_ENTRIES = 64, 8192
"""Largest number of environments in a tile, and of estimates n N times environments: its numbers stay in a cache."""

_SINGLE, _ANY = np.dtype(np.float32), float(np.inf)

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
        from ptne_env import kernels as compiled

        _first_call(compiled.is_inside, np.zeros((1, 1, 1), dtype=np.float32), 1.0)
    except ModuleNotFoundError as error:
        if error.name != "numba":
            _refuse(error)
        return None
    except Exception as error:  # noqa: BLE001 - a broken package may raise anything
        _refuse(error)
        return None
    return compiled


def _first_call(function: Callable[..., bool], *arguments: Any) -> bool:
    """The result of a compiled function, although the disk may be full: it is compiled before it is written."""
    with suppress(OSError):
        return function(*arguments)
    return function(*arguments)


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

    They have one in worlds that are not too large, without channel, disturbance, sensor and drift, for games whose own
    gradients are those of :class:`~ptne_env.games.AffineGame` or :class:`~ptne_env.games.EnergyGame`, under
    ``physical`` and ``local`` with actions as inputs and without ``own_payoff``.
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
        and world.slots * encoder.layout.dimension * encoder.layout.num_players
        <= (LARGEST_ALONE if num_envs == 1 else LARGEST_TOGETHER)
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


class FusedStep:
    """The compiled step of one world and interface: decoding, transition, distances and observation in one pass.

    Args:
        encoder: of a world that :func:`qualifies`.
    """

    def __init__(self, encoder: Encoder) -> None:
        self._encoder = encoder
        self._local = encoder if isinstance(encoder, LocalEncoder) else None
        world, layout = encoder.world, encoder.layout
        n, players = layout.dimension, layout.num_players
        theta, ages = world.theta.reshape(-1, world.theta.shape[-1]), encoder.clock_table[4, 0]
        self._schedule = world.modes[:, None].astype(np.int16), ages[:, None].copy()
        rows, padded = encoder.gradient_rows, encoder.gradient_mask
        mask = np.ones(rows.shape) if padded is None else padded[:, :, 0]
        order = np.tile(np.arange(n), (players, 1)) if self._local is None else layout.ego_order
        places = np.concatenate([world.neighbours, rows, mask, order.T]).astype(np.int64)
        # Copies, because numba compiles a function once more for arrays that are read-only or in another order.
        self._tables = (
            *(table.copy() for table in (theta, encoder.clock_table, world.mode_weights, world.game.owners)),
            places,
            layout.input_limit,
            layout.interface.action_scale,
            SMALLEST_SCALE,
            RANGE_LIMIT,
        )
        self._bound = layout.action_bound
        self._largest_tile = min(_TILE, max(8, _TILE_ENTRIES // (n * players)))
        self._log_scale = layout.slices.get("log_scale", slice(0)).start
        self._none = np.empty((0, 0))
        self._game: Game | None = None
        self._constants: tuple[Any, ...] = ()
        self._is_checked = False

    def accepts(self, actions: npt.NDArray[np.floating]) -> bool:
        """Whether all actions (B, N, n) are finite and within the box; ``False`` too where only numpy can tell."""
        compiled = kernels()
        if compiled is None or actions.dtype != np.float32 or not actions.flags.c_contiguous:
            return False
        return compiled.is_inside(actions, self._bound)

    def __call__(
        self,
        state: State,
        actions: npt.NDArray[np.floating],
        out: Float32Array,
        *,
        has_constants: bool = False,
        are_inside: bool = True,
    ) -> tuple[State, FloatArray, BoolArray] | None:
        """Make a step, and write the observations of the next state.

        Args:
            state: x_k; left as it is.
            actions: shape (B, N, n).
            out: where to write, shape (B, N, size), C-contiguous.
            has_constants: whether ``out`` holds the one-hots already.
            are_inside: whether the actions are known to be finite and within the action box.

        Returns:
            x_{k+1}; d^i of every player, shape (N, B) with players next to each other in memory; and whether each
            episode has reached its end, shape (B,). ``None`` where the actions have to be clipped, or numpy has to
            make the step, because the kernels are not loaded, an environment is out of range, or a drawn game has
            formulas of its own; nothing has changed then, except the content of ``out``.
        """
        compiled = kernels()
        instants, game, old, _, diverged, any_diverged, draws, _ = state
        if compiled is None or any_diverged or not (game is self._game or self._read(game, instants.size)):
            return None
        local, (modes, ages) = self._local, self._graphs(draws)
        if actions.dtype is not _SINGLE or not actions.flags.c_contiguous:
            if not are_inside:
                return None
            actions = np.ascontiguousarray(actions, dtype=np.float32)
        if not old.flags.c_contiguous:
            old = np.ascontiguousarray(old)
        n, players, batch = old.shape
        new, gradients, distance = np.empty(old.shape), np.empty((n, batch)), np.empty((batch, players))
        step, is_last = np.empty(batch, np.int64), np.empty(batch, np.bool_)
        sigma, next_sigma = self._none, self._none
        if local is not None:
            sigma, next_sigma = local.scale(state), np.empty((players, batch))
        arguments = (
            old, instants, actions, _ANY if are_inside else self._bound, sigma, modes, ages,
            new, step, gradients, distance, next_sigma, is_last, out, has_constants, *self._constants,
        )  # fmt: skip
        if not (compiled.step(*arguments) if self._is_checked else self._try(compiled.step, *arguments)):
            return None
        moved = State(step, game, new, gradients, diverged, False, draws)  # noqa: FBT003 - none has
        if local is not None:
            compiled.show_entry(out, self._log_scale, np.log10(next_sigma))
        if not (self._is_checked or self._is_confirmed(moved, state, actions, out)):
            return None
        if local is not None:
            local.remember_scale(moved, next_sigma)
        return moved, distance.T, is_last

    def _graphs(self, draws: EpisodeRandomness | None) -> tuple[npt.NDArray[np.int16], Float32Array]:
        """The active graph and its age by instant, (K+H+1, B), or (K+H+1, 1) where episodes do not draw them."""
        if draws is None or draws.modes is None or draws.time_since_switch is None:
            return self._schedule
        return draws.modes, draws.time_since_switch

    def _try(self, step: Callable[..., bool], *arguments: Any) -> bool:
        """The first step, or ``False`` and a warning where it cannot be compiled."""
        try:
            return _first_call(step, *arguments)
        except Exception as error:  # noqa: BLE001 - a broken compiler may raise anything
            _refuse(error)
            return False

    def _read(self, game: Game, batch: int) -> bool:
        """Read the numbers of the games of a batch of environments; whether the kernels hold their formulas."""
        if not _is_known(game):
            return False
        box = [] if game.low is None or game.high is None else [game.low, game.high]
        tables = [game.nash_equilibria, game.equilibrium_scale[None], *box]
        if isinstance(game, AffineGame):
            tables += [game.transposed.reshape(-1, game.transposed.shape[-1]), game.offset]
        elif isinstance(game, EnergyGame):
            tables += [np.broadcast_to(game.coupling, (1, game.batch_size)), game.slope, game.intercept]
        tile = min(self._largest_tile, batch)
        columns = tile if game.batch_size == 1 else batch  # one per environment, or a tile of the same
        table = np.concatenate([np.broadcast_to(rows, (len(rows), columns)) for rows in tables])
        self._constants = table, game.dimension if box else 0, isinstance(game, AffineGame), tile, *self._tables
        self._game = game
        return True

    def _is_confirmed(
        self, moved: State, before: State, actions: npt.NDArray[np.floating], observed: Float32Array
    ) -> bool:
        """Whether numpy comes to the same bits here: nothing is assumed of processors and compilers."""
        self._is_checked, encoder = True, self._encoder
        expected = dynamics.step(encoder.world, before, encoder.inputs(actions, before))
        pairs = (
            (moved.step, expected.step),
            (moved.estimates, expected.estimates),
            (moved.own_gradients, expected.own_gradients),
            (observed, encoder.observe(expected)),
        )
        agrees = all(ours.tobytes() == numpys.tobytes() for ours, numpys in pairs)
        if not agrees:
            _refuse("its numbers are not those of numpy")
        return agrees
