"""Suites: tracks that policies are run on. A comparison is a suite whose tracks are scenarios."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache, cached_property, lru_cache
from typing import Any

from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.metrics import FINE_DISTANCE
from ptne_env.evaluation.policy_specs import POLICIES, PolicySpec
from ptne_env.evaluation.provenance import content_hash, file_hashes
from ptne_env.evaluation.rollout import Member
from ptne_env.perception.encoder import make_encoder
from ptne_env.shared.arrays import require_count, require_printable
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import FactorySpec, resolve
from ptne_env.world import distances
from ptne_env.world.catalogue import CATALOGUE, get_scenario
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

ZERO, LAW, ORACLE = "zero-input", "static", "oracle"
"""The reference policies of published suites: score 0, the paper's law, and an oracle."""

REFERENCES = tuple(POLICIES[name] for name in (ZERO, LAW, ORACLE))
"""These policies."""

MOST_DIGITS = 12.0
"""The digits of a distance at the floor: no more are counted."""

EPISODES = 200
"""Episodes of a track of a suite, unless the suite has another number."""

COMPARED_EPISODES = 100
"""Episodes of a scenario in a comparison, unless another number is asked for."""

LEADERBOARD_SEED = 0
"""Seed of the episode sets of published results."""


@dataclass(frozen=True)
class Teammates:
    """The team rule of a track: these players follow a fixed policy.

    Attributes:
        policy: that they follow, built for its own interface.
        players: their indices.
    """

    policy: FactorySpec
    players: tuple[int, ...]

    def join(self, world: World) -> Member:
        """The teammates as they act in a world.

        Raises:
            ValueError: when their policy cannot act there.
        """
        spec = PolicySpec("teammates", self.policy)
        encoder = make_encoder(world, spec.interface)
        return Member(spec.build(encoder.layout), encoder, self.players)

    def to_dict(self) -> dict[str, Any]:
        """A JSON object."""
        return {"policy": self.policy.to_dict(), "players": list(self.players)}


@dataclass(frozen=True)
class Track:
    """One scenario of a suite, with the rules of its episodes.

    Attributes:
        name: unique in the suite; part of the seeds of its episodes in a published suite.
        scenario: the physics.
        change: its difference from the base, in one sentence.
        metric: by which policies are scored, higher being better: ``"digits"`` or ``"digits_after_hold"``.
        teammates: players that follow a fixed policy; ``None`` where every player follows the policy that is run.
        episodes: its own number of episodes; the suite's if ``None``.

    Raises:
        ValueError: for another metric, a metric that the scenario does not have, or teammates that are not some of the
            players.
    """

    name: str
    scenario: Scenario
    change: str
    metric: str = "digits"
    teammates: Teammates | None = None
    episodes: int | None = None

    def __post_init__(self) -> None:
        require_printable("the name of a track", self.name)
        choices = ("digits", "digits_after_hold") if self.scenario.hold_steps else ("digits",)
        if self.metric not in choices:
            raise ValueError(f"track {self.name!r} is scored by {' or '.join(choices)}, got {self.metric!r}")
        if self.episodes is not None:
            require_count(f"episodes of track {self.name!r}", self.episodes, 1)
        if self.teammates is not None:
            chosen, players = set(self.teammates.players), set(range(self.world.game.num_players))
            if not (chosen < players and 0 < len(chosen) == len(self.teammates.players)):
                raise ValueError(
                    f"track {self.name!r}: teammates are some, not all, of the players {sorted(players)}, each once; "
                    f"got {list(self.teammates.players)}"
                )

    @property
    def world(self) -> World:
        """The scenario's world, built once per process."""
        return _world(self.scenario)

    def to_dict(self) -> dict[str, Any]:
        """A JSON object."""
        return {
            "name": self.name,
            "scenario": self.scenario.to_dict(),
            "change": self.change,
            "metric": self.metric,
            "teammates": None if self.teammates is None else self.teammates.to_dict(),
            "episodes": self.episodes,
        }

    def files(self) -> dict[str, str]:
        """The hashes of what its parts need, as :func:`~ptne_env.evaluation.provenance.file_hashes`."""
        parts = _parts(self.scenario)
        return file_hashes(parts if self.teammates is None else (*parts, self.teammates.policy))


