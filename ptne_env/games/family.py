"""Families of games; every episode draws a member."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from ptne_env.games.base import Game
from ptne_env.games.energy import EnergyGame
from ptne_env.shared.arrays import FloatArray, require_count
from ptne_env.shared.parts import Part


class GameFamily(Part, ABC):
    """A distribution of games with the same players and dimensions.

    Attributes:
        representative: a typical member, with the players, dimensions and parameters of all.
        is_strongly_monotone: whether Assumption 4 holds for all members by construction, or is given up; ``None`` where
            a world checks it for every draw, which must then be affine.
    """

    representative: Game
    is_strongly_monotone: bool | None = None

    @abstractmethod
    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One game per generator, as a batch of G = ``len(generators)`` games."""


class SingleGame(GameFamily):
    """The family with a single member."""

    def __init__(self, game: Game) -> None:
        self.representative = game

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:  # noqa: ARG002 - nothing is drawn
        """The game itself, for any number of environments."""
        return self.representative


class RandomEnergy(GameFamily):
    """Energy games with a_i ~ U(0.5, 2), b_i ~ U(5, 35), c ~ U(0.05, 0.3) and d = 10, independently.

    F is strongly monotone for every draw: dF = diag(2a + c) + c 11ᵀ is positive definite.

    Args:
        players: N ≥ 2.
        curvature: range of a_i, positive.
        target: range of b_i.
        coupling: range of c, not negative.
        base_price: d.

    Raises:
        ValueError: when a range is empty or contains parameters that :class:`EnergyGame` refuses.
    """

    def __init__(
        self,
        players: int = 5,
        curvature: tuple[float, float] = (0.5, 2.0),
        target: tuple[float, float] = (5.0, 35.0),
        coupling: tuple[float, float] = (0.05, 0.3),
        base_price: float = 10.0,
    ) -> None:
        self.players, self.target = require_count("players", players, 2), target
        for name, (low, high) in {"curvature": curvature, "target": target, "coupling": coupling}.items():
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ValueError(f"RandomEnergy needs a finite range low < high for {name}, got {(low, high)!r}")
        ranges = [curvature] * players + [target] * players + [coupling]
        self._low, self._high = np.array(ranges, dtype=np.float64).T
        self.base_price = float(base_price)
        self._game(self._low)  # refuses extreme parameters now instead of during a run
        self.representative = self._game((self._low + self._high) / 2)

    def draw(self, generators: Sequence[np.random.Generator]) -> Game:
        """One energy game per generator."""
        size = self._low.size
        unit = np.stack([generator.random(size) for generator in generators], axis=-1)
        return self._game(self._numbers(unit))

    def parameters(self, unit: FloatArray) -> dict[str, FloatArray]:
        """The parameters of games by name, from independent U(0, 1) of shape (2 N + 1, G)."""
        return self._named(self._numbers(unit))

    def _numbers(self, unit: FloatArray) -> FloatArray:
        return self._low[:, None] + (self._high - self._low)[:, None] * unit

    def _named(self, numbers: FloatArray) -> dict[str, FloatArray]:
        players = self.players
        return {"curvature": numbers[:players], "target": numbers[players:-1], "coupling": numbers[-1]}

    def _game(self, numbers: FloatArray) -> EnergyGame:
        return EnergyGame(**self._named(numbers), base_price=self.base_price)


def require_strong_monotonicity(game: Game) -> None:
    """Check Assumption 4 on every game of a batch with affine F, whose Jacobian is the same everywhere.

    Raises:
        ValueError: naming the first game whose dF has no positive definite symmetric part.
    """
    if not game.is_affine:
        raise ValueError(
            f"strong monotonicity of {type(game).__name__} cannot be decided: F is not affine; a family of such games "
            "declares is_strongly_monotone"
        )
    known = game.jacobian(np.zeros((game.dimension, game.batch_size)))
    symmetric = np.moveaxis(known + known.transpose(1, 0, 2), 2, 0) / 2
    try:
        np.linalg.cholesky(symmetric)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(symmetric)[:, 0]
        raise ValueError(
            f"game {int(smallest.argmin())} of the batch is not strongly monotone: ε = {smallest.min():.3g}; a family "
            "of such games declares is_strongly_monotone = False"
        ) from None
