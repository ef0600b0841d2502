"""The draws that every policy meets: they depend on the scenario and the seed, and never on a policy."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

from ptne_env import theory
from ptne_env.arrays import require_count
from ptne_env.dynamics import Dynamics, State
from ptne_env.sources import Sources

Split: TypeAlias = Literal["train", "validation", "test"]

_WORD = 32
"""Bits of a seed, and of an episode's number, in the seed of an episode."""


def episode_seed(seed: int, episode: int, split: Split = "test") -> int:
    """The seed of one episode; ``env.reset(seed=episode_seed(S, k))`` starts where episode k of an evaluation does.

    Splits share no seed, and the small seeds that people choose by hand belong to ``"train"``: what a policy was
    trained on is not what it is tested on.

    Raises:
        ValueError: when the split is unknown, or a number is negative or not below 2^32.
    """
    if split not in get_args(Split):
        raise ValueError(f"unknown split {split!r}; choose from {', '.join(get_args(Split))}")
    for name, value in (("seed", seed), ("episode", episode)):
        if require_count(name, value, 0) >= 1 << _WORD:
            raise ValueError(f"a {name} is below 2^{_WORD}, got {value}")
    return (get_args(Split).index(split) << 2 * _WORD) + (seed << _WORD) + episode


def draw_start(dynamics: Dynamics, episodes: int, seed: int, split: Split = "test") -> State:
    """The initial state of all episodes, games and estimates drawn.

    Raises:
        ValueError: when a drawn game is not strongly monotone.
    """
    sources = [Sources.from_seed(episode_seed(seed, episode, split)) for episode in range(episodes)]
    game = dynamics.draw_game(sources)
    if dynamics.scenario.has_random_game:
        theory.require_strong_monotonicity(game)
    return dynamics.start(dynamics.draw_estimates(sources), game, dynamics.draw_chance(sources))
