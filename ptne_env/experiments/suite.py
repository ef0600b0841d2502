"""Which benchmark is this? Tracks that change one thing each, and suites of them that are frozen by their content."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from typing import Any

from ptne_env.arrays import require_count
from ptne_env.catalogue import get_scenario
from ptne_env.distances import FLOOR
from ptne_env.dynamics import State
from ptne_env.encoder import make_encoder
from ptne_env.experiments.episodes import Split, start_from, track_seed
from ptne_env.experiments.metrics import FINE_DISTANCE, SUITE_METRICS
from ptne_env.experiments.policy_specs import ENTRIES, PolicySpec
from ptne_env.experiments.rollout import Member
from ptne_env.factory import FactorySpec, resolve
from ptne_env.scenario import Scenario
from ptne_env.world import World

NULL, LAW, ORACLE = "null", "static", "oracle"
"""The entries that every suite runs: score 0, score 1 (the paper's law), and the mark beside them."""

ANCHORS: Mapping[str, PolicySpec] = {name: ENTRIES[name] for name in (NULL, LAW, ORACLE)}
"""These entries by name."""

SATURATION_MARGIN = 0.1
"""A policy has saturated a track when its interquartile mean is within this many digits of the floor."""

LEADERBOARD_SEED = 0
"""Seed of the banks that published results are of."""


@dataclass(frozen=True)
class Teammates:
    """The team rule of a track: these players follow another policy, whoever enters.

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
        entry = PolicySpec("teammates", self.policy)
        encoder = make_encoder(world, entry.interface)
        return Member(entry.build(encoder.layout), encoder, self.players)

    def to_dict(self) -> dict[str, Any]:
        """A JSON object."""
        return {"policy": self.policy.to_dict(), "players": list(self.players)}


@dataclass(frozen=True)
class Track:
    """One world of a suite.

    Attributes:
        name: unique in the suite; part of the seeds of its episodes.
        scenario: the physics.
        change: what is different from the base, in one sentence.
        metric: of which more is better, by which policies are scored: ``"digits"`` or ``"digits_after_hold"``.
        teammates: who plays beside the entry; nobody if ``None``.

    Raises:
        ValueError: for another metric, one that the scenario does not have, or teammates who are not some of the
            players.
    """

    name: str
    scenario: Scenario
    change: str
    metric: str = "digits"
    teammates: Teammates | None = None

    def __post_init__(self) -> None:
        choices = ("digits", "digits_after_hold") if self.scenario.hold_steps else ("digits",)
        if self.metric not in choices:
            raise ValueError(f"track {self.name!r} is scored by {' or '.join(choices)}, got {self.metric!r}")
        if self.teammates is not None:
            players, everybody = set(self.teammates.players), set(range(World(self.scenario).game.num_players))
            if not (players < everybody and 0 < len(players) == len(self.teammates.players)):
                raise ValueError(
                    f"track {self.name!r}: teammates are some, not all, of the players {sorted(everybody)}, each once; "
                    f"got {list(self.teammates.players)}"
                )

    def to_dict(self) -> dict[str, Any]:
        """A JSON object."""
        return {
            "name": self.name,
            "scenario": self.scenario.to_dict(),
            "change": self.change,
            "metric": self.metric,
            "teammates": None if self.teammates is None else self.teammates.to_dict(),
        }


@dataclass(frozen=True)
class Suite:
    """A benchmark: tracks and the rules by which they are run. Its content is frozen; a change is a new version.

    Attributes:
        title: without the version.
        version: counted from 1.
        tracks: in the order of tables.
        episodes: of every track.
        frozen: the content hash that it was published with; ``None`` while it is being made.

    Raises:
        ValueError: when names repeat, there is no track, a count is below 1, or the content is not the frozen one.
    """

    title: str
    version: int
    tracks: tuple[Track, ...]
    episodes: int = 200
    frozen: str | None = None

    def __post_init__(self) -> None:
        require_count("a suite's version", self.version, 1)
        require_count("a suite's number of episodes", self.episodes, 1)
        names = [track.name for track in self.tracks]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"a suite needs tracks with different names, got {names}")
        if self.frozen not in (None, self.content_hash):
            raise ValueError(
                f"the content of suite {self.name} has the hash {self.content_hash}, but it was frozen as "
                f"{self.frozen}: a change of content is a new version"
            )

    @property
    def name(self) -> str:
        """Title and version, such as ``"ptne-v1"``; part of the seeds of all episodes."""
        return f"{self.title}-v{self.version}"

    def track(self, name: str) -> Track:
        """A track by name.

        Raises:
            ValueError: for an unknown name.
        """
        for track in self.tracks:
            if track.name == name:
                return track
        raise ValueError(
            f"suite {self.name} has no track {name!r}; choose from {', '.join(t.name for t in self.tracks)}"
        )

    def content(self) -> dict[str, Any]:
        """What is frozen: name, tracks and rules, as a JSON object."""
        return {
            "suite": self.name,
            "tracks": [track.to_dict() for track in self.tracks],
            "rules": {
                "episodes": self.episodes,
                "leaderboard_seed": LEADERBOARD_SEED,
                "anchors": {name: entry.to_dict()["policy"] for name, entry in ANCHORS.items()},
                "distance_floor": FLOOR,
                "fine_distance": FINE_DISTANCE,
                "saturation_margin": SATURATION_MARGIN,
                "metrics": list(SUITE_METRICS),
            },
        }

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the canonical JSON of :meth:`content`, in which fields that are ``None`` are left out.

        So a scenario that learns a new field, ``None`` for what exists already, leaves published suites as they are.
        """
        return content_hash(self.content())

    def episode_seed(self, track: str, episode: int, *, seed: int = LEADERBOARD_SEED, split: Split = "test") -> int:
        """The seed with which an environment of the track's scenario replays an episode: ``env.reset(seed=...)``.

        Raises:
            ValueError: for an unknown track or split, or a number that is negative or not below 2^32.
        """
        return track_seed(self.name, self.track(track).name, split, seed, episode)

    def draw_start(
        self, world: World, track: str, episodes: int, *, seed: int = LEADERBOARD_SEED, split: Split = "test"
    ) -> State:
        """The initial state of the first ``episodes`` episodes of a track.

        Raises:
            ValueError: as :meth:`episode_seed`, or when a drawn game is refused.
        """
        seeds = (self.episode_seed(track, index, seed=seed, split=split) for index in range(episodes))
        return start_from(world, seeds)


def find_scenario(name: str) -> Scenario:
    """A scenario of the catalogue by name, or a track's, such as ``"ptne-v1/delay"``.

    Raises:
        ValueError: for an unknown name, or a track in which others act too.
    """
    suite, separator, track = name.partition("/")
    if not separator:
        return get_scenario(name)
    found = get_suite(suite).track(track)
    if found.teammates is not None:
        raise ValueError(f"track {name!r} is more than its scenario: others act in it too")
    return found.scenario


def canonical_json(value: Any) -> str:
    """JSON with sorted keys, without spaces, and without the keys whose value is ``None``."""

    def without_none(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {key: without_none(child) for key, child in item.items() if child is not None}
        return [without_none(child) for child in item] if isinstance(item, list | tuple) else item

    return json.dumps(without_none(value), sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def content_hash(value: Any) -> str:
    """SHA-256 of :func:`canonical_json`, in hexadecimal."""
    return sha256(canonical_json(value).encode()).hexdigest()


def _ptne_v1() -> Suite:
    base = get_scenario("random-energy")

    def track(name: str, change: str, *, metric: str = "digits", **changes: Any) -> Track:
        return Track(name, base.replace(name=name, **changes), change, metric)

    def many(players: int, stride: int) -> dict[str, Any]:
        """Players on a circulant graph of degree 4, their total coupling that of five."""
        graph = FactorySpec.of("networkx:circulant_graph", n=players, offsets=(1, stride))
        graph = FactorySpec.of("ptne_env.graphs:from_networkx", graph=graph)
        coupling = (0.25 / players, 1.5 / players)
        return {
            "game": FactorySpec.of("ptne_env.games:RandomEnergy", players=players, coupling=coupling),
            "topology": FactorySpec.of("ptne_env.switching:fixed", graph=graph),
        }

    nominal = track("nominal", "The base: random energy games of five players on the 5-cycle, T = 1.2, c = 20.")
    law = FactorySpec.of("ptne_env.laws:Static", kappa=2.0)
    non_quadratic = FactorySpec.of("ptne_env.games:NonQuadraticGame", variant="corrected")
    pairs = ([(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)])
    modes = [FactorySpec.of("ptne_env.graphs:from_edges", players=5, edges=pair) for pair in pairs]
    uniformly = [[0.25] * 4] * 4
    pushes = FactorySpec.of("ptne_env.disturbances:UniformDisturbance", bound=1.0, dwell=25, after_deadline_only=True)

    def channel(name: str, **arguments: Any) -> FactorySpec:
        return FactorySpec.of(f"ptne_env.channel:{name}", **arguments)

    tracks = (
        nominal,
        track(
            "switching-physical",
            "The graph switches between four disconnected ones, every 0.1 s of physical time.",
            topology=get_scenario("random-energy-switching").topology,
        ),
        track(
            "switching-transformed",
            "The graph switches between four disconnected ones, every 0.25 of transformed time.",
            topology=get_scenario("random-energy-switching-transformed").topology,
        ),
        track(
            "markov",
            "Every 0.1 of transformed time one of the same four graphs is drawn, whichever acted before.",
            topology=FactorySpec.of(
                "ptne_env.switching:markov", graphs=modes, transition=uniformly, dwells=0.1, clock="transformed"
            ),
        ),
        track(
            "noise",
            "Messages carry Gaussian noise of standard deviation 0.05.",
            channel=channel("AdditiveNoise", std=0.05),
        ),
        track(
            "delay",
            "Messages travel for 1 to 7 steps, drawn each, and may overtake each other.",
            channel=channel("Delay", steps=1, longest=7),
        ),
        track(
            "burst-loss",
            "A third of the messages is lost, in bursts of 10 steps on average; receivers hold the last one.",
            channel=channel("BurstLoss", to_bad=0.05, to_good=0.1),
        ),
        track("quantised", "Messages are rounded to multiples of 0.1.", channel=channel("UniformQuantiser", width=0.1)),
        track("saturated", "Inputs are limited to 2, which binds in the first half of an episode.", input_limit=2.0),
        track("coarse-step", "150 steps to the deadline instead of 400.", steps=150),
        track(
            "large-20", "20 players, on a circulant graph of degree 4; total coupling as in the base.", **many(20, 4)
        ),
        track(
            "large-50", "50 players, on a circulant graph of degree 4; total coupling as in the base.", **many(50, 7)
        ),
        track(
            "unseen-graphs",
            "Every episode draws one of 100 connected random graphs, in which half of all pairs are linked; 4 slots.",
            topology=FactorySpec.of("ptne_env.switching:random_graphs", players=5, probability=0.5, modes=100, seed=0),
            slots=4,
        ),
        track("non-quadratic", "The paper's Example 2, whose pseudo-gradient is not Lipschitz.", game=non_quadratic),
        track(
            "weakly-monotone",
            "A game whose pseudo-gradient is monotone but not strongly monotone.",
            game=FactorySpec.of("ptne_env.games:WeaklyMonotoneGame"),
        ),
        track(
            "wrong-clock",
            "The players' clocks are up to 0.2 s fast or slow.",
            clock_shifts=(-0.2, 0.1, 0.0, 0.2, -0.1),
        ),
        track("short-deadline", "A quarter of the time: T = 0.3 at the same c.", deadline=0.3),
        track(
            "hold",
            "100 steps follow the deadline, in which the strategies are pushed by U(−1, 1) per second.",
            metric="digits_after_hold",
            hold_steps=100,
            disturbance=pushes,
        ),
        Track(
            "mixed-team",
            nominal.scenario.replace(name="mixed-team"),
            "Players 2 and 4 of 5 follow the paper's static law, whoever enters.",
            teammates=Teammates(law, (1, 3)),
        ),
        track(
            "robots",
            "Five robots in the plane keep posts and connectivity: two components per player.",
            game=FactorySpec.of("ptne_env.games:ConnectivityControl"),
        ),
    )
    return Suite("ptne", 1, tracks, frozen="e597723fc876dfc3b695d9164f74222279bbf4bdf97d17b8c3e980adeffafda5")


SUITES: Mapping[str, Callable[[], Suite]] = {"ptne-v1": cache(_ptne_v1)}
"""The published suites by name, each built when it is asked for."""


def get_suite(suite: str | Suite) -> Suite:
    """A suite by name, by ``"module:object"`` (a suite, or a function without arguments that makes one), or as it is.

    Raises:
        ValueError: for an unknown name, an object that is no suite, or content that is not the frozen one.
    """
    if isinstance(suite, Suite):
        return suite
    if suite in SUITES:
        return SUITES[suite]()
    if ":" not in suite:
        raise ValueError(f"unknown suite {suite!r}; choose from {', '.join(SUITES)}, or name a 'module:object'")
    found = resolve(suite)
    found = found if isinstance(found, Suite) else found()
    if not isinstance(found, Suite):
        raise ValueError(f"{suite!r} is a {type(found).__name__}, not a Suite")
    return found
