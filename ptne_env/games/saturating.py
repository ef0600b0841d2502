"""Random games that are strongly monotone and not affine."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, FloatArray, frozen, ordered_sum, require_non_negative
from ptne_env.games.affine import AffineGame, RandomAffine, times
from ptne_env.games.base import Game, merged_parameters
from ptne_env.games.family import GameFamily
from ptne_env.games.variational import solve_box


class SaturatingGame(AffineGame):
    """F(x) = A (x − x*) + Mᵀ (tanh(M x − r) − tanh(M x* − r)), a game with prices that saturate.

    J_i is that of :class:`AffineGame` and Σ_l log cosh((M x − r)_l), convex in x and the same for all players; dF =
    A + Mᵀ diag(1/cosh²(M x − r)) M, so F is strongly monotone and Lipschitz wherever A is positive definite, with
    ε ≥ ε(A) and ι ≤ ‖A‖ + ‖M‖². The game is given by its equilibrium x*, which is therefore exact.

    Args:
        matrix: A, (n, n) or (n, n, G), as in :class:`AffineGame`.
        prices: M, (m, n) or (m, n, G).
        shift: r, (m,) or (m, G).
        equilibrium: x*, (n,) or (n, G).
        action_dims: n_i of each player; by default 1 for all.

    Raises:
        ValueError: when shapes disagree, or as :class:`AffineGame`.
    """

    is_affine = False

    def __init__(
        self,
        matrix: npt.ArrayLike,
        prices: npt.ArrayLike,
        shift: npt.ArrayLike,
        equilibrium: npt.ArrayLike,
        action_dims: Sequence[int] | None = None,
    ) -> None:
        known = np.asarray(equilibrium, dtype=np.float64)
        super().__init__(matrix, known, action_dims)
        rows, shifts = np.asarray(prices, dtype=np.float64), np.asarray(shift, dtype=np.float64)
        rows, shifts = rows.reshape(*rows.shape[:2], -1), shifts.reshape(len(shifts), -1)
        if rows.shape != (len(rows), self.dimension, self.batch_size) or shifts.shape != (len(rows), self.batch_size):
            raise ValueError(
                f"SaturatingGame: prices are (m, {self.dimension}) and shift (m,), with a last axis for games where "
                f"there are several; got {np.shape(prices)} and {np.shape(shift)}"
            )
        self.prices, self.shift = frozen(rows), frozen(shifts)
        self.equilibrium = self.offset
        self.offset = frozen(-times(self.matrix, self.equilibrium) - self._pull(self.equilibrium))

    @cached_property
    def _transposed_prices(self) -> FloatArray:
        return frozen(self.prices.transpose(1, 0, 2))

    def _pull(self, strategies: FloatArray) -> FloatArray:
        """Mᵀ tanh(M x − r): (n, B) to (n, B)."""
        return times(self._transposed_prices, np.tanh(times(self.prices, strategies) - self.shift))

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (n, B) to (N, B)."""
        load = times(self.prices, strategies) - self.shift
        return super().costs(strategies) + ordered_sum(np.logaddexp(load, -load) - np.log(2))

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """Block i is that of F at x^i: (n, N, B) to (n, B)."""
        load = ordered_sum(self.prices[:, :, None] * estimates[None], axis=1) - self.shift[:, None]
        shares = self._transposed_prices * np.tanh(load)[:, self.owners].transpose(1, 0, 2)
        return super().own_gradients(estimates) + ordered_sum(shares, axis=1)

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """A + Mᵀ diag(1/cosh²(M x − r)) M: (n, B) to (n, n, B)."""
        slope = 1 - np.tanh(times(self.prices, strategies) - self.shift) ** 2
        bent = ordered_sum(self.prices[:, :, None] * (slope[:, None] * self.prices)[:, None], axis=0)
        return super().jacobian(strategies) + bent

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """The minimisers, by Newton's method to 1e-12: (n, B) to (n, B)."""
        batch = strategies.shape[1]
        same = (self.owners[:, None] == self.owners)[:, :, None]

        def profiles(response: FloatArray) -> FloatArray:
            """Column i holds the response of player i, and the strategies of the others."""
            own = (self.owners[:, None] == np.arange(self.num_players))[:, :, None]
            return np.where(own, response[:, None], strategies[:, None])

        def field(response: FloatArray) -> FloatArray:
            return self.own_gradients(profiles(response))

        def slopes(response: FloatArray) -> FloatArray:
            at = profiles(response)
            players = [self.jacobian(at[:, player]) for player in range(self.num_players)]
            return np.where(same, np.stack(players)[self.owners, np.arange(self.dimension)], 0.0)

        low, high = (np.full((self.dimension, batch), bound) for bound in (-np.inf, np.inf))
        return solve_box(field, slopes, low, high, strategies)

    def merged(self, fresh: Game, mask: BoolArray) -> Game:
        """The batch of games with those in ``mask`` (G,) replaced by those of ``fresh``, in order."""
        if fresh is self:
            return self
        names = ("matrix", "prices", "shift", "equilibrium")
        parameters = merged_parameters(SaturatingGame, self, fresh, mask, names)
        return SaturatingGame(action_dims=self.action_dims, **parameters)

    def _solve_nash_equilibria(self) -> FloatArray:
        return self.equilibrium


class RandomSaturating(GameFamily):
    """Games that are not affine: :class:`SaturatingGame` with A and x* of :class:`RandomAffine`.

    M has m rows with independent normal entries of variance c/n, so that saturated prices take up to c m/n off the
    slope of F; r = M x* + U(−2, 2), so that prices near x* are neither linear nor constant. ε ≥ ``epsilon``.

    Args:
        players: N ≥ 2.
        epsilon: ε > 0 of A.
        asymmetry: of A, ≥ 0.
        spread: of A, ≥ 0.
        scale: half-width of the box of equilibria, above 0.
        action_dim: n_i, one number for all or one per player.
        bend: c ≥ 0; 0 gives affine games.

    Raises:
        ValueError: for a number out of range.
    """

    is_strongly_monotone = True

    def __init__(
        self,
        players: int = 5,
        epsilon: float = 1.0,
        asymmetry: float = 1.0,
        spread: float = 2.0,
        scale: float = 10.0,
        action_dim: int | Sequence[int] = 1,
        bend: float = 3.0,
    ) -> None:
        self.bend = require_non_negative("bend", bend)
        self._affine = RandomAffine(players, epsilon, asymmetry, spread, scale, action_dim)
        if self._affine.epsilon == 0:
            raise ValueError("RandomSaturating needs epsilon > 0")
        self.representative = self.draw([np.random.default_rng(0)])

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One game per generator."""
        affine = self._affine.draw(generators)
        if not isinstance(affine, AffineGame):
            raise TypeError(f"RandomAffine draws affine games, got {type(affine).__name__}")
        n, equilibria = affine.dimension, affine.nash_equilibria
        prices = np.stack([generator.normal(size=(n, n)) for generator in generators], axis=-1)
        prices = prices * np.sqrt(self.bend / n)
        offset = np.stack([generator.uniform(-2, 2, n) for generator in generators], axis=-1)
        shift = times(prices, equilibria) + offset
        return SaturatingGame(affine.matrix, prices, shift, equilibria, affine.action_dims)
