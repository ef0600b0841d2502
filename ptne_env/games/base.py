"""The interfaces of games and of families of games, and the solvers for equilibria."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt
import scipy

from ptne_env.games.variational import natural_map, solve_box
from ptne_env.shared.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    array_namespace,
    freeze,
    ordered_sum,
    require_count,
    with_games,
)
from ptne_env.shared.parts import Part

RESIDUAL_TOLERANCE = 1e-10
"""The largest ‖x* − Π(x* − F(x*))‖ that a computed equilibrium may have, relative to 1 + ‖x*‖."""

REGRET_TOLERANCE = 1e-8
"""The largest regret J_i(x*) − min J_i that a computed equilibrium may have, relative to 1 + |J_i(x*)|."""

BOUNDS_ADVICE = "; give low and high where a cost has a pole or falls without end"
"""What the message of an unbounded game without an equilibrium ends with."""

CONSTRAINT_ADVICE = "; a shared constraint that no strategy satisfies has none"
"""What that of a bounded one ends with."""


class NoBestResponseError(ValueError):
    """Some player's cost has no minimiser, so the game has no best response."""


class Game(Part, ABC):
    """N players, player i choosing a strategy x_i in R^{n_i}, or in a box, to minimise its cost J_i(x_i, x_{-i}).

    A game defines ``action_dims``, and ``low`` and ``high`` where strategies are bounded, each as a field, a class
    attribute or a cached property; and :meth:`costs` and :meth:`own_gradients`. A subclass that checks its fields in
    ``__post_init__`` calls that of its base too.

    Arrays are float64 with environments last: a joint strategy of B environments has shape (n, B) with
    n = Σ n_i, and the estimates of all players have shape (n, N, B), where column i is player i's estimate x^i.

    A game is its own :class:`~ptne_env.games.GameFamily` with one member.

    Raises:
        ValueError: when there are fewer than two players, a dimension is below 1, the box is empty or of another shape,
            or the parameters of a batch disagree on the number of games.
    """

    is_affine: ClassVar[bool] = False
    """Whether the pseudo-gradient F is affine, so that exact oracles apply."""

    parameters: ClassVar[Mapping[str, int]] = {}
    """The fields that have one column per game, on a last axis, in a batch of games, and the number of their axes in a
    single game; none for a class of single games. JAX differentiates and maps these fields alone."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.ndim(self.action_dims) != 1 or len(self.action_dims) < 2:
            raise ValueError(f"action_dims is a tuple, a number for each of at least 2 players, got {self.action_dims}")
        for dim in self.action_dims:
            require_count("each entry of action_dims", dim, 1)
        _ = self.box
        if self.is_batch:
            columns = {name: freeze(getattr(self, name)) for name in self.parameters}
            if len({columns[name].shape[axes:] for name, axes in self.parameters.items()}) > 1:
                shapes = {name: array.shape for name, array in columns.items()}
                raise ValueError(f"{type(self).__name__}: a batch of games has one column per game, got {shapes}")
            vars(self).update(columns)

    @cached_property
    def action_dims(self) -> tuple[int, ...]:
        """The dimensions n_i ≥ 1 of the players."""
        raise NotImplementedError(f"{type(self).__name__} defines no action_dims, the dimension of each player")

    @cached_property
    def low(self) -> npt.ArrayLike | None:
        """The smallest strategies, one number for all or (n,), −inf where there is none; ``None`` without bounds."""
        return None

    @cached_property
    def high(self) -> npt.ArrayLike | None:
        """The largest strategies, likewise with +inf."""
        return None

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray] | None:
        """The bounds of strategies, (n, 1) each; ``None`` without.

        The dynamics keep the real strategies in the box; estimates of others are not bounded.
        """
        if self.low is None and self.high is None:
            return None
        n, bounds = self.dimension, []
        for side, free in ((self.low, -np.inf), (self.high, np.inf)):
            bound = np.asarray(free if side is None else side, dtype=np.float64)
            if bound.shape not in ((), (n,), (n, 1)):
                raise ValueError(f"a bound has the shape {bound.shape}; give one number for all, or ({n},)")
            bounds.append(freeze(np.broadcast_to(bound.reshape(-1, 1), (n, 1))))
        low, high = bounds
        if not np.all(low < high):  # NaN is refused too
            raise ValueError(f"a box needs low < high in each of the {n} components, got {low!r} and {high!r}")
        return low, high

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """The bounds of strategies, (n, 1) each, ±∞ where there is none."""
        return self.box or (np.full((self.dimension, 1), -np.inf), np.full((self.dimension, 1), np.inf))

    @property
    def num_players(self) -> int:
        """N."""
        return len(self.action_dims)

    @cached_property
    def dimension(self) -> int:
        """n = Σ n_i."""
        return sum(self.action_dims)

    @cached_property
    def owners(self) -> IntArray:
        """The player that owns each component, shape (n,)."""
        return np.repeat(np.arange(self.num_players), self.action_dims).astype(np.int64)

    def project(self, strategies: FloatArray) -> FloatArray:
        """Π(x), the nearest strategies in the box: (n, B) to (n, B); the same array without a box."""
        return strategies if self.box is None else array_namespace(strategies).clip(strategies, *self.box)

    @abstractmethod
    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x) of every player: strategies (n, B) to costs (N, B)."""

    @abstractmethod
    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """∂J_i/∂x_i(x^i) of every player on its own estimate: (n, N, B) to (n, B), the blocks stacked.

        This is **F** of the paper's eq. (11); block i depends on column i alone.
        """

    def best_response(self, strategies: FloatArray) -> FloatArray:  # noqa: ARG002 - subclasses use them
        """Argmin over y in the box of J_i(y, x_{-i}) for every player: (n, B) to (n, B).

        Raises:
            NoBestResponseError: when some player's cost has no minimiser for some x_{-i}, or no subclass knows it.
        """
        raise NoBestResponseError(f"{type(self).__name__} has no best response")

    def regrets(self, strategies: FloatArray) -> FloatArray:
        """J_i(x) − min over y in the box of J_i(y, x_{-i}) ≥ 0 of every player: (n, B) to (N, B).

        Their sum over players is the Nikaido–Isoda regret, 0 exactly at an equilibrium. Errors are those of
        :meth:`best_response`.
        """
        return self._savings(strategies, self.best_response(strategies))

    def _savings(self, strategies: FloatArray, response: FloatArray) -> FloatArray:
        """By how much each player's cost falls where that player alone plays its response: (n, B) twice to (N, B)."""
        xp, costs = array_namespace(strategies), self.costs(strategies)
        savings = []
        for player in range(self.num_players):
            own = (self.owners == player)[:, None]
            savings.append(costs[player] - self.costs(xp.where(own, response, strategies))[player])
        return xp.stack(savings)

    def deviations(self, strategies: FloatArray, response: FloatArray) -> FloatArray:
        """Column i holds the response of player i and the strategies of the others: (n, B) twice to (n, N, B)."""
        own = (self.owners[:, None] == np.arange(self.num_players))[:, :, None]
        return array_namespace(strategies).where(own, response[:, None], strategies[:, None])

    def pseudo_gradient(self, strategies: FloatArray) -> FloatArray:
        """F(x) = col(∂J_i/∂x_i(x)): (n, B) to (n, B)."""
        shape = (self.dimension, self.num_players, strategies.shape[1])
        return self.own_gradients(np.broadcast_to(strategies[:, None, :], shape))

    def natural_residual(self, strategies: FloatArray) -> FloatArray:
        """x − Π(x − F(x)), which is 0 exactly at equilibria of a convex game; F(x) without a box. (n, B) to (n, B)."""
        field = self.pseudo_gradient(strategies)
        return field if self.box is None else natural_map(strategies, field, *self.box)

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """dF(x): (n, B) to (n, n, B), row = component of F; by differences of fourth order where no subclass knows it.

        Near a bound the differences stay in the box, down to a step of ε^{1/3}.
        """
        columns, epsilon, size = [], np.finfo(np.float64).eps, 1 + np.abs(strategies)
        low, high = self.bounds
        room = np.minimum(strategies - low, high - strategies) / 2
        # ε^{1/5} balances truncation and rounding; powers of 2 leave no rounding in most sums x + h.
        steps = np.maximum(np.minimum(epsilon ** (1 / 5) * size, room), np.cbrt(epsilon) * size)
        steps = np.exp2(np.floor(np.log2(steps)))
        for move in np.eye(self.dimension)[:, :, None] * steps:
            with np.errstate(all="ignore"):  # F need not exist beyond a bound
                near, far = (
                    self.pseudo_gradient(strategies + reach * move) - self.pseudo_gradient(strategies - reach * move)
                    for reach in (1, 2)
                )
            columns.append((8 * near - far) / (12 * move.sum(axis=0)))
        return np.stack(columns, axis=1)

    @property
    def has_best_response(self) -> bool:
        """Whether :meth:`best_response` exists everywhere; by default decided at the equilibrium."""
        try:
            self.best_response(self.nash_equilibria)
        except NoBestResponseError:
            return False
        return True

    @cached_property
    def is_batch(self) -> bool:
        """Whether this is a batch of games: its parameters have an axis for games."""
        return any(np.ndim(getattr(self, name)) > axes for name, axes in self.parameters.items())

    @property
    def batch_size(self) -> int:
        """G, the number of games. One game serves any number of environments, G games serve G environments."""
        return int(getattr(self, next(iter(self.parameters))).shape[-1]) if self.is_batch else 1

    @property
    def representative(self) -> Game:
        """The game itself; see :class:`~ptne_env.games.GameFamily`."""
        return self

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:  # noqa: ARG002 - nothing is drawn
        """Return the game itself, for any number of environments; see :class:`~ptne_env.games.GameFamily`."""
        return self

    def map_columns(self, function: Callable[..., FloatArray], *others: Game) -> Game:
        """Return the batch whose parameters are a function of those of several games, of which one is a batch at least.

        Games are the last axis of the function's arrays. A game that is no batch, alone or with itself, is returned.

        Raises:
            TypeError: when the games are of several kinds, or several and none a batch.
        """
        games = (self, *others)
        batch = next((game for game in games if game.is_batch), None)
        if batch is None and all(game is self for game in others):
            return self
        kinds = {(type(game), game.action_dims) for game in games}
        if batch is None or len(kinds) > 1:
            names = ", ".join(type(game).__name__ for game in games)
            raise TypeError(f"games are merged with a batch of games of the same class and players, got {names}")
        columns = {}
        for name, axes in self.parameters.items():
            values = [getattr(game, name) for game in games]
            columns[name] = function(*(each if np.ndim(each) > axes else with_games(each, axes) for each in values))
        return batch.with_columns(columns)

    def with_columns(self, columns: Mapping[str, FloatArray]) -> Self:
        """Return a batch with other values of the parameters, by name, without checking them."""
        games = object.__new__(type(self))
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        vars(games).update(values | dict(columns), is_batch=True)
        return games

    @cached_property
    def nash_equilibria(self) -> FloatArray:
        """x* with F(x*) = 0, or x* = Π(x* − F(x*)) in a box, of every game, shape (n, G), read-only.

        It is verified that no cost falls near it, to the second order in the own strategy, and that no player has a
        better response, where the game has best responses.

        Raises:
            ArithmeticError: when the solver's point is not an equilibrium to 1e-10, or no minimum of a player's cost.
        """
        points = np.asarray(self._solve_nash_equilibria(), dtype=np.float64)
        residuals = np.linalg.norm(self.natural_residual(points), axis=0)
        is_small = residuals <= RESIDUAL_TOLERANCE * (1 + np.linalg.norm(points, axis=0))
        if not is_small.all() or self._is_lost_in_rounding(points):
            raise ArithmeticError(
                f"{type(self).__name__}: the point found has "
                f"{'‖x − Π(x − F(x))‖' if self.box else '‖F(x)‖'} = {residuals.max():.3g} and components of up to "
                f"{np.abs(points).max():.3g}; no Nash equilibrium was found"
                + (CONSTRAINT_ADVICE if self.box else BOUNDS_ADVICE)
            )
        self._require_minima(points)
        return freeze(points)

    def _is_lost_in_rounding(self, points: FloatArray) -> bool:
        """Whether F does not vanish inside the box, although x − F(x) is rounded to x.

        So it is where x is huge, as the price of a constraint that no strategy satisfies. The measure is the rounding
        of the terms of F.
        """
        if self.box is None:
            return False
        room = np.minimum(points - self.box[0], self.box[1] - points)
        terms = 1 + ordered_sum(np.abs(self.jacobian(points)) * np.abs(points), axis=1)
        is_lost = np.abs(self.pseudo_gradient(points)) > RESIDUAL_TOLERANCE * terms
        return bool((is_lost & (room > RESIDUAL_TOLERANCE * (1 + np.abs(points)))).any())

    @cached_property
    def held_at_equilibrium(self) -> BoolArray:
        """Whether a bound holds each component of x* against F; shape (n, G). All False without a box."""
        return self._held(self.nash_equilibria)

    def _held(self, points: FloatArray) -> BoolArray:
        if self.box is None:
            return np.zeros(points.shape, dtype=np.bool_)
        unbounded, (low, high) = points - self.pseudo_gradient(points), self.box
        slack = RESIDUAL_TOLERANCE * (1 + np.abs(points))  # a component at a bound with F = 0 is free
        return np.asarray((unbounded < low - slack) | (unbounded > high + slack))

    @cached_property
    def equilibrium_scale(self) -> FloatArray:
        """‖x*‖ of every game, by which distances are relative; 1 where solvers cannot tell it from 0. Shape (G,)."""
        xp = array_namespace(self.nash_equilibria)
        norms = xp.sqrt(ordered_sum(self.nash_equilibria**2))
        return freeze(xp.where(norms <= RESIDUAL_TOLERANCE, 1.0, norms))

    @cached_property
    def regret_scale(self) -> FloatArray:
        """The unit of regrets in rewards: the mean over players at a relative distance of 1 from x*. Shape (G,).

        The point is x* + ‖x*‖/√n in all components. The unit is 1 where rounding leaves nothing of a regret. Raises as
        :meth:`best_response`.
        """
        xp = array_namespace(self.nash_equilibria)
        regrets = self.regrets(self.nash_equilibria + self.equilibrium_scale / math.sqrt(self.dimension))
        mean = ordered_sum(regrets) / self.num_players
        return freeze(xp.where(mean > 0, mean, 1.0))

    @property
    def nash_equilibrium(self) -> FloatArray:
        """x* of a single game, shape (n,), read-only.

        Raises:
            ValueError: for a batch, which has ``nash_equilibria``.
            ArithmeticError: when no equilibrium is found.
        """
        if self.batch_size != 1:
            raise ValueError(f"a batch of {self.batch_size} games has nash_equilibria, one column each")
        return self.nash_equilibria[:, 0]

    def _require_minima(self, points: FloatArray) -> None:
        """Check that ∂²J_i/∂x_i² has no negative curvature at points (n, G), in components that no bound holds."""
        with np.errstate(all="ignore"):  # F need not exist beyond a bound
            slopes = np.moveaxis(np.nan_to_num(self.jacobian(points), posinf=0.0, neginf=0.0), 2, 0)
        free = ~self._held(points).T
        slopes = slopes * free[:, :, None] * free[:, None]
        for player in range(self.num_players):
            own = self.owners == player
            hessians = slopes[:, own][:, :, own]
            smallest = np.linalg.eigvalsh((hessians + hessians.transpose(0, 2, 1)) / 2)[:, 0]
            if np.any(smallest < -1e-6 * np.abs(hessians).max(axis=(1, 2))):
                raise ArithmeticError(
                    f"{type(self).__name__}: F vanishes at the point found, but the cost of player {player} has the "
                    f"curvature {smallest.min():.3g} there, so it is no minimum and no Nash equilibrium"
                )
        self._require_best_responses(points)

    def _require_best_responses(self, points: FloatArray) -> None:
        """Check that no player has a better strategy than that at points (n, G), if best responses are known."""
        try:
            self._require_no_better(points, self.best_response(points))
        except NoBestResponseError:
            return

    def _require_no_better(self, points: FloatArray, response: FloatArray) -> None:
        savings, costs = self._savings(points, response), self.costs(points)
        if np.any(savings > REGRET_TOLERANCE * (1 + np.abs(costs))):
            player, game = np.unravel_index(savings.argmax(), savings.shape)
            raise ArithmeticError(
                f"{type(self).__name__}: F vanishes at the point found, but player {player} lowers its cost from "
                f"{costs[player, game]:.6g} by {savings[player, game]:.3g} when it plays "
                f"{response[self.owners == player, game]} and not {points[self.owners == player, game]}, so it is no "
                "Nash equilibrium"
            )

    def _solve_nash_equilibria(self) -> FloatArray:
        """Find a zero of F, (n, 1), with ``scipy.optimize.root``, or solve the variational inequality on the box.

        Games with a closed form, and batches without a box, override this.
        """
        if self.box is not None:
            low, high = self.box
            is_bounded = np.isfinite(low) & np.isfinite(high)
            middle = (np.where(is_bounded, low, 0.0) + np.where(is_bounded, high, 0.0)) / 2
            start = np.repeat(middle, self.batch_size, axis=1)
            return solve_box(self.pseudo_gradient, self.jacobian, low, high, start)

        def field(x: FloatArray) -> FloatArray:
            return self.pseudo_gradient(x[:, None])[:, 0]

        point = np.asarray(scipy.optimize.root(field, np.zeros(self.dimension), method="hybr", tol=1e-14).x)
        # Where F only underflows, as e^x does far out, its residual is small but Newton's step is large.
        slope = scipy.optimize.approx_fprime(point, field)
        step = np.linalg.lstsq(slope, field(point), rcond=None)[0]
        if not np.linalg.norm(step) <= 1e-6 * (1 + np.linalg.norm(point)):
            raise ArithmeticError(
                f"{type(self).__name__}: F vanishes at no finite point that the solver reached; no Nash equilibrium "
                "was found"
            )
        return point[:, None]


