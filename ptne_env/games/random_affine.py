"""Affine games: random strongly monotone, and merely monotone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptne_env.games.affine import AffineGame, times
from ptne_env.games.base import Game
from ptne_env.games.family import GameFamily
from ptne_env.shared.arrays import (
    ordered_sum,
    require_count,
    require_non_negative,
    require_positive,
)


class RandomAffine(GameFamily):
    """Affine games F(x) = A x + b with an exact monotonicity constant ε and a chosen asymmetry.

    A = ε I + Q diag(λ) Qᵀ + a K with Q a random orthogonal matrix, λ_k ~ U(0, spread) and one λ_k = 0, and K a random
    skew-symmetric matrix with ‖K‖₂ = 1, so that F is ε-strongly monotone with the largest possible constant ε, and
    potential for a = 0. The skew part is 0 within players' own blocks, which are Hessians. x* ~ U(−scale, scale), and
    b = −A x*. For ε = 0 and a > 0, F is monotone and not strongly: it rotates without pull in the direction in which
    λ_k = 0. x* is unique then too, almost surely.

    Args:
        players: N ≥ 2.
        epsilon: ε ≥ 0, and above 0 where the asymmetry is 0.
        asymmetry: a ≥ 0.
        spread: ≥ 0; dF + dFᵀ has eigenvalues in [2ε, 2(ε + spread)].
        scale: half-width of the box of equilibria, above 0.
        action_dim: n_i, one number for all or one per player.
        low: smallest strategy of all players; ``None`` for no bound. In a box x* solves the variational inequality.
        high: largest strategy.

    Raises:
        ValueError: for a number out of range.
    """

    def __init__(
        self,
        players: int = 5,
        epsilon: float = 1.0,
        asymmetry: float = 1.0,
        spread: float = 2.0,
        scale: float = 10.0,
        action_dim: int | Sequence[int] = 1,
        low: float | None = None,
        high: float | None = None,
    ) -> None:
        count = require_count("players", players, 2)
        dims = tuple(action_dim) if isinstance(action_dim, Sequence) else (action_dim,) * count
        if len(dims) != count:
            raise ValueError(f"action_dim is one number for all, or one per player ({count}), got {action_dim!r}")
        self.action_dims = tuple(require_count("action_dim", dim, 1) for dim in dims)
        self.asymmetry = require_non_negative("asymmetry", asymmetry)
        self.epsilon = (require_non_negative if self.asymmetry else require_positive)("epsilon", epsilon)
        if self.epsilon == 0:
            self.is_strongly_monotone = False
        self.spread = require_non_negative("spread", spread)
        self.scale = require_positive("scale", scale)
        self.bounds = low, high
        self.representative = self.draw([np.random.default_rng(0)])

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One affine game per generator."""
        n = sum(self.action_dims)
        owners = np.repeat(np.arange(len(self.action_dims)), self.action_dims)
        normal = np.stack([generator.normal(size=(2, n, n)) for generator in generators])
        unit = np.stack([generator.random((2, n)) for generator in generators])
        orthogonal = np.linalg.qr(normal[:, 0])[0].transpose(1, 2, 0)
        eigenvalues = self.spread * unit[:, 0].T
        eigenvalues[0] = 0.0
        root = orthogonal * np.sqrt(eigenvalues)
        symmetric = ordered_sum(root[:, None] * root[None], axis=2)
        skew = np.where((owners[:, None] == owners)[:, :, None], 0.0, normal[:, 1].transpose(1, 2, 0))
        skew = skew - skew.transpose(1, 0, 2)
        skew /= np.linalg.norm(np.moveaxis(skew, 2, 0), 2, axis=(1, 2))
        matrix = self.epsilon * np.eye(n)[:, :, None] + symmetric + self.asymmetry * skew
        equilibrium = self.scale * (2 * unit[:, 1].T - 1)
        return AffineGame(matrix, -times(matrix, equilibrium), self.action_dims, *self.bounds)


class WeaklyMonotoneGame(AffineGame):
    """J_i(x) = (x_i − x̄)² N/(N−1) + c_i(x) − d_i x_i up to terms of others, x̄ the mean of all strategies.

    The first player leads and the others follow, c_1 = a x_1 Σ_{j>1} x_j and c_i = −a x_i x_1. So
    dF = 2 (I − 11ᵀ/N) + a K with K skew-symmetric: each J_i is strictly convex in x_i and F is monotone, but not
    strongly: no cost depends on the mean alone, so 1ᵀ dF 1 = 0 and Assumption 4 fails. Yet dF is regular and the
    equilibrium unique. Here N = 5, d_i = i and a = 0.5.
    """

    def __init__(self) -> None:
        players, rotation = 5, 0.5
        follow = np.zeros((players, players))
        follow[0, 1:], follow[1:, 0] = 1.0, -1.0
        agree = 2 * (np.eye(players) - 1 / players)
        super().__init__(agree + rotation * follow, -np.arange(1.0, 1 + players))
