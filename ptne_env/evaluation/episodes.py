"""Episode sets: seeded initial states, which never depend on the policy that is run from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from typing import Literal, TypeAlias, get_args

from ptne_env.shared.arrays import require_count
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world.dynamics import State, draw_initial_state
from ptne_env.world.world import World

Split: TypeAlias = Literal["train", "validation", "test"]

_WORD = 32
"""Number of bits that a seed, and the number of an episode, take in the seed of an episode."""


def episode_seed(seed: int, episode: int, split: Split = "test") -> int:
    """Return the seed of an episode; ``env.reset(seed=episode_seed(S, k))`` starts episode k of a comparison.

    Splits share no seed, and the small seeds that people choose by hand belong to ``"train"``. So policies are tested
    on other episodes than those they were trained on.

    Raises:
        ValueError: when the split is unknown, or a number is negative or not below 2^32.
    """
    _require(split, seed, episode)
    return (get_args(Split).index(split) << 2 * _WORD) + (seed << _WORD) + episode


def track_seed(suite: str, track: str, split: Split, seed: int, episode: int) -> int:
    """Return the seed of one episode of a suite's track; ``env.reset(seed=...)`` starts where the episode does.

    It is the number whose ``SeedSequence`` is ``SeedSequence([seed, episode], spawn_key=(a, b, c))``, where a, b and c
    are the first four bytes, the highest first, of the SHA-256 of the names of suite, track and split: numpy lays out
    entropy and spawn key as words of 32 bits, [seed, episode, 0, 0, a, b, c], and a number by its words, the lowest
    first. So anything that takes a seed can replay the episode. Errors are those of :func:`episode_seed`.
    """
    _require(split, seed, episode)
    key = (int.from_bytes(sha256(name.encode()).digest()[:4], "big") for name in (suite, track, split))
    return seed + (episode << _WORD) + sum(word << place * _WORD for place, word in enumerate(key, 4))


def _require(split: str, seed: int, episode: int) -> None:
    if split not in get_args(Split):
        raise ValueError(f"unknown split {split!r}; choose from {', '.join(get_args(Split))}")
    for name, value in (("seed", seed), ("episode", episode)):
        if require_count(name, value, 0) >= 1 << _WORD:
            raise ValueError(f"a {name} is below 2^{_WORD}, got {value}")


@dataclass(frozen=True)
class EpisodeSet:
    """A number of seeded episodes.

    Attributes:
        count: the number of episodes.
        seed: the seed of the set.
        split: ``"test"``, ``"validation"`` or ``"train"``, which share no episode.
        track: the names of the suite and the track on which the seeds depend (:func:`track_seed`); ``None`` where the
            seeds are the same in every scenario (:func:`episode_seed`), which have the same limits.
    """

    count: int
    seed: int = 0
    split: Split = "test"
    track: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        require_count("episodes", self.count, 1)
        _require(self.split, self.seed, self.count - 1)

    def episode_seed(self, episode: int) -> int:
        """Return the seed with which an environment of the scenario replays an episode: ``env.reset(seed=...)``."""
        if self.track is None:
            return episode_seed(self.seed, episode, self.split)
        return track_seed(*self.track, self.split, self.seed, episode)

    @lru_cache(maxsize=2)  # noqa: B019 - jobs with the same episodes follow each other, and two states are little
    def initial_state(self, world: World) -> State:
        """Draw the initial state of all episodes, as :func:`~ptne_env.world.dynamics.draw_initial_state` does."""
        streams = [RandomStreams.from_seed(self.episode_seed(episode)) for episode in range(self.count)]
        return draw_initial_state(world, streams)
