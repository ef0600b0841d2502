"""The draws that every policy meets: they depend on the scenario and the seed, and never on a policy."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256
from typing import Literal, TypeAlias, get_args

from ptne_env import dynamics
from ptne_env.arrays import require_count
from ptne_env.dynamics import State
from ptne_env.games import require_strong_monotonicity
from ptne_env.random_streams import RandomStreams
from ptne_env.world import World

Split: TypeAlias = Literal["train", "validation", "test"]

_WORD = 32
"""Bits of a seed, and of an episode's number, in the seed of an episode."""

_POOL = 4
"""Words to which numpy's ``SeedSequence`` pads its entropy when a spawn key follows."""


def episode_seed(seed: int, episode: int, split: Split = "test") -> int:
    """The seed of one episode; ``env.reset(seed=episode_seed(S, k))`` starts where episode k of an evaluation does.

    Splits share no seed, and the small seeds that people choose by hand belong to ``"train"``: what a policy was
    trained on is not what it is tested on.

    Raises:
        ValueError: when the split is unknown, or a number is negative or not below 2^32.
    """
    _require(split, seed, episode)
    return (get_args(Split).index(split) << 2 * _WORD) + (seed << _WORD) + episode


def track_seed(suite: str, track: str, split: Split, seed: int, episode: int) -> int:
    """The seed of one episode of a track of a suite; ``env.reset(seed=...)`` starts where the episode does.

    It is the number whose ``SeedSequence`` is ``SeedSequence([seed, episode], spawn_key=(a, b, c))``, where a, b and c
    are the first four bytes, the highest first, of the SHA-256 of the names of suite, track and split: numpy lays out
    entropy and spawn key as words of 32 bits, [seed, episode, 0, 0, a, b, c], and a number by its words, the lowest
    first. So whatever takes a seed can replay the episode.

    Raises:
        ValueError: as :func:`episode_seed`.
    """
    _require(split, seed, episode)
    key = (int.from_bytes(sha256(name.encode()).digest()[:4], "big") for name in (suite, track, split))
    return seed + (episode << _WORD) + sum(word << (_POOL + place) * _WORD for place, word in enumerate(key))


def _require(split: str, seed: int, episode: int) -> None:
    if split not in get_args(Split):
        raise ValueError(f"unknown split {split!r}; choose from {', '.join(get_args(Split))}")
    for name, value in (("seed", seed), ("episode", episode)):
        if require_count(name, value, 0) >= 1 << _WORD:
            raise ValueError(f"a {name} is below 2^{_WORD}, got {value}")


def draw_start(world: World, episodes: int, seed: int, split: Split = "test") -> State:
    """The initial state of all episodes, games and estimates drawn.

    Raises:
        ValueError: when a drawn game is not strongly monotone.
    """
    return start_from(world, (episode_seed(seed, episode, split) for episode in range(episodes)))


def start_from(world: World, seeds: Iterable[int]) -> State:
    """The initial state of one episode per seed.

    Raises:
        ValueError: when a drawn game is not strongly monotone.
    """
    sources = [RandomStreams.from_seed(seed) for seed in seeds]
    game = world.draw_game(sources)
    if world.has_random_game:
        require_strong_monotonicity(game)
    return dynamics.initial_state(world, world.draw_estimates(sources), game, world.draw_randomness(sources))
