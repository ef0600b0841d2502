"""Games with another origin."""

from __future__ import annotations

from functools import cached_property

from ptne_env.games.base import Game
from ptne_env.shared.arrays import BoolArray, FloatArray, frozen, replaced


class MovedGame(Game):
    """The game J_i(x − δ) of a game J_i without a box: F(x − δ), whose equilibrium is x* + δ.

    Distances stay relative to ‖x*‖ of the original game, so that they do not depend on δ.

    Args:
        game: the original, one game or B games.
        offset: δ, shape (n, B); never changed in place.

    Raises:
        ValueError: when the game has a box, which would have to move too.
    """

    def __init__(self, game: Game, offset: FloatArray) -> None:
        if game.has_bounds:
            raise ValueError(f"{type(game).__name__} has a box and cannot move; choose a game without bounds")
        super().__init__(game.action_dims)
        self.game, self.offset = game, offset
        self.is_affine = game.is_affine

    @property
    def batch_size(self) -> int:
        """B, the number of offsets."""
        return self.offset.shape[1]

    @property
    def has_best_response(self) -> bool:
        """Whether the original has it."""
        return self.game.has_best_response

    def costs(self, strategies: FloatArray) -> FloatArray:
        """J_i(x − δ): (n, B) to (N, B)."""
        return self.game.costs(strategies - self.offset)

    def own_gradients(self, estimates: FloatArray) -> FloatArray:
        """∂J_i/∂x_i(x^i − δ): (n, N, B) to (n, B)."""
        return self.game.own_gradients(estimates - self.offset[:, None])

    def best_response(self, strategies: FloatArray) -> FloatArray:
        """The original's at x − δ, plus δ: (n, B) to (n, B).

        Raises:
            NoBestResponseError: as the original.
        """
        return self.game.best_response(strategies - self.offset) + self.offset

    def jacobian(self, strategies: FloatArray) -> FloatArray | None:
        """dF(x − δ): (n, B) to (n, n, B); ``None`` where it is unknown."""
        return self.game.jacobian(strategies - self.offset)

    def merged(self, fresh: Game, mask: BoolArray) -> MovedGame:
        """The games and offsets with those in ``mask`` (B,) replaced by those of ``fresh``.

        Raises:
            TypeError: when ``fresh`` is another kind of game.
        """
        if not isinstance(fresh, MovedGame):
            raise TypeError(f"a moved game merges with moved games, got a {type(fresh).__name__}")
        return MovedGame(self.game.merged(fresh.game, mask), replaced(self.offset, fresh.offset, mask))

    @cached_property
    def nash_equilibria(self) -> FloatArray:
        """x* + δ, shape (n, B), read-only.

        Raises:
            ArithmeticError: as the original.
        """
        return frozen(self.game.nash_equilibria + self.offset)

    @property
    def equilibrium_scale(self) -> FloatArray:
        """‖x*‖ of the original, shape (G,), read-only."""
        return self.game.equilibrium_scale
