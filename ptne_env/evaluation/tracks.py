"""Tracks: scenarios on which policies are compared, with the rules of their episodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.rollout import Member
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.arrays import require_count, require_flag, require_printable
from ptne_env.shared.parts import FactorySpec, foreign_targets, resolve
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World


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
        return Member(spec.build(encoder.layout), encoder, self.players)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object."""
        return {"policy": self.policy.to_dict(), "players": list(self.players)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Teammates:
        """Read what :meth:`to_dict` returns."""
        return cls(FactorySpec.from_dict(data["policy"]), tuple(data["players"]))


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

    Raises:
        ValueError: when teammates are not some of the players.
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
        return {**vars(self), "scenario": self.scenario.to_dict(), "teammates": team and team.to_dict()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Track:
        """Read what :meth:`to_dict` returns."""
        team = data["teammates"]
        changes = {"scenario": Scenario.from_dict(data["scenario"]), "teammates": team and Teammates.from_dict(team)}
        return cls(**{**data, **changes})


@lru_cache(maxsize=100)
def _world(scenario: Scenario, definitions: tuple[Any, ...]) -> World:  # noqa: ARG001 - part of the key
    return World(scenario)


def compared_tracks(scenarios: Iterable[str | Scenario | Track]) -> tuple[Track, ...]:
    """Return the tracks of what :func:`ptne_env.evaluate` takes. One in which nothing is random has one episode.

    Raises:
        ValueError: for an unknown name, a ``"module:object"`` that is no scenario, repeated names, or none.
        TypeError: for another object, such as an environment.
    """
    tracks = tuple(item if isinstance(item, Track) else _as_track(get_scenario(item)) for item in scenarios)
    names = [track.name for track in tracks]
    if not names:
        raise ValueError("a comparison needs at least one scenario")
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"a comparison needs different scenarios; {', '.join(repeated)} would be run more than once")
    return tracks


def _as_track(scenario: Scenario) -> Track:
    track = Track(scenario.name, scenario, "Random episodes.")
    if track.world.is_random:
        return track
    return replace(track, change="One episode, because nothing is random.", episodes=1)
