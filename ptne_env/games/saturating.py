"""Random games that are strongly monotone and not affine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.games.affine import AffineGame, RandomAffine, times
from ptne_env.games.base import Game, GameFamily, require_strong_monotonicity
from ptne_env.games.variational import solve_box
from ptne_env.shared.arrays import FloatArray, array_namespace, freeze, ordered_sum, require_non_negative, with_games
from ptne_env.shared.parts import checked


class SaturatingGame(AffineGame):
    """F(x) = A (x − x*) + Mᵀ (tanh(M x − r) − tanh(M x* − r)), a game with prices that saturate.

    J_i is that of :class:`AffineGame` and Σ_l log cosh((M x − r)_l), convex in x and the same for all players; dF =
    A + Mᵀ diag(1/cosh²(M x − r)) M, so F is strongly monotone and Lipschitz wherever A is positive definite, with
    ε ≥ ε(A) and ι ≤ ‖A‖ + ‖M‖². The game is given by its equilibrium x*, which is therefore exact.

    Attributes:
        matrix: A, (n, n) or (n, n, G), as in :class:`AffineGame`.
        prices: M, (m, n) or (m, n, G).
        shift: r, (m,) or (m, G).
        equilibrium: x*, (n,) or (n, G).
        action_dims: n_i of each player; by default 1 for all.

    Raises:
        ValueError: when shapes disagree, or as :class:`AffineGame`.
    """

    is_affine = False
    parameters: ClassVar[Mapping[str, int]] = {"matrix": 2, "prices": 2, "shift": 1, "equilibrium": 1}

    matrix: npt.ArrayLike
    prices: npt.ArrayLike
    shift: npt.ArrayLike
    equilibrium: npt.ArrayLike
    action_dims: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        vars(self)["action_dims"] = self.action_dims or (1,) * len(self.equilibria)
        lines, games = len(self.shifts), self.equilibria.shape[-1]
        if self.all_prices.shape != (lines, self.dimension, games) or self.shifts.shape != (lines, games):
            raise ValueError(
                f"SaturatingGame: prices are (m, {self.dimension}) and shift (m,), with a last axis for games where "
                f"there are several; got {np.shape(self.prices)} and {np.shape(self.shift)}"
            )
        super().__post_init__()

    @cached_property
    def all_prices(self) -> FloatArray:
        """M of every game, shape (m, n, G), read-only."""
        return with_games(self.prices, 2)

    @cached_property
    def shifts(self) -> FloatArray:
        """The vector r of every game, shape (m, G), read-only."""
        return with_games(self.shift, 1)

    @cached_property
    def equilibria(self) -> FloatArray:
        """x* of every game, shape (n, G), read-only."""
        return with_games(self.equilibrium, 1)

    @cached_property
    def offset(self) -> FloatArray:
        """The vector b = −A x* − Mᵀ tanh(M x* − r), shape (n, G), read-only."""
        saturated = array_namespace(self.equilibria).tanh(times(self.all_prices, self.equilibria) - self.shifts)
        return freeze(-times(self.matrices, self.equilibria) - times(self._transposed_prices, saturated))

    @cached_property
    def _transposed_prices(self) -> FloatArray:
        return freeze(self.all_prices.transpose(1, 0, 2))

    def costs(self, strategies: FloatArray) -> FloatArray:
        load = times(self.all_prices, strategies) - self.shifts
        return super().costs(strategies) + ordered_sum(array_namespace(load).logaddexp(load, -load) - np.log(2))

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """Block i is that of F at x^i: (n, N, B) to (n, B)."""
        load = ordered_sum(self.all_prices[:, :, None] * estimates[None], axis=1) - self.shifts[:, None]
        shares = self._transposed_prices * array_namespace(load).tanh(load)[:, self.owners].transpose(1, 0, 2)
        return super().own_gradients(estimates) + ordered_sum(shares, axis=1)

    def jacobian(self, strategies: FloatArray) -> FloatArray:
        """A + Mᵀ diag(1/cosh²(M x − r)) M: (n, B) to (n, n, B)."""
        slope = 1 - np.tanh(times(self.all_prices, strategies) - self.shifts) ** 2
        bent = ordered_sum(self.all_prices[:, :, None] * (slope[:, None] * self.all_prices)[:, None], axis=0)
        return super().jacobian(strategies) + bent

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """The minimisers, by Newton's method to 1e-12: (n, B) to (n, B)."""
        same = (self.owners[:, None] == self.owners)[:, :, None]

        def field(response: FloatArray) -> FloatArray:
            return self.own_gradients(self.deviations(strategies, response))

        def slopes(response: FloatArray) -> FloatArray:
            at = self.deviations(strategies, response)
            players = [self.jacobian(at[:, player]) for player in range(self.num_players)]
            return np.where(same, np.stack(players)[self.owners, np.arange(self.dimension)], 0.0)

        return solve_box(field, slopes, *self.bounds, strategies)

    def _solve_nash_equilibria(self) -> FloatArray:
        return self.equilibria


class RandomSaturating(GameFamily):
    """Games that are not affine: :class:`SaturatingGame` with A and x* of a strongly monotone affine family.

    M has n rows with independent normal entries of variance c/n, so the slope of F in each direction falls by about c
    where all prices are saturated; r = M x* + U(−2, 2), so prices near x* are neither linear nor constant. F is
    strongly monotone with the ε of the affine game.

    Attributes:
        affine: the family, without bounds.
        bend: c ≥ 0; 0 gives affine games.

    Raises:
        ValueError: when the family is not affine, not strongly monotone or has bounds, or c is negative.
    """

    is_strongly_monotone = True

    affine: GameFamily = RandomAffine()
    bend: float = checked(require_non_negative, default=3.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        typical = self.affine.representative
        if not typical.is_affine or typical.box is not None or self.affine.is_strongly_monotone is False:
            raise ValueError(
                "RandomSaturating needs a family of affine games without bounds that are strongly monotone, such as "
                f"RandomAffine(), got {type(self.affine).__name__}"
            )

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        affine = self.affine.draw(generators)
        require_strong_monotonicity(affine)
        n, equilibria = affine.dimension, affine.nash_equilibria
        prices = np.stack([generator.normal(size=(n, n)) for generator in generators], axis=-1)
        prices = prices * np.sqrt(self.bend / n)
        offset = np.stack([generator.uniform(-2, 2, n) for generator in generators], axis=-1)
        shift = times(prices, equilibria) + offset
        matrix = np.asarray(affine.jacobian(equilibria), dtype=np.float64)
        return SaturatingGame(matrix, prices, shift, equilibria, affine.action_dims)