class GameFamily(Part, ABC):
    """A distribution of games with the same players and dimensions."""

    is_strongly_monotone: ClassVar[bool | None] = None
    """Whether Assumption 4 holds for all members by construction, or is given up; ``None`` where a world checks it for
    every draw, which must then be affine."""

    @cached_property
    def representative(self) -> Game:
        """A typical member, with the players and dimensions of all."""
        return self.draw([np.random.default_rng(0)])

    @abstractmethod
    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """Draw one game per generator, as a batch of G = ``len(generators)`` games.

        A batch is one game whose :attr:`Game.parameters` have a last axis for games.
        """


def require_strong_monotonicity(game: Game) -> None:
    """Raise ``ValueError`` for a batch of games, unless F is affine and dF + dFᵀ positive definite (Assumption 4)."""
    if not game.is_affine:
        raise ValueError(
            f"strong monotonicity of {type(game).__name__} cannot be decided: F is not affine; the family that draws "
            "them declares is_strongly_monotone"
        )
    known = game.jacobian(np.zeros((game.dimension, game.batch_size)))
    symmetric = np.moveaxis(known + known.transpose(1, 0, 2), 2, 0) / 2
    try:
        np.linalg.cholesky(symmetric)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(symmetric)[:, 0]
        raise ValueError(
            f"game {int(smallest.argmin())} of the batch is not strongly monotone: ε = {smallest.min():.3g}; the "
            "family that draws such games declares is_strongly_monotone = False"
        ) from None
