"""Initial estimates of an episode."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.shared.arrays import FloatArray, freeze
from ptne_env.shared.parts import Part


class Start(Part, ABC):
    """The distribution of the initial estimates."""

    is_random: ClassVar[bool] = False
    """Whether two draws differ."""

    @abstractmethod
    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:
        """Return the initial estimates of one environment, shape (n, N); column i is x^i(0).

        Raises:
            ValueError: when the start is for another number of players or another dimension.
        """


class UniformStart(Start):
    """Independent entries x^i_j(0) ~ U(low_j, high_j).

    Attributes:
        low: the smallest estimates, one number for all components or (n,).
        high: the largest, likewise; a ``ValueError`` unless low < high, both finite.
    """

    is_random = True

    low: npt.ArrayLike = -20.0
    high: npt.ArrayLike = 20.0

    def __post_init__(self) -> None:
        shapes = {(), np.shape(self.low), np.shape(self.high)}
        if len(shapes) > 2 or self.bounds.ndim > 3 or not np.all(np.isfinite(self.bounds) & np.less(*self.bounds)):
            raise ValueError(
                f"UniformStart needs finite low < high, each a number or (n,), got {self.low!r} and {self.high!r}"
            )

    @cached_property
    def bounds(self) -> FloatArray:
        """Low and high, (2, n, 1), or (2, 1) where they are one number for all components."""
        return freeze(np.broadcast_arrays(self.low, self.high))[..., None]

    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:
        low, high = self.bounds
        if low.size not in (1, dimension):
            raise ValueError(f"this start has bounds for {low.size} components, the game has {dimension}")
        return low + (high - low) * generator.random((dimension, num_players))  # faster than generator.uniform


class FixedStart(Start):
    """The same estimates in every episode.

    Attributes:
        estimates: one row per player, the row of player i being x^i(0), shape (N, n); a ``ValueError`` unless the rows
            are finite numbers of one length.
    """

    estimates: npt.ArrayLike

    def __post_init__(self) -> None:
        try:
            rows = self._rows
        except ValueError as error:
            raise ValueError(f"FixedStart needs rows of numbers of one length: {error}") from error
        if rows.ndim != 2 or not np.all(np.isfinite(rows)):
            raise ValueError(f"FixedStart needs a finite (N, n) table, got the shape {rows.shape}")

    @cached_property
    def _rows(self) -> FloatArray:
        return freeze(self.estimates)

    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:  # noqa: ARG002
        if self._rows.shape != (num_players, dimension):
            raise ValueError(
                f"this start is for {self._rows.shape[0]} players and dimension {self._rows.shape[1]}, the game has "
                f"{num_players} and {dimension}; choose start='random' or another table"
            )
        return self._rows.T.copy()


class PaperStart(Start):
    """The start of both examples: own strategies −2, −4, −6, … by player, and the rest of x^i(0) is …, 15, 10, 5, 0.

    The paper has five players; the pattern goes on for other numbers.
    """

    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:  # noqa: ARG002
        if dimension != num_players:
            raise ValueError(
                f"the paper's start is for one component per player, the game has {num_players} players and "
                f"{dimension} components; choose start='random' or another table"
            )
        player = np.arange(num_players)
        component = player[:, None]
        rest = 5.0 * (num_players - 1 - component - (component < player))
        return np.where(component == player, -2.0 * (player + 1), rest)
