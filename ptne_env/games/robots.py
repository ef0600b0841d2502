"""Connectivity control of robots in the plane."""

from __future__ import annotations

import numpy as np

from ptne_env.games.affine import AffineGame
from ptne_env.shared.arrays import FloatArray, frozen, ordered_sum

_POSTS = frozen([(8.0, 0.0), (2.0, 8.0), (-7.0, 5.0), (-6.0, -5.0), (3.0, -7.0)])
"""p_i of each robot."""

_TOUCH = frozen(
    [
        (0.0, 0.6, 0.0, 0.0, 0.2),
        (0.2, 0.0, 0.6, 0.0, 0.0),
        (0.0, 0.2, 0.0, 0.6, 0.0),
        (0.0, 0.0, 0.2, 0.0, 0.6),
        (0.6, 0.0, 0.0, 0.2, 0.0),
    ]
)
"""c_ij."""

_PULL = 0.6
"""w_i of every robot."""


class ConnectivityControl(AffineGame):
    """J_i(x) = w_i ‖x_i − p_i‖² + Σ_j c_ij ‖x_i − x_j‖²: robots in the plane stay near their posts p_i.

    Connectivity control of mobile sensors, after M. S. Stanković, K. H. Johansson and D. M. Stipanović, "Distributed
    seeking of Nash equilibria with applications to mobile sensor networks", IEEE Transactions on Automatic Control
    57(4), 2012; the numbers are ours. c need not be symmetric, so the game is no potential game. With L_c = diag(Σ_j
    c_ij) − c the equilibrium is X = (diag(w) + L_c)⁻¹ diag(w) P, one column per coordinate, and F is strongly monotone
    where diag(w) + (L_c + L_cᵀ)/2 is positive definite. Coordinates of a robot are adjacent components.
    """

    def __init__(self) -> None:
        attraction = np.diag(_PULL + _TOUCH.sum(axis=1)) - _TOUCH
        super().__init__(np.kron(2 * attraction, np.eye(2)), -2 * (_PULL * _POSTS).ravel(), (2,) * len(_POSTS))

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x): (2N, B) to (N, B)."""
        at = strategies.reshape(self.num_players, 2, -1)
        from_post = ordered_sum((at - _POSTS[:, :, None]) ** 2, axis=1)
        apart = ordered_sum((at[:, None] - at[None]) ** 2, axis=2)
        return _PULL * from_post + ordered_sum(_TOUCH[:, :, None] * apart, axis=1)
