"""Games with a shared constraint g(x) ≤ 0, which a market operator prices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ptne_env.games.affine import QuadraticGame, times
from ptne_env.games.base import Game, GameFamily, NoBestResponseError
from ptne_env.games.costs import CostGame, as_rows
from ptne_env.shared.arrays import BoolArray, FloatArray, array_namespace, ordered_sum, require_count
from ptne_env.shared.parts import checked

_Constraint: TypeAlias = npt.ArrayLike | Callable[[Any], Any]
_OPERATOR = "the operator of others is one more player of their costs, who pays -price * g(x)"


def price_constraint(game: Game, constraint: _Constraint, limit: npt.ArrayLike = 0.0) -> QuadraticGame | PricedGame:
    """Put the players of a game under the constraint g(x) ≤ 0, and add a market operator, who prices it.

    Player i pays for the constraint, J_i(x) + μᵀ g(x); where g(x) = C x − b, μᵀ C_i x_i is its share. The operator, the
    last player, chooses the prices μ ≥ 0 and minimises −μᵀ g(x). The Nash equilibria (x*, μ*) of this game are the
    solutions of

        F(x) + dg(x)ᵀ μ = 0,  0 ≤ μ ⊥ −g(x) ≥ 0,

    the Karush–Kuhn–Tucker conditions of the variational inequality of F on {g(x) ≤ 0}, where each g_l is convex. So x*
    is the variational generalised Nash equilibrium, at which all players see the same multipliers μ*; see F. Facchinei
    and C. Kanzow, "Generalized Nash equilibrium problems", 4OR 5(3), 2007, and, for the operator as a player, K. J.
    Arrow and G. Debreu, "Existence of an equilibrium for a competitive economy", Econometrica 22(3), 1954.

    For C x ≤ b the Jacobian [[dF, Cᵀ], [−C, 0]] is monotone where dF is, and never strongly monotone. Where F is
    strongly monotone, x* is unique, and so is μ* where the gradients of active constraints are independent. The
    operator has no best response: its cost is linear on [0, ∞).

    Args:
        game: with bounds, they stay. Where it is affine and the constraint is C, the game is affine too, or a batch.
        constraint: C, (m, n), or (m, n, G) for a batch of games; or the function g of x, (n, B) to (m, B), which obeys
            the rules of the costs of a :class:`~ptne_env.games.CostGame`.
        limit: b, (m,) or (m, G); 0 by default. A function's values may not exceed it either.

    Raises:
        ValueError: when shapes disagree, or the function or the costs cannot be differentiated.
    """
    given: Any = game
    if not isinstance(given, Game):
        raise ValueError(
            f"the players are those of one game, got a {type(given).__name__}; a family of affine games goes into "
            f"CoupledConstraint, and {_OPERATOR}"
        )
    if callable(constraint) or not game.is_affine:
        return PricedGame(game=game, constraint=constraint, limit=limit)
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
    low, high = (np.append(side, np.full(lines, bound)) for side, bound in zip(game.bounds, (0.0, np.inf), strict=True))
    return QuadraticGame(matrix, offset, (*game.action_dims, lines), low, high)


class PricedGame(CostGame):
    """A single game under a shared constraint that is not affine, or whose costs are not; see :func:`price_constraint`.

    Attributes:
        game: that of the players.
        constraint: C, (m, n), or the function g.
        limit: b, one number for all or (m,).
    """

    function = None
    game: Game  # type: ignore[misc]  # the fields of the base are no arguments here, so none has a default
    constraint: _Constraint  # type: ignore[misc]  # likewise
    limit: npt.ArrayLike = 0.0

    def __post_init__(self) -> None:
        n, shape = self.game.dimension, () if callable(self.constraint) else np.shape(self.constraint)
        if self.game.batch_size != 1:
            raise ValueError(
                f"several games have a price together where they are affine and the constraint is a matrix, got "
                f"{self.game.batch_size} games; {_OPERATOR}"
            )
        if not (callable(self.constraint) or shape[1:] == (n,)):
            raise ValueError(
                f"the constraint of a game of {n} components is a function of x or a matrix (m, {n}), got {shape}"
            )
        super().__post_init__()

    @cached_property  # type: ignore[misc]  # the base takes it as an argument
    def action_dims(self) -> tuple[int, ...]:
        """Those of the game, and m for the operator."""
        origin = self.game.project(np.zeros((self.game.dimension, 1)))
        return (*self.game.action_dims, len(self._excess(origin)))

    @cached_property  # type: ignore[misc]  # the base takes it as an argument
    def low(self) -> FloatArray:
        """Those of the game, and 0 for prices."""
        return np.append(self.game.bounds[0], np.zeros(self.action_dims[-1]))

    @cached_property  # type: ignore[misc]  # the base takes it as an argument
    def high(self) -> FloatArray:
        """Those of the game, and none for prices."""
        return np.append(self.game.bounds[1], np.full(self.action_dims[-1], np.inf))

    def _excess(self, strategies: FloatArray) -> FloatArray:
        """g(x) − b, or C x − b: (n, B) to (m, B)."""
        if callable(self.constraint):
            values = as_rows(self.constraint(strategies), strategies)
        else:
            values = times(np.asarray(self.constraint)[:, :, None], strategies)
        return values - np.reshape(self.limit, (-1, 1))

    def costs(self, strategies: FloatArray) -> FloatArray:
        n = self.game.dimension
        bill = ordered_sum(strategies[n:] * self._excess(strategies[:n]))
        return array_namespace(strategies).concatenate([self.game.costs(strategies[:n]) + bill, -bill[None]])

    def best_response(self, strategies: FloatArray) -> FloatArray:  # noqa: ARG002 - there is none
        raise NoBestResponseError("the operator of a shared constraint has no best response: its cost is linear")

    def _respond(self, strategies: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the best responses of the players, and the operator's own strategy."""
        response, found = super()._respond(strategies)
        found[-1], prices = True, self.owners == self.num_players - 1
        return np.where(prices[:, None], strategies, response), found


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
        typical = self.game.representative
        if not typical.is_affine or typical.box is not None:
            raise ValueError(
                "CoupledConstraint needs an affine game without bounds, which need not agree with the constraint, got "
                f"{type(typical).__name__}"
            )

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        game = self.game.draw(generators)
        unit = np.stack([generator.random((self.lines, game.dimension + 1)) for generator in generators], axis=-1)
        loads, tightness = unit[:, :-1], -0.1 + 0.4 * unit[:, -1]
        free = np.broadcast_to(game.nash_equilibria, (game.dimension, len(generators)))
        shift = np.sqrt(ordered_sum(loads**2, axis=1) * ordered_sum(free**2))
        limits = ordered_sum(loads * free, axis=1) - tightness * shift
        return price_constraint(game, loads, limits)
