"""The constants of a game, strong monotonicity ε and Lipschitz continuity ι, and the bounds that follow from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ptne_env.games import Game
from ptne_env.shared.arrays import FloatArray, require_positive

ZERO = 1e-10
"""Below this fraction of a matrix's norm a number counts as zero: kernels of disconnected graphs are rounding."""

SAMPLES = 256
"""Points behind constants that are not exact."""


@dataclass(frozen=True)
class MonotonicityConstants:
    """The constants of Assumption 4.

    Where ``exact`` is false they come from sampled Jacobians: ε is then an upper bound and ι a lower bound of the
    constant on the sampled box, and nothing is known outside it.

    Attributes:
        epsilon: ε, the largest constant for which F is ε-strongly monotone; not positive when F is not.
        iota_strategies: ι_F, the Lipschitz constant of F on R^n.
        iota_estimates: the Lipschitz constant of the stacked **F** on R^{Nn}.
        exact: whether F is affine, so that the numbers are exact and global.
        radius: half-width of the sampled box around x*; ``None`` when exact.
    """

    epsilon: float
    iota_strategies: float
    iota_estimates: float
    exact: bool
    radius: float | None

    @property
    def iota(self) -> float:
        """The larger of the two Lipschitz constants, ι of the paper's eq. (15)."""
        return max(self.iota_strategies, self.iota_estimates)


def monotonicity_constants(game: Game, *, radius: float = 10.0) -> MonotonicityConstants:
    """ε and ι of Assumption 4: exact for affine F, sampled bounds otherwise.

    ε = λ_min of the symmetric part of dF, ι_F = ‖dF‖₂, and for **F** the largest ‖rows of player i in dF‖₂, since
    block i of **F** depends on x^i alone.

    Args:
        game: the game.
        radius: half-width of the box around x* from which points are drawn when F is not affine, and projected into
            the game's box.

    Raises:
        ValueError: when radius ≤ 0.
    """
    require_positive("radius", radius)
    points = game.nash_equilibrium[:, None]
    if not game.is_affine:
        generator = np.random.default_rng(0)
        points = game.project(points + generator.uniform(-radius, radius, (game.dimension, SAMPLES)))
    sampled = np.moveaxis(game.jacobian(points), 2, 0)
    symmetric = (sampled + sampled.transpose(0, 2, 1)) / 2
    blocks = [sampled[:, game.owners == player] for player in range(game.num_players)]
    smallest = float(np.linalg.eigvalsh(symmetric)[:, 0].min())
    return MonotonicityConstants(
        epsilon=0.0 if abs(smallest) <= ZERO * _largest_norm(symmetric) else smallest,
        iota_strategies=_largest_norm(sampled),
        iota_estimates=max(_largest_norm(block) for block in blocks),
        exact=game.is_affine,
        radius=None if game.is_affine else float(radius),
    )


def gain_bound(constants: MonotonicityConstants, algebraic_connectivity: float) -> float:
    """(ι²/ε + ι)/λ2, which κ must exceed in Theorem 1 (its eq. (15)); infinite when ε or λ2 is not positive."""
    epsilon, iota = constants.epsilon, constants.iota
    if epsilon <= 0 or algebraic_connectivity <= 0:
        return math.inf
    return (iota**2 / epsilon + iota) / algebraic_connectivity


def jacobian_at_equilibrium(game: Game) -> FloatArray:
    """dF(x*), shape (n, n)."""
    return game.jacobian(game.nash_equilibrium[:, None])[:, :, 0]


def _largest_norm(matrices: FloatArray) -> float:
    return float(np.linalg.svd(matrices, compute_uv=False)[:, 0].max())