def _parts(scenario: Scenario) -> tuple[FactorySpec, ...]:
    values = (getattr(scenario, field.name) for field in fields(scenario))
    return tuple(value for value in values if isinstance(value, FactorySpec))


def _world(scenario: Scenario) -> World:
    return _built(scenario, tuple(map(id, _definitions(scenario))))[0]


@lru_cache(maxsize=100)
def _built(scenario: Scenario, identities: tuple[int, ...]) -> tuple[World, list[Any]]:  # noqa: ARG001 - a key
    """The world, and the objects that it is made of, so that no other object gets one of these identities."""
    return World(scenario), _definitions(scenario)


def _definitions(scenario: Scenario) -> list[Any]:
    """What the targets of a scenario name at present: a notebook may define a class again."""
    return [nested.resolve() for part in _parts(scenario) for nested in part.nested()]


@dataclass(frozen=True)
class Suite:
    """Tracks and the rules by which they are run.

    Attributes:
        name: such as ``"ptne-v1"``; part of the seeds of all episodes in a published suite.
        tracks: in the order of tables.
        episodes: of every track without a number of its own.
        is_comparison: whether it is a comparison: all tracks have the same seeds, no reference policies are added, and
            there are no scores.

    Raises:
        ValueError: when names repeat, there is no track, or a count is below 1.
    """

    name: str
    tracks: tuple[Track, ...]
    episodes: int = EPISODES
    is_comparison: bool = False

    def __post_init__(self) -> None:
        require_count("a suite's number of episodes", self.episodes, 1)
        require_printable("the name of a suite", self.name)
        names = [track.name for track in self.tracks]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"a suite needs tracks with different names, got {names}")

    @property
    def references(self) -> tuple[PolicySpec, ...]:
        """The reference policies that every run of the suite includes."""
        return () if self.is_comparison else REFERENCES

    def track(self, name: str) -> Track:
        """A track by name.

        Raises:
            ValueError: for an unknown name.
        """
        for track in self.tracks:
            if track.name == name:
                return track
        raise ValueError(unknown_name(f"track of suite {self.name}", name, [track.name for track in self.tracks]))

    def episode_set(
        self, track: str, episodes: int | None = None, *, seed: int = LEADERBOARD_SEED, split: Split = "test"
    ) -> EpisodeSet:
        """The episodes of a track.

        Args:
            track: its name.
            episodes: in place of the suite's number; a track with a number of its own keeps it.
            seed: of the set.
            split: ``"test"``, ``"validation"`` or ``"train"``.

        Raises:
            ValueError: for an unknown track or split, or a number out of range.
        """
        found = self.track(track)
        count = found.episodes or (self.episodes if episodes is None else episodes)
        return EpisodeSet(count, seed, split, None if self.is_comparison else (self.name, track))

    def content(self) -> dict[str, Any]:
        """Name, tracks and rules as a JSON object, which is frozen by its hash."""
        return {
            "suite": self.name,
            "tracks": [track.to_dict() for track in self.tracks],
            "rules": {
                "episodes": self.episodes,
                "is_comparison": self.is_comparison,
                "leaderboard_seed": LEADERBOARD_SEED,
                "reference_policies": {spec.name: spec.to_dict()["training_seeds"] for spec in self.references},
                "distance_floor": distances.FLOOR,
                "fine_distance": FINE_DISTANCE,
            },
        }

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the canonical JSON of :meth:`content`, in which fields that are ``None`` are left out.

        So a new field of a scenario that is ``None`` in existing ones leaves published suites as they are.
        """
        return content_hash(self.content())


def comparison(scenarios: Iterable[str | Scenario], *, episodes: int = COMPARED_EPISODES, hold_steps: int = 0) -> Suite:
    """The suite of a comparison.

    A scenario of the catalogue is run from random starts. Any other, also a :class:`~ptne_env.world.scenario.Scenario`, is
    run as it is. A track in which nothing is random has one episode.

    Args:
        scenarios: names as :func:`find_scenario` takes them, or scenarios.
        episodes: of every track in which something is random.
        hold_steps: steps after the deadline for the scenarios of the catalogue.

    Raises:
        ValueError: for unknown or repeated names, or none.
    """
    require_count("episodes", episodes, 1)
    tracks = tuple(_comparison_track(scenario, hold_steps) for scenario in scenarios)
    names = [track.name for track in tracks]
    if not names:
        raise ValueError("a comparison needs at least one scenario")
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"a comparison needs different scenarios; {', '.join(repeated)} would be run more than once")
    return Suite("comparison", tracks, episodes, is_comparison=True)


def _comparison_track(scenario: str | Scenario, hold_steps: int) -> Track:
    if isinstance(scenario, str) and (":" in scenario or "/" in scenario):
        scenario = find_scenario(scenario)
    if isinstance(scenario, str):
        scenario = get_scenario(scenario, hold_steps=hold_steps)
        scenario = scenario if _world(scenario).is_random else scenario.replace(start="random")
    if _world(scenario).is_random:
        return Track(scenario.name, scenario, "Random episodes.")
    return Track(scenario.name, scenario, "One episode, because nothing is random.", episodes=1)


SUITES: Mapping[str, str] = {
    "ptne-v1": "ptne_env.evaluation.ptne_v1:ptne_v1",
}
"""The published suites: name, and the ``"module:object"`` that makes each."""


def get_suite(suite: str | Suite) -> Suite:
    """A suite by name, by ``"module:object"`` (a suite, or a function without arguments that makes one), or as it is.

    Raises:
        ValueError: for an unknown name, or an object that is no suite.
    """
    if isinstance(suite, Suite):
        return suite
    if suite not in SUITES and ":" not in suite:
        raise ValueError(unknown_name("suite", suite, SUITES, "a 'module:object'"))
    target = SUITES.get(suite, suite)
    made = _named(target)
    if isinstance(made, Scenario):
        raise ValueError(f"{target!r} is a Scenario, not a Suite: name it in the place of a scenario, without --suite")
    if not isinstance(made, Suite):
        raise ValueError(f"{target!r} is a {type(made).__name__}, not a Suite")
    return made


def _named(target: str) -> Any:
    """The object of a ``"module:object"``, or the result of a function without arguments."""
    found = resolve(target)
    return _made(found) if callable(found) else found


@cache
def _made(make: Callable[[], Any]) -> Any:
    return make()


def foreign_suites(*names: str | None) -> list[str]:
    """The ``"module:object"`` of scenarios, and of suites that are not published; nothing is imported.

    Args:
        names: of suites, scenarios or tracks, as :func:`get_suite` and :func:`find_scenario` take them.
    """
    suites = [name.partition("/")[0] for name in names if name is not None]
    return [suite for suite in suites if ":" in suite and suite not in SUITES.values()]


def world_names() -> list[str]:
    """The names of all scenarios, and of the tracks of published suites, that :func:`find_scenario` knows."""
    return [*CATALOGUE, *(f"{suite}/{track.name}" for suite in SUITES for track in get_suite(suite).tracks)]


def find_scenario(name: str) -> Scenario:
    """A scenario of the catalogue by name, of a track, such as ``"ptne-v1/delay"``, or by ``"module:object"``.

    The object is a scenario, or a function without arguments that makes one.

    Raises:
        ValueError: for an unknown name, an object that is no scenario, or a track with teammates.
    """
    suite, separator, track = name.partition("/")
    if not separator and ":" in name:
        made = _named(name)
        if isinstance(made, Suite):
            raise ValueError(f"{name!r} is a Suite: name one of its tracks, such as '{name}/{made.tracks[0].name}'")
        if not isinstance(made, Scenario):
            raise ValueError(f"{name!r} is a {type(made).__name__}, not a Scenario")
        return made
    if not separator:
        if name not in CATALOGUE:
            raise ValueError(unknown_name("scenario", name, world_names()))
        return get_scenario(name)
    found = get_suite(suite).track(track)
    if found.teammates is not None:
        raise ValueError(
            f"track {name!r} is more than its scenario: some of its players follow a fixed policy; only ptne compare "
            f"{name} and run_suite play it"
        )
    return found.scenario
