"""Interface of games, and the solvers for their equilibria."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import scipy

from ptne_env.games.variational import natural_map, solve_box
from ptne_env.shared.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    array_namespace,
    frozen,
    ordered_sum,
    replaced,
    require_count,
)
from ptne_env.shared.parts import Part

RESIDUAL_TOLERANCE = 1e-10
"""Largest ‖x* − Π(x* − F(x*))‖, relative to 1 + ‖x*‖, of a computed equilibrium."""


class NoBestResponseError(ValueError):
    """Some player's cost has no minimiser, so the game has no best response."""


class Game(Part, ABC):
    """N players, player i choosing a strategy x_i in R^{n_i}, or in a box, to minimise its cost J_i(x_i, x_{-i}).

    Arrays are float64 with environments last: a joint strategy of B environments has shape (n, B) with
    n = Σ n_i, and the estimates of all players have shape (n, N, B), where column i is player i's estimate x^i.

    Args:
        action_dims: n_i of each player, each at least 1.
        low: smallest strategies, one number for all or (n,); ``None`` without lower bounds, −inf for single components
            without.
        high: largest strategies, likewise with +inf.

    Attributes:
        low, high: the box of all games, shape (n, 1) each and read-only, or both ``None``. The dynamics keep the real
            strategies in it; estimates of others are not bounded.

    Raises:
        ValueError: when there are fewer than two players, a dimension is below 1, or the box is empty or of another
            shape.
    """

    is_affine: bool = False
    """Whether the pseudo-gradient F is affine, so that exact oracles apply."""

    parameters: ClassVar[tuple[str, ...]] = ()
    """Arguments and attributes with one column per game, on the last axis; none for a class of single games."""

    low: FloatArray | None
    high: FloatArray | None

    def __init__(
        self,
        action_dims: tuple[int, ...],
        low: npt.ArrayLike | None = None,
        high: npt.ArrayLike | None = None,
    ) -> None:
        if len(action_dims) < 2:
            raise ValueError(f"a game needs at least 2 players, got action_dims={action_dims!r}")
        self.action_dims = tuple(require_count("each entry of action_dims", dim, 1) for dim in action_dims)
        self.low, self.high = _box(low, high, self.dimension)

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

    @property
    def has_bounds(self) -> bool:
        """Whether a box confines the strategies."""
        return self.low is not None

    def project(self, strategies: FloatArray) -> FloatArray:
        """Π(x), the nearest strategies in the box: (n, B) to (n, B); the same array without a box."""
        if self.low is None or self.high is None:
            return strategies
        return array_namespace(strategies).clip(strategies, self.low, self.high)

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

        Their sum over players is the Nikaido–Isoda regret, 0 exactly at an equilibrium.

        Raises:
            NoBestResponseError: as :meth:`best_response`.
        """
        xp, response, costs = array_namespace(strategies), self.best_response(strategies), self.costs(strategies)
        regrets = []
        for player in range(self.num_players):
            own = (self.owners == player)[:, None]
            regrets.append(costs[player] - self.costs(xp.where(own, response, strategies))[player])
        return xp.stack(regrets)

    def pseudo_gradient(self, strategies: FloatArray) -> FloatArray:
        """F(x) = col(∂J_i/∂x_i(x)): (n, B) to (n, B)."""
        shape = (self.dimension, self.num_players, strategies.shape[1])
        return self.own_gradients(np.broadcast_to(strategies[:, None, :], shape))

    def natural_residual(self, strategies: FloatArray) -> FloatArray:
        """x − Π(x − F(x)), which is 0 exactly at equilibria of a convex game; F(x) without a box. (n, B) to (n, B)."""
        field = self.pseudo_gradient(strategies)
        if self.low is None or self.high is None:
            return field
        return natural_map(strategies, field, self.low, self.high)

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """dF(x): (n, B) to (n, n, B), row = component of F; by central differences where no subclass knows it."""
        columns = []
        for move in np.eye(self.dimension)[:, :, None]:
            # A step of ε^{1/3} balances truncation and rounding; for an affine F only rounding is left.
            step = np.cbrt(np.finfo(np.float64).eps) * (1 + np.abs(strategies)) * move
            forward, backward = strategies + step, strategies - step
            with np.errstate(all="ignore"):  # F need not exist beyond a bound
                rise = self.pseudo_gradient(forward) - self.pseudo_gradient(backward)
            columns.append(rise / (forward - backward).sum(axis=0))
        return np.stack(columns, axis=1)

    @property
    def has_best_response(self) -> bool:
        """Whether :meth:`best_response` exists everywhere; by default decided at the equilibrium."""
        try:
            self.best_response(self.nash_equilibria)
        except NoBestResponseError:
            return False
        return True

    @property
    def batch_size(self) -> int:
        """G, the number of games. One game serves any number of environments, G games serve G environments."""
        return 1

    def merged(self, fresh: Game, mask: BoolArray) -> Game:
        """The batch of games with those in ``mask`` (G,) replaced by those of ``fresh``, in order; a game by itself.

        Raises:
            TypeError: when ``fresh`` is another kind of game.
        """
        if fresh is self:
            return self
        if not self.parameters or type(self) is not type(fresh) or self.action_dims != fresh.action_dims:
            raise TypeError(
                f"{type(self).__name__}.merged() needs a batch of such games of the same players, got "
                f"{type(fresh).__name__}"
            )
        columns = {name: replaced(getattr(self, name), getattr(fresh, name), mask) for name in self.parameters}
        return self._with(**columns)

    def _with(self, **parameters: FloatArray) -> Game:
        """The batch of games with other parameters, which are given by name."""
        return type(self)(**parameters)  # type: ignore[arg-type]  # of a subclass that names parameters

    @cached_property
    def nash_equilibria(self) -> FloatArray:
        """x* with F(x*) = 0, or x* = Π(x* − F(x*)) in a box, of every game; verified. Shape (n, G), read-only.

        Raises:
            ArithmeticError: when the solver's point is not an equilibrium to 1e-10.
        """
        return self._verified(self._solve_nash_equilibria())

    @cached_property
    def held_at_equilibrium(self) -> BoolArray:
        """Whether a bound holds each component of x* against F; shape (n, G). All False without a box."""
        points = self.nash_equilibria
        if self.low is None or self.high is None:
            return np.zeros(points.shape, dtype=np.bool_)
        wanted = points - self.pseudo_gradient(points)
        slack = RESIDUAL_TOLERANCE * (1 + np.abs(points))  # a component at a bound with F = 0 is free
        return np.asarray((wanted < self.low - slack) | (wanted > self.high + slack))

    @cached_property
    def equilibrium_scale(self) -> FloatArray:
        """‖x*‖ of every game, by which distances are relative; 1 where x* = 0. Shape (G,), read-only."""
        xp = array_namespace(self.nash_equilibria)
        norms = xp.sqrt(ordered_sum(self.nash_equilibria**2))
        return frozen(xp.where(norms == 0, 1.0, norms))

    @property
    def nash_equilibrium(self) -> FloatArray:
        """x* of a single game, shape (n,), read-only.

        Raises:
            ValueError: for a batch of games, which has ``nash_equilibria``.
            ArithmeticError: as ``nash_equilibria``.
        """
        if self.batch_size != 1:
            raise ValueError(f"a batch of {self.batch_size} games has nash_equilibria, one column each")
        return self.nash_equilibria[:, 0]

    def _verified(self, solution: FloatArray) -> FloatArray:
        """Equilibria (n, G), read-only, or an error where a point is none."""
        points = np.asarray(solution, dtype=np.float64)
        residuals = np.linalg.norm(self.natural_residual(points), axis=0)
        if not np.all(residuals <= RESIDUAL_TOLERANCE * (1 + np.linalg.norm(points, axis=0))):
            raise ArithmeticError(
                f"{type(self).__name__}: the point found has "
                f"{'‖x − Π(x − F(x))‖' if self.has_bounds else '‖F(x)‖'} = {residuals.max():.3g}; no Nash equilibrium "
                "was found"
            )
        return frozen(points)

    def _solve_nash_equilibria(self) -> FloatArray:
        """A zero of F by ``scipy.optimize.root``, (n, 1), or the solution of the variational inequality on the box.

        Games with a closed form, and batches without a box, override this.
        """
        if self.low is not None and self.high is not None:
            is_bounded = np.isfinite(self.low) & np.isfinite(self.high)
            middle = (np.where(is_bounded, self.low, 0.0) + np.where(is_bounded, self.high, 0.0)) / 2
            start = np.repeat(middle, self.batch_size, axis=1)
            return solve_box(self.pseudo_gradient, self.jacobian, self.low, self.high, start)

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


def _box(
    low: npt.ArrayLike | None, high: npt.ArrayLike | None, dimension: int
) -> tuple[FloatArray, FloatArray] | tuple[None, None]:
    """The bounds as (n, 1) arrays."""
    if low is None and high is None:
        return None, None
    sides = []
    for side, default in ((low, -np.inf), (high, np.inf)):
        given = np.asarray(default if side is None else side, dtype=np.float64)
        if given.shape not in ((), (dimension,), (dimension, 1)):
            raise ValueError(f"a bound has the shape {given.shape}; give one number for all, or ({dimension},)")
        sides.append(frozen(np.broadcast_to(given.reshape(-1, 1), (dimension, 1))))
    lows, highs = sides
    if not np.all(lows < highs):  # NaN is refused too
        raise ValueError(f"a box needs low < high in each of the {dimension} components, got {lows!r} and {highs!r}")
    return lows, highs
