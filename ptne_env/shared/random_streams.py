"""Random generators of an environment, one per purpose, so that draws for one purpose do not affect the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def require_seed(seed: int) -> int:
    """Return ``seed``, or raise ``ValueError`` when it is negative or not a whole number."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:  # type: ignore[redundant-expr]  # callers may pass any type
        raise ValueError(f"a seed is a whole number of at least 0 or None, got {seed!r}")
    return int(seed)


@dataclass(frozen=True)
class RandomStreams:
    """The generators of one environment, spawned from one seed.

    Attributes:
        game: draws the game of an episode.
        start: draws the initial estimates.
        graph: draws switching topologies.
        channel: draws the keys of channels and disturbances.
    """

    game: np.random.Generator
    start: np.random.Generator
    graph: np.random.Generator
    channel: np.random.Generator

    @classmethod
    def from_seed(cls, seed: int | None) -> RandomStreams:
        """Spawn the generators; ``None`` takes fresh entropy.

        Raises:
            ValueError: when the seed is negative or not a whole number.
        """
        children = np.random.SeedSequence(None if seed is None else require_seed(seed)).spawn(4)
        return cls(*(np.random.default_rng(child) for child in children))
