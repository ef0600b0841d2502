"""Tracks and suites: scenarios on which policies are compared, with the rules of their episodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.rollout import Member
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import PolicyError
from ptne_env.shared.arrays import require_count, require_flag, require_printable
from ptne_env.shared.names import require_name
from ptne_env.shared.parts import FactorySpec, foreign_targets, make, resolve, target_of
from ptne_env.world.catalogue import get_scenario, split_track
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

EPISODES = 100
"""Episodes of a scenario in a comparison, unless another number is asked for."""


@dataclass(frozen=True)
class Teammates:
    """The players of a track, by their indices, that follow a fixed policy, which is built for its own interface."""

    policy: FactorySpec
    players: tuple[int, ...]

    def join(self, world: World) -> Member:
        """Let the teammates act in a world.

        Raises:
            ValueError: when their policy cannot act there.
        """
        spec = PolicySpec("teammates", self.policy)
        encoder = Encoder(world, spec.interface)
        try:
            return Member(spec.build(encoder.layout), encoder, self.players)
        except (LayoutError, PolicyError) as error:
            raise ValueError(f"the teammates, {self.policy}, cannot play {world.scenario.name!r}: {error}") from error


@dataclass(frozen=True)
class Track:
    """A scenario with the rules of its episodes.

    Attributes:
        name: the name, unique in a comparison or suite. In a suite, the seeds of the episodes depend on it.
        scenario: the physics, or its name in the catalogue.
        change: a sentence that says how it differs from the base of the suite.
        teammates: players that follow a fixed policy; ``None`` where every player follows the policy that is run.
        episodes: the number of episodes; ``None`` for that of the comparison or suite.
        scored: whether it counts for the score of a suite.
    """

    name: str
    scenario: Scenario
    change: str
    teammates: Teammates | None = None
    episodes: int | None = None
    scored: bool = True

    def __post_init__(self) -> None:
        require_printable("the name of a track", self.name)
        object.__setattr__(self, "scenario", get_scenario(self.scenario))
        require_flag(f"scored of track {self.name!r}", self.scored)
        if self.episodes is not None:
            require_count(f"episodes of track {self.name!r}", self.episodes, 1)
        if self.teammates is not None:
            team, players = set(self.teammates.players), set(range(self.world.game.num_players))
            if not (team < players and 0 < len(team) == len(self.teammates.players)):
                raise ValueError(
                    f"track {self.name!r}: teammates are some, not all, of the players {sorted(players)}, none "
                    f"twice; got {list(self.teammates.players)}"
                )

    @property
    def world(self) -> World:
        """The scenario's world, built once per process; again where a notebook defined a part of it again."""
        return _world(self.scenario, tuple(map(resolve, foreign_targets(self.scenario.to_dict()))))

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object."""
        team = self.teammates
        members = team and {"policy": team.policy.to_dict(), "players": list(team.players)}
        return {**vars(self), "scenario": self.scenario.to_dict(), "teammates": members}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Track:
        """Read what :meth:`to_dict` returns."""
        team = data["teammates"]
        members = team and Teammates(FactorySpec.from_dict(team["policy"]), tuple(team["players"]))
        return cls(**{**data, "scenario": Scenario.from_dict(data["scenario"]), "teammates": members})


@lru_cache(maxsize=100)
def _world(scenario: Scenario, definitions: tuple[Any, ...]) -> World:  # noqa: ARG001 - part of the key
    return World(scenario)


@dataclass(frozen=True)
class Suite:
    """Tracks, and the rules by which they are run.

    Attributes:
        name: the name, such as ``"ptne-v1"``, which is part of the seeds of all episodes.
        tracks: the tracks in the order of tables.
        episodes: the number of episodes of every track without a number of its own.

    Raises:
        ValueError: when names of tracks repeat, when there is no track, or when the number of episodes is below 1.
    """

    name: str
    tracks: tuple[Track, ...]
    episodes: int = 200

    def __post_init__(self) -> None:
        require_count("a suite's number of episodes", self.episodes, 1)
        require_printable("the name of a suite", self.name)
        given: tuple[Any, ...] = self.tracks
        if kinds := [type(each).__name__ for each in given if not isinstance(each, Track)]:
            raise ValueError(f"a suite consists of tracks, Track(name, scenario, change), got a {kinds[0]}")
        names = [track.name for track in self.tracks]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"a suite needs tracks with different names, got {names}")

    def track(self, name: str) -> Track:
        """Return a track by name; ``ValueError`` for an unknown one."""
        tracks = {track.name: track for track in self.tracks}
        return tracks[require_name(f"track of suite {self.name}", name, tracks)]

    def scenario(self, track: str) -> Scenario:
        """Return the scenario of a track by name; ``ValueError`` for an unknown one, and for one with teammates."""
        if (found := self.track(track)).teammates is not None:
            plays = "some of its players follow a fixed policy; only ptne_env.evaluate and 'ptne compare' play it"
            raise ValueError(f"track {track!r} is more than its scenario: {plays}")
        return found.scenario

    def episode_set(
        self, track: str, episodes: int | None = None, *, seed: int = 0, split: Split = "test"
    ) -> EpisodeSet:
        """Return the episodes of a track, whose own number stands before ``episodes``, and that before the suite's.

        Raises:
            ValueError: for an unknown track or split, or a number out of range.
        """
        count = self.track(track).episodes or (self.episodes if episodes is None else episodes)
        return EpisodeSet(count, seed, split, (self.name, track))


def get_suite(suite: str | Suite) -> Suite:
    """Return a suite by name or ``"module:object"``, also of a function that makes one; else ``ValueError``."""
    made = make(target_of("suite", suite)) if isinstance(suite, str) else suite
    if not isinstance(made, Suite):
        raise ValueError(f"{suite!r} is a {type(made).__name__}, not a Suite")
    return made


def find_track(scenario: str | Scenario | Track) -> Track:
    """Return the track of a suite by both names, such as ``"ptne-v1/liar"``, or that of a scenario.

    The first names no number of episodes; that of a scenario in which nothing is random is 1. Errors are those of
    :func:`ptne_env.get_scenario`.
    """
    if isinstance(scenario, Track):
        return scenario
    if isinstance(scenario, str) and "/" in scenario:
        suite, name = split_track(scenario)
        return replace(get_suite(suite).track(name), name=scenario, episodes=None)
    scenario = get_scenario(scenario)
    track = Track(scenario.name, scenario, "Random episodes.")
    if track.world.is_random:
        return track
    return replace(track, change="One episode, because nothing is random.", episodes=1)


def compared_tracks(
    scenarios: Iterable[str | Scenario | Track], episodes: int | None = None, seed: int = 0, split: Split = "test"
) -> dict[Track, EpisodeSet]:
    """Return the tracks of what :func:`ptne_env.evaluate` takes, and their episodes: a suite's where it names a track.

    Errors are those of :func:`find_track`, and ``ValueError`` for repeated names or none.
    """
    tracks: dict[Track, EpisodeSet] = {}
    for scenario in scenarios:
        track = find_track(scenario)
        drawn = EpisodeSet(track.episodes or (EPISODES if episodes is None else episodes), seed, split)
        if isinstance(scenario, str) and "/" in scenario:
            suite, name = split_track(scenario)
            drawn = get_suite(suite).episode_set(name, episodes, seed=seed, split=split)
            track = replace(track, episodes=drawn.count)
        if track.name in {other.name for other in tracks}:
            raise ValueError(
                f"a comparison needs scenarios with different names, and {track.name!r} is there twice: give one "
                "another name=, or leave it out"
            )
        tracks[track] = drawn
    if not tracks:
        raise ValueError("a comparison needs at least one scenario")
    return tracks
