"""Games that are given by their costs alone: derivatives, best responses and equilibria follow."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.games.base import BOUNDS_ADVICE, REGRET_TOLERANCE, Game, NoBestResponseError
from ptne_env.games.variational import solve_box
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, array_namespace, is_numpy, ordered_sum

_IMAGINARY = 1e-20
"""The complex step: J(x + i h e_c) has the imaginary part h ∂J/∂x_c, without a difference that could cancel."""


class CostGame(Game):
    """A game from its costs alone: own gradients, Jacobian, best responses, regrets and the equilibrium follow.

    A subclass writes :meth:`costs`, with its numbers as fields; or ``CostGame(function, sizes)`` takes a function. Both
    map strategies x of shape (n, B), environments last, to the costs (N, B) of all players, entry by entry along the
    last axis; a function may also return a list of N rows. ``x1, x2 = x`` are the components of two players with one
    each. Player i's cost is evaluated at its own estimate of x, so that no player needs to know more.

    Derivatives have all digits. Arrays of JAX are differentiated by JAX, and arrays of numpy by a complex step, or by
    JAX (if installed) where that differs from a difference of costs at sampled points, as with ``abs(x)``; both agree
    to 1e-12. docs/adding-parts.md says how costs are written for that.

    Attributes:
        function: the costs, unless a subclass writes them. Scenarios keep its name, so it is defined in a module, a
            program or a notebook.
        action_dims: n_i of each player.
        low: smallest strategies, one number for all or (n,); ``None`` for no bound.
        high: largest strategies, likewise.

    Raises:
        ValueError: when costs have another shape, are not numbers, or cannot be differentiated.
    """

    function: Callable[[Any], Any] | None = None
    action_dims: tuple[int, ...] = ()
    low: npt.ArrayLike | None = None
    high: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self._method

    def costs(self, strategies: FloatArray) -> FloatArray:
        if self.function is None:
            raise NotImplementedError(f"{type(self).__name__} has no costs: write costs(x), or pass a function of x")
        return as_rows(self.function(strategies), strategies)

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """∂J_i/∂x_i(x^i) of every player on its own estimate: (n, N, B) to (n, B), all components at once."""
        return self._differentiate(estimates, self._method if is_numpy(estimates) else _by_jax)

    def _differentiate(self, estimates: FloatArray, method: _Method) -> FloatArray:
        # One column per component and environment: the estimate of the component's owner, and the move of it alone.
        n, batch = self.dimension, estimates.shape[-1]
        moves = np.repeat(np.eye(n), batch, axis=1)
        slopes = method(self._repeated(n), estimates[:, self.owners].reshape(n, -1), moves)
        return slopes.reshape(-1, n, batch)[self.owners, np.arange(n)]

    def _repeated(self, times: int) -> Any:
        """Return the game for ``times`` columns of strategies of each environment; a batch repeats its games."""
        return self.map_columns(lambda column: array_namespace(column).tile(column, times))

    @cached_property
    def _method(self) -> _Method:
        """How arrays of numpy are differentiated: the first way that agrees with differences at sampled points.

        Raises:
            ValueError: when there is none, or the costs are no array (N, B) of finite numbers.
        """
        name, units = type(self).__name__, 0.25 + self._units(16) / 2  # away from the bounds
        points = np.concatenate([self._spread(unit, np.zeros((self.dimension, self.batch_size))) for unit in units], 1)
        game, estimates = self._repeated(len(units)), np.repeat(points[:, None], self.num_players, axis=1)
        costs = game._checked_costs(points)  # noqa: SLF001 - the same class
        if not (is_numpy(costs) and costs.dtype.kind in "fi"):
            raise ValueError(
                f"{name}.costs maps an array of numpy to one of numpy, and an array of JAX to one of JAX, with the "
                f"functions of xp = x.__array_namespace__(), such as xp.stack(rows); it returned a "
                f"{type(costs).__module__} {type(costs).__name__}"
            )
        if not np.isfinite(costs).all():
            player, column = np.argwhere(~np.isfinite(costs))[0]
            raise ValueError(
                f"{name}: the cost of player {player} is {costs[player, column]} at x = {points[:, column]}: are all "
                "numbers of the game finite? Or bound the strategies, with low= and high=, to where costs are finite"
            )
        first = slice(self.batch_size)
        alone = self._checked_costs(points[:, first])
        if not np.abs(alone - costs[:, first]).max() <= 1e-9 * (1 + np.abs(costs).max()):
            raise ValueError(f"{name}: costs of one environment depend on another: sum over axis=0, as x.sum(axis=0)")
        expected = game._differentiate(estimates, _by_differences)  # noqa: SLF001 - the same class
        slack = 1e-4 * (1 + np.abs(expected)) + 1e-7 * np.abs(costs[self.owners])
        reasons = []
        for method, way in ((_by_complex_step, "a complex step"), (_by_jax, "JAX")):
            try:
                with warnings.catch_warnings(action="ignore"):  # that an imaginary part was lost, which shows below
                    wrong = ~(np.abs(game._differentiate(estimates, method) - expected) <= slack)  # noqa: SLF001
            except Exception as error:  # noqa: BLE001 - the costs may raise any
                reasons.append(f"{way} raised {type(error).__name__}: {error}")
                continue
            if not wrong.any():
                return method
            player = self.owners[wrong.any(axis=1)][0]
            reasons.append(f"{way} gives another derivative of the cost of player {player} than differences do")
        function = self.function or self.costs
        raise ValueError(
            f"{name}: the costs, {function.__module__}.{function.__qualname__}, cannot be differentiated. Write them "
            "as a formula of x without float() and numbers stored into other arrays; with JAX installed, abs(x) and "
            f"functions of xp = x.__array_namespace__() will do, but not np.abs(x). {'; '.join(reasons)}"
        )

    def _checked_costs(self, points: FloatArray) -> FloatArray:
        """Return the costs, or raise ``ValueError`` unless they are those of all players in all environments."""
        expected = self.num_players, points.shape[1]
        rule = f"{self.costs.__qualname__} maps (n, B) = {points.shape} to (N, B) = {expected}, environments B last"
        try:
            costs = self.costs(points)
            shape = np.shape(costs)
        except (TypeError, ValueError, LookupError) as error:
            raise ValueError(f"{rule}; it raised {type(error).__name__}: {error}") from error
        if shape != expected:
            raise ValueError(f"{rule}; it returned the shape {shape}")
        return costs

    def _units(self, count: int) -> FloatArray:
        """Points of (0, 1)^n that cover it evenly, also in the components of each player; (count, n, 1)."""
        place = np.arange(self.dimension) - self._first[self.owners]
        base = 2.0
        for _ in range(50):  # M. Roberts' generalised golden ratio, x^(d + 1) = x + 1
            base = (1 + base) ** (1 / (max(self.action_dims) + 1))
        shift = np.arange(self.dimension) * (np.sqrt(5) - 1) / 2  # so that no two players move alike
        return ((0.5 + shift + np.arange(1, count + 1)[:, None] * base ** -(place + 1.0)) % 1)[..., None]

    def _spread(self, units: FloatArray, around: FloatArray) -> FloatArray:
        """Map numbers in (0, 1), (n, 1), to the box; without bounds to all numbers, most next to ``around``, (n, B)."""
        (low, high), scale = self.bounds, 1 + np.abs(around)
        has_low, has_high, far = np.isfinite(low), np.isfinite(high), scale * np.tan(np.pi / 2 * units)
        with np.errstate(invalid="ignore"):
            inside = [low + (high - low) * units, low + far, high - far]
        anywhere = around + scale * np.tan(np.pi * (units - 0.5))
        return np.select([has_low & has_high, has_low, has_high], inside, anywhere)

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """The minimisers in the box, to about 1e-12, from the best of 32 points per component: (n, B) to (n, B).

        Raises:
            NoBestResponseError: when none is found, as where a cost falls without end.
        """
        response, found = self._respond(strategies)
        if not found.all():
            raise NoBestResponseError(
                f"{type(self).__name__}: no strategy of player {int(found.all(axis=1).argmin())} was found that "
                "minimises its cost for each strategy of the others"
            )
        return response

    def _own_costs(self, strategies: FloatArray, response: FloatArray) -> FloatArray:
        """J_i of every player that alone plays its response: (n, B) twice to (N, B)."""
        points = self.deviations(strategies, response)
        costs = self._repeated(self.num_players).costs(points.reshape(self.dimension, -1))
        return np.einsum("iib->ib", costs.reshape(self.num_players, *points.shape[1:]))

    def _respond(self, strategies: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the best responses, (n, B), and whether each player has one, (N, B)."""
        response, costs = strategies, self._own_costs(strategies, strategies)
        for units in self._units(32 * max(self.action_dims)):
            trial = self._spread(units, strategies)
            reached = self._own_costs(strategies, trial)
            better = reached < costs
            response, costs = np.where(better[self.owners], trial, response), np.where(better, reached, costs)
        done, found = np.zeros((2, *costs.shape), dtype=np.bool_)  # who is done stays, so that no batch changes a bit
        for _ in range(100):
            gradient, newton = self._newton_step(strategies, response)
            length = self._longest(self.project(response + newton) - response) / (1 + self._longest(response))
            moved, is_last, found = done.copy(), length <= 1e-9, np.where(done, found, length <= 1e-6)
            for step in (*(newton / 4**k for k in range(8)), *(-gradient / 4**k for k in range(-4, 24))):
                trial = self.project(response + step)
                reached = self._own_costs(strategies, trial)
                promised = np.minimum(np.add.reduceat(gradient * (trial - response), self._first, axis=0), 0)
                falls = reached <= costs + 1e-4 * promised + 1e-14 * (1 + np.abs(costs))
                better = ~moved & (falls | is_last)
                response, costs = np.where(better[self.owners], trial, response), np.where(better, reached, costs)
                moved |= better
                if moved.all():
                    break
            done |= is_last | ~moved
            if done.all():
                break
        return response, found

    def _newton_step(self, strategies: FloatArray, response: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gradients of all players' own costs at a response, and Newton's steps in the box; (n, B) each.

        A component that a step by its own curvature takes beyond a bound goes to it, and the others solve for a
        gradient of 0, with the Hessians' eigenvalues replaced by their magnitudes, so that costs fall.
        """

        def gradients(response: FloatArray) -> FloatArray:
            return self.own_gradients(self.deviations(strategies, response))

        (low, high), gradient = self.bounds, gradients(response)
        place, sizes = np.arange(self.dimension) - self._first[self.owners], np.array(self.action_dims)[self.owners]
        hessian = np.zeros((self.dimension, *response.shape))
        for component in range(max(self.action_dims)):  # that of all players moves at once
            moves = np.cbrt(np.finfo(np.float64).eps) * (1 + np.abs(response)) * (place == component)[:, None]
            with np.errstate(all="ignore"):  # costs need not exist beyond a bound
                rise = gradients(response + moves) - gradients(response - moves)
                slopes = rise / (2 * np.add.reduceat(moves, self._first, axis=0))[self.owners]
            rows = np.flatnonzero(sizes > component)
            hessian[rows, self._first[self.owners[rows]] + component] = slopes[rows]
        hessian = np.nan_to_num(hessian + hessian.transpose(1, 0, 2), posinf=0.0, neginf=0.0) / 2
        scale = np.abs(np.einsum("ccb->cb", hessian)) + 1e-150
        below, above = response - gradient / scale <= low, response - gradient / scale >= high
        held = np.where(below, low - response, np.where(above, high - response, 0.0))
        free = ~(below | above)
        wanted = np.where(free, gradient + ordered_sum(hessian * held, axis=1), 0.0)
        values, vectors = np.linalg.eigh(np.moveaxis(hessian * free * free[:, None], 2, 0))
        magnitudes = np.maximum(np.abs(values), 1e-14 * np.abs(values).max(axis=1, keepdims=True) + 1e-150).T
        vectors = np.moveaxis(vectors, 0, 2)
        solved = -ordered_sum(vectors * (ordered_sum(vectors * wanted[:, None]) / magnitudes), axis=1)
        step = np.where(free, solved, held)
        limit = 10 * (1 + self._longest(response)) / np.maximum(self._longest(step), 1e-150)
        return gradient, step * np.minimum(limit, 1)[self.owners]

    @cached_property
    def _first(self) -> IntArray:
        """The first component of each player."""
        return np.searchsorted(self.owners, np.arange(self.num_players))

    def _longest(self, moves: FloatArray) -> FloatArray:
        """Return each player's largest component: (n, B) to (N, B)."""
        return np.maximum.reduceat(np.abs(moves), self._first, axis=0)

    def _require_best_responses(self, points: FloatArray) -> None:
        response, found = self._respond(points)
        if not found.all():
            raise ArithmeticError(
                f"{type(self).__name__}: F vanishes at the point found, but no strategy was found that minimises the "
                f"cost of player {int(found.all(axis=1).argmin())} there, so it is no Nash equilibrium"
                + BOUNDS_ADVICE
                * (self.box is None)
            )
        self._require_no_better(points, response)

    def _solve_nash_equilibria(self) -> FloatArray:
        """Solve the variational inequality from the middle of the box, and again from any better responses."""
        points = self._spread(np.full((self.dimension, 1), 0.5), np.zeros((self.dimension, self.batch_size)))
        for _ in range(5):
            points = solve_box(self.pseudo_gradient, self.jacobian, *self.bounds, points)
            response, found = self._respond(points)
            if not np.any(self._savings(points, response) > REGRET_TOLERANCE) or not found.all():
                break
            points = response
        return points


def as_rows(values: Any, strategies: FloatArray) -> FloatArray:
    """Return what a function of strategies returned as an array, (N, B); it may be a list of N rows."""
    return array_namespace(strategies).stack(values) if isinstance(values, list | tuple) else values


_Method = Callable[[CostGame, FloatArray, FloatArray], FloatArray]
"""Costs differentiated along moves: points and moves (n, B) to slopes (N, B)."""


def _by_complex_step(game: CostGame, points: FloatArray, moves: FloatArray) -> FloatArray:
    complex_points: Any = points + 1j * _IMAGINARY * moves
    return game.costs(complex_points).imag / _IMAGINARY


def _by_differences(game: CostGame, points: FloatArray, moves: FloatArray) -> FloatArray:
    steps = np.cbrt(np.finfo(np.float64).eps) * (1 + np.abs(points)) * moves
    return (game.costs(points + steps) - game.costs(points - steps)) / (2 * ordered_sum(steps))


def _by_jax(game: CostGame, points: FloatArray, moves: FloatArray) -> FloatArray:
    """Differentiate by JAX; arrays of numpy on the CPU and in 64 bits, whatever JAX is set to."""
    if not is_numpy(points):
        return _slopes_in_jax(game, points, moves)
    import jax

    in_64_bits = jax.enable_x64 if hasattr(jax, "enable_x64") else jax.experimental.enable_x64  # as JAX's age is
    with in_64_bits(new_val=True), jax.default_device(jax.devices("cpu")[0]):
        return np.asarray(_compiled_slopes()(game, points, moves))


def _slopes_in_jax(game: CostGame, points: FloatArray, moves: FloatArray) -> FloatArray:
    return sys.modules["jax"].jvp(game.costs, (points,), (moves,))[1]


@cache
def _compiled_slopes() -> _Method:
    return sys.modules["jax"].jit(_slopes_in_jax, static_argnums=0)
