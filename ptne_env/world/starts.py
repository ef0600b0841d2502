"""Initial estimates of an episode."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from ptne_env.shared.arrays import FloatArray, frozen
from ptne_env.shared.parts import Part


class Start(Part, ABC):
    """The distribution of the initial estimates."""

    is_random: bool = False
    """Whether two draws differ."""

    @abstractmethod
    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:
        """Initial estimates of one environment, shape (n, N): column i is x^i(0).

        Raises:
            ValueError: when the start is for another number of players or another dimension.
        """


class UniformStart(Start):
    """Independent entries x^i_j(0) ~ U(low, high).

    Raises:
        ValueError: unless low < high, both finite.
    """

    is_random = True

    def __init__(self, low: float = -20.0, high: float = 20.0) -> None:
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(f"UniformStart needs finite low < high, got {low!r} and {high!r}")
        self.low, self.high = float(low), float(high)

    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:
        """Drawn estimates, shape (n, N)."""
        return generator.uniform(self.low, self.high, size=(dimension, num_players))


class FixedStart(Start):
    """The same estimates in every episode.

    Args:
        estimates: one row per player, the row of player i being x^i(0); shape (N, n).

    Raises:
        ValueError: when the rows are not finite numbers of one length.
    """

    def __init__(self, estimates: Sequence[Sequence[float]]) -> None:
        try:
            rows = np.asarray(estimates, dtype=np.float64)
        except ValueError as error:
            raise ValueError(f"FixedStart needs rows of numbers of one length: {error}") from error
        if rows.ndim != 2 or not np.all(np.isfinite(rows)):
            raise ValueError(f"FixedStart needs a finite (N, n) table, got the shape {rows.shape}")
        self.estimates = frozen(rows.T)

    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:  # noqa: ARG002
        """The fixed estimates, shape (n, N)."""
        if self.estimates.shape != (dimension, num_players):
            raise ValueError(
                f"this start is for {self.estimates.shape[1]} players and dimension {self.estimates.shape[0]}, "
                f"the game has {num_players} and {dimension}; choose start='random' or another table"
            )
        return self.estimates.copy()


class PaperStart(Start):
    """The start of both examples: own strategies −2, −4, −6, … by player, and the rest of x^i(0) is …, 15, 10, 5, 0.

    The paper has five players; the pattern goes on for other numbers.
    """

    def draw(self, num_players: int, dimension: int, generator: np.random.Generator) -> FloatArray:  # noqa: ARG002
        """The table, shape (N, N)."""
        if dimension != num_players:
            raise ValueError(
                f"the paper's start is for one component per player, the game has {num_players} players and "
                f"{dimension} components; choose start='random' or another table"
            )
        player = np.arange(num_players)
        component = player[:, None]
        rest = 5.0 * (num_players - 1 - component - (component < player))
        return np.where(component == player, -2.0 * (player + 1), rest)
