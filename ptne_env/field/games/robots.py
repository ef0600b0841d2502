"""Connectivity control of robots in the plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ptne_env.games.affine import AffineGame
from ptne_env.shared.arrays import FloatArray, frozen, ordered_sum

_POSTS = ((8.0, 0.0), (2.0, 8.0), (-7.0, 5.0), (-6.0, -5.0), (3.0, -7.0))
_TOUCH = (
    (0.0, 0.6, 0.0, 0.0, 0.2),
    (0.2, 0.0, 0.6, 0.0, 0.0),
    (0.0, 0.2, 0.0, 0.6, 0.0),
    (0.0, 0.0, 0.2, 0.0, 0.6),
    (0.6, 0.0, 0.0, 0.2, 0.0),
)


class ConnectivityControl(AffineGame):
    """J_i(x) = w_i ‖x_i − p_i‖² + Σ_j c_ij ‖x_i − x_j‖²: robots in the plane stay near their posts p_i.

    Connectivity control of mobile sensors, after M. S. Stanković, K. H. Johansson and D. M. Stipanović, "Distributed
    seeking of Nash equilibria with applications to mobile sensor networks", IEEE Transactions on Automatic Control
    57(4), 2012; the numbers are ours. c need not be symmetric, so the game is no potential game. With L_c = diag(Σ_j
    c_ij) − c the equilibrium is X = (diag(w) + L_c)⁻¹ diag(w) P, one column per coordinate, and F is strongly monotone
    where diag(w) + (L_c + L_cᵀ)/2 is positive definite. Coordinates of a robot are adjacent components.

    Args:
        posts: p_i, which set N; two coordinates each.
        touch: c_ij ≥ 0 with a diagonal of 0, (N, N).
        pull: w_i > 0 of every post, or one number for all.

    Raises:
        ValueError: when shapes disagree or a number is out of range.
    """

    def __init__(
        self,
        posts: Sequence[Sequence[float]] = _POSTS,
        touch: Sequence[Sequence[float]] = _TOUCH,
        pull: float | Sequence[float] = 0.6,
    ) -> None:
        places, weights = np.asarray(posts, dtype=np.float64), np.asarray(touch, dtype=np.float64)
        robots = len(places)
        if places.shape != (robots, 2) or weights.shape != (robots, robots):
            raise ValueError(
                f"ConnectivityControl needs posts (N, 2) and touch (N, N), got {places.shape} and {weights.shape}"
            )
        if np.shape(pull) not in ((), (robots,)):
            raise ValueError(f"pull is one number, or one per robot ({robots}), got {pull!r}")
        pulls = np.broadcast_to(np.asarray(pull, dtype=np.float64), robots)
        if not (weights.min() >= 0 and np.all(np.diag(weights) == 0) and pulls.min() > 0):
            raise ValueError("ConnectivityControl needs touch ≥ 0 with a diagonal of 0, and pull > 0")
        self.posts, self.touch, self.pull = frozen(places), frozen(weights), frozen(pulls)
        attraction = np.diag(pulls + weights.sum(axis=1)) - weights
        super().__init__(np.kron(2 * attraction, np.eye(2)), -2 * (pulls[:, None] * places).ravel(), (2,) * robots)

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (2N, B) to (N, B)."""
        at = strategies.reshape(self.num_players, 2, -1)
        from_post = ordered_sum((at - self.posts[:, :, None]) ** 2, axis=1)
        apart = ordered_sum((at[:, None] - at[None]) ** 2, axis=2)
        return self.pull[:, None] * from_post + ordered_sum(self.touch[:, :, None] * apart, axis=1)
