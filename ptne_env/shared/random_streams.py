"""Random generators of an environment, one per purpose, so that draws for one purpose do not affect the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptne_env.shared.arrays import require_count


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
        """Spawn the generators; ``None`` takes fresh entropy, and no whole number ≥ 0 is a ``ValueError``."""
        children = np.random.SeedSequence(None if seed is None else require_count("a seed", seed, 0)).spawn(4)
        return cls(*(np.random.default_rng(child) for child in children))
