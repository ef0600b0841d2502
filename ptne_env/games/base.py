"""The interface of every game."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from scipy import optimize

from ptne_env.arrays import BoolArray, FloatArray, IntArray, frozen, ordered_sum, require_count

RESIDUAL_TOLERANCE = 1e-10
"""Largest ‖F(x*)‖, relative to 1 + ‖x*‖, with which a computed point is accepted as an equilibrium."""


class NoBestResponseError(ValueError):
    """A player's cost has no minimiser, so the game has no best response."""


class Game(ABC):
    """N players, player i choosing a strategy x_i in R^{n_i} to minimise its cost J_i(x_i, x_{-i}).

    Arrays are float64 with environments last: a joint strategy of B environments has shape (n, B) with
    n = Σ n_i, and everybody's estimates have shape (n, N, B), where column i is player i's estimate x^i.

    Args:
        action_dims: n_i of each player, each at least 1.

    Raises:
        ValueError: when there are fewer than two players or a dimension is below 1.
    """

    is_affine: bool = False
    """Whether the pseudo-gradient F is affine, so that exact oracles apply."""

    def __init__(self, action_dims: tuple[int, ...]) -> None:
        if len(action_dims) < 2:
            raise ValueError(f"a game needs at least 2 players, got action_dims={action_dims!r}")
        self.action_dims = tuple(require_count("each entry of action_dims", dim, 1) for dim in action_dims)

    @property
    def num_players(self) -> int:
        """N."""
        return len(self.action_dims)

    @cached_property
    def dimension(self) -> int:
        """N = Σ n_i."""
        return sum(self.action_dims)

    @cached_property
    def offsets(self) -> IntArray:
        """First component of each player's block, shape (N,)."""
        return np.concatenate([[0], np.cumsum(self.action_dims)[:-1]]).astype(np.int64)

    @cached_property
    def owners(self) -> IntArray:
        """The player who owns each component, shape (n,)."""
        return np.repeat(np.arange(self.num_players), self.action_dims).astype(np.int64)

    @abstractmethod
    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x) of every player: strategies (n, B) to costs (N, B)."""

    @abstractmethod
    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """∂J_i/∂x_i(x^i) of every player on its own estimate: (n, N, B) to (n, B), the blocks stacked.

        This is **F** of the paper's eq. StackedVariable; block i depends on column i alone.
        """

    @abstractmethod
    def best_response(self, strategies: FloatArray) -> FloatArray:
        """Argmin over y of J_i(y, x_{-i}) for every player: (n, B) to (n, B).

        Raises:
            NoBestResponseError: when some player's cost has no minimiser for some x_{-i}.
        """

    def regrets(self, strategies: FloatArray) -> FloatArray:
        """J_i(x) − min over y of J_i(y, x_{-i}) ≥ 0 of every player: (n, B) to (N, B).

        Their sum over players is the Nikaido–Isoda gap, 0 exactly at an equilibrium.

        Raises:
            NoBestResponseError: as :meth:`best_response`.
        """
        response = self.best_response(strategies)
        regrets = self.costs(strategies).copy()
        for player in range(self.num_players):
            own = (self.owners == player)[:, None]
            regrets[player] -= self.costs(np.where(own, response, strategies))[player]
        return regrets

    def pseudo_gradient(self, strategies: FloatArray) -> FloatArray:
        """F(x) = col(∂J_i/∂x_i(x)): (n, B) to (n, B)."""
        shape = (self.dimension, self.num_players, strategies.shape[1])
        return self.own_gradients(np.broadcast_to(strategies[:, None, :], shape))

    def jacobian(self, strategies: FloatArray) -> FloatArray | None:  # noqa: ARG002 - the signature is the interface
        """dF(x) where it is known: (n, B) to (n, n, B), row = component of F; ``None`` where it is not."""
        return None

    @property
    def has_best_response(self) -> bool:
        """Whether :meth:`best_response` exists everywhere; decided on the equilibrium unless a game knows better."""
        try:
            self.best_response(self.nash_equilibria)
        except NoBestResponseError:
            return False
        return True

    @property
    def batch_size(self) -> int:
        """G: how many games this is. One game serves any number of environments, G games serve G environments."""
        return 1

    def merged(self, fresh: Game, mask: BoolArray) -> Game:  # noqa: ARG002 - the signature is the interface
        """The batch of games with those in ``mask`` (G,) replaced by those of ``fresh``; a single game stays as it is.

        Raises:
            TypeError: when ``fresh`` is another kind of game.
        """
        if fresh is not self:
            raise TypeError(f"{type(self).__name__} is a single game and merges with itself only")
        return self

    @cached_property
    def nash_equilibria(self) -> FloatArray:
        """x* with F(x*) = 0 of every game, shape (n, G), read-only; verified by the residual.

        Raises:
            ArithmeticError: when the solver's point is not an equilibrium to 1e-10.
        """
        points = np.asarray(self._solve_nash_equilibria(), dtype=np.float64)
        residuals = np.linalg.norm(self.pseudo_gradient(points), axis=0)
        if not np.all(residuals <= RESIDUAL_TOLERANCE * (1 + np.linalg.norm(points, axis=0))):
            raise ArithmeticError(
                f"{type(self).__name__}: the point found has ‖F(x)‖ = {residuals.max():.3g}; no Nash equilibrium was "
                "found"
            )
        return frozen(points)

    @cached_property
    def equilibrium_scale(self) -> FloatArray:
        """‖x*‖ of every game, by which distances are relative; 1 where x* = 0. Shape (G,), read-only."""
        norms = np.sqrt(ordered_sum(self.nash_equilibria**2))
        return frozen(np.where(norms == 0, 1.0, norms))

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

    def _solve_nash_equilibria(self) -> FloatArray:
        """A zero of F by ``scipy.optimize.root``, (n, 1); games with a closed form, and batches, override this."""

        def field(x: FloatArray) -> FloatArray:
            return self.pseudo_gradient(x[:, None])[:, 0]

        point = np.asarray(optimize.root(field, np.zeros(self.dimension), method="hybr", tol=1e-14).x)
        # Where F only underflows, as e^x does far out, its residual is small and Newton's step is not.
        slope = optimize.approx_fprime(point, field)
        step = np.linalg.lstsq(slope, field(point), rcond=None)[0]
        if not np.linalg.norm(step) <= 1e-6 * (1 + np.linalg.norm(point)):
            raise ArithmeticError(
                f"{type(self).__name__}: F vanishes at no finite point that the solver reached; no Nash equilibrium "
                "was found"
            )
        return point[:, None]
