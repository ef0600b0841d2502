"""Games with a shared constraint C x ≤ b, which a market operator prices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ptne_env.games.affine import QuadraticGame
from ptne_env.games.base import Game, GameFamily
from ptne_env.shared.arrays import ordered_sum, require_count
from ptne_env.shared.parts import checked


def price_constraint(game: Game, constraint: npt.ArrayLike, limit: npt.ArrayLike) -> QuadraticGame:
    """Put the players of a game under the constraint C x ≤ b, and add a market operator, who prices it.

    Player i pays for its share of the constraint, J_i(x) + μᵀ C_i x_i. The operator, the last player, chooses the
    prices μ ≥ 0 and minimises μᵀ (b − C x). The Nash equilibria (x*, μ*) of this game are the solutions of

        F(x) + Cᵀ μ = 0,  0 ≤ μ ⊥ b − C x ≥ 0,

    the Karush–Kuhn–Tucker conditions of the variational inequality of F on {C x ≤ b}. So x* is the variational
    generalised Nash equilibrium, at which all players see the same multipliers μ*; see F. Facchinei and C. Kanzow,
    "Generalized Nash equilibrium problems", 4OR 5(3), 2007, and, for the operator as a player, K. J. Arrow and G.
    Debreu, "Existence of an equilibrium for a competitive economy", Econometrica 22(3), 1954.

    The Jacobian [[dF, Cᵀ], [−C, 0]] is monotone where dF is, and never strongly monotone. Where F is strongly monotone,
    x* is unique, and so is μ* where the rows of C of active constraints are independent. The operator has no best
    response: its cost is linear on [0, ∞).

    Args:
        game: affine; with bounds, they stay.
        constraint: C, (m, n), or (m, n, G) for a batch of games.
        limit: b, (m,) or (m, G).

    Raises:
        ValueError: when the game is not affine, or shapes disagree.
    """
    if not game.is_affine:
        raise ValueError(f"the constraint of {type(game).__name__} cannot be priced: its F is not affine")
    n = game.dimension
    rows, limits = np.asarray(constraint, dtype=np.float64), np.asarray(limit, dtype=np.float64)
    rows, limits = rows.reshape(*rows.shape[:2], -1), limits.reshape(len(limits), -1)
    batches = {game.batch_size, rows.shape[-1], limits.shape[1]}
    games = max(batches)
    if rows.ndim != 3 or rows.shape[1] != n or len(limits) != len(rows) or batches - {1, games}:
        raise ValueError(
            f"the players have {n} components, so constraint is (m, {n}) and limit (m,), with a last axis for games "
            f"where there are several; got {np.shape(constraint)} and {np.shape(limit)} for {game.batch_size} games"
        )
    lines, origin = len(rows), np.zeros((n, games))
    matrix = np.zeros((n + lines, n + lines, games))
    matrix[:n, :n] = game.jacobian(origin)
    matrix[:n, n:], matrix[n:, :n] = rows.transpose(1, 0, 2), -rows
    offset = np.concatenate([game.pseudo_gradient(origin), np.broadcast_to(limits, (lines, games))])
    low, high = game.box or (np.full((n, 1), -np.inf), np.full((n, 1), np.inf))
    low, high = np.append(low, np.zeros(lines)), np.append(high, np.full(lines, np.inf))
    return QuadraticGame(matrix, offset, (*game.action_dims, lines), low, high)


class CoupledConstraint(GameFamily):
    """The games of another family under m random shared constraints C x ≤ b; see :func:`price_constraint`.

    C_lk ~ U(0, 1) is the load of strategy k on line l, and b_l = C_l x° − t_l ‖C_l‖ ‖x°‖ with x° the equilibrium
    without constraints and t_l ~ U(−0.1, 0.3): the distance of x° from the half-space, relative to ‖x°‖. So line l
    alone is active at the equilibrium where t_l > 0, three of four.

    Attributes:
        game: an affine game or a family of affine games, without bounds.
        lines: m ≥ 1.

    Raises:
        ValueError: when the game is not affine or has bounds, or a number is out of range.
    """

    is_strongly_monotone = False

    game: Game | GameFamily
    lines: int = checked(require_count, 1, default=2)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.game.representative.has_bounds:
            raise ValueError("CoupledConstraint needs a game without bounds, which need not agree with the constraint")
        _ = self.representative  # refuses a game that is not affine

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        game = self.game.draw(generators)
        unit = np.stack([generator.random((self.lines, game.dimension + 1)) for generator in generators], axis=-1)
        loads, tightness = unit[:, :-1], -0.1 + 0.4 * unit[:, -1]
        free = np.broadcast_to(game.nash_equilibria, (game.dimension, len(generators)))
        shift = np.sqrt(ordered_sum(loads**2, axis=1) * ordered_sum(free**2))
        limits = ordered_sum(loads * free, axis=1) - tightness * shift
        return price_constraint(game, loads, limits)
