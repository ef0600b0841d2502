"""Which experiment is this? A frozen, serialisable composition of parts, and the catalogue of named ones."""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ptne_env.arrays import require_count, require_finite, require_positive
from ptne_env.channel import Channel
from ptne_env.clock import Spacing, StepClock, TimeTransformation
from ptne_env.disturbances import Disturbance
from ptne_env.factory import FactorySpec
from ptne_env.games import Game, GameFamily, SingleGame
from ptne_env.starts import Start
from ptne_env.switching import SwitchingTopology

SHORTFALL_WARNING = 0.01
"""A scenario whose last step ends more than this fraction of T short of the deadline says so."""

_SHORTHANDS: dict[str, dict[str, FactorySpec]] = {
    "start": {
        "paper": FactorySpec.of("ptne_env.starts:paper_start"),
        "random": FactorySpec.of("ptne_env.starts:UniformStart", low=-20.0, high=20.0),
    },
    "transformation": {
        "exponential": FactorySpec.of("ptne_env.clock:Exponential"),
        "rational": FactorySpec.of("ptne_env.clock:Rational"),
        "tanh": FactorySpec.of("ptne_env.clock:HyperbolicTangent"),
    },
    "channel": {"perfect": FactorySpec.of("ptne_env.channel:perfect")},
    "disturbance": {"none": FactorySpec.of("ptne_env.disturbances:Undisturbed")},
}
_PARTS: Mapping[str, tuple[type, ...]] = {
    "game": (Game, GameFamily),
    "topology": (SwitchingTopology,),
    "start": (Start,),
    "transformation": (TimeTransformation,),
    "channel": (Channel,),
    "disturbance": (Disturbance,),
}


def _as_part(field: str, value: Any) -> FactorySpec:
    if isinstance(value, FactorySpec):
        return value
    if isinstance(value, Mapping):
        return FactorySpec.from_dict(value)
    if isinstance(value, str):
        known = _SHORTHANDS.get(field, {})
        if value in known:
            return known[value]
        if ":" in value:
            return FactorySpec.of(value)
        choices = [*map(repr, known), "a 'module:object' string", "a FactorySpec"]
        raise ValueError(f"{field} is {', '.join(choices[:-1])} or {choices[-1]}; got {value!r}")
    raise ValueError(f"{field} is a name, a 'module:object' string or a FactorySpec, got {type(value).__name__}")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """The physics of an experiment. Two scenarios are equal when every field is, and can be dictionary keys.

    ``game``, ``topology``, ``start``, ``transformation``, ``channel`` and ``disturbance`` accept a
    :class:`~ptne_env.factory.FactorySpec`, a ``"module:object"`` string or the short names below, and hold a FactorySpec afterwards.

    Attributes:
        name: for tables and files.
        game: builds a :class:`~ptne_env.games.Game`, or a :class:`~ptne_env.games.GameFamily` of which every episode
            draws one.
        topology: builds a :class:`~ptne_env.switching.SwitchingTopology` on the game's players.
        start: builds a :class:`~ptne_env.starts.Start`; ``"paper"`` or ``"random"`` (every estimate U(−20, 20)).
        transformation: builds λ from ``deadline``; ``"exponential"`` (paper), ``"rational"`` or ``"tanh"``.
        deadline: T in seconds.
        gain: c in 1/s, the constant part of the prescribed-time gain.
        steps: K, steps to the deadline.
        s_end: transformed time at which they stop.
        spacing: ``"effective"``, ``"transformed"`` or ``"physical"``; see :class:`~ptne_env.clock.StepClock`.
        hold_steps: steps after the deadline.
        input_limit: largest |u| of every component, the same for every policy.
        channel: builds a :class:`~ptne_env.channel.Channel`, what happens to messages on the way; ``"perfect"``.
        disturbance: builds a :class:`~ptne_env.disturbances.Disturbance` of the strategies' velocities; ``"none"``.
        clock_shifts: by how many seconds each player's clock is fast (see :meth:`~ptne_env.clock.StepClock.read`);
            empty where all clocks are right.
        slots: neighbour slots per player, unused ones being padded, so that graphs of different degrees have one
            layout; the largest degree in the union graph if ``None``.

    Raises:
        ValueError: when a part cannot be built, a number is out of range, the game and the graphs disagree on the
            number of players, the graphs can never be (jointly) connected, a dwell is shorter than the longest step,
            there are too few slots, or not as many clock shifts as players.
    """

    name: str
    game: FactorySpec
    topology: FactorySpec
    start: FactorySpec
    transformation: FactorySpec = _SHORTHANDS["transformation"]["exponential"]
    deadline: float = 1.2
    gain: float = 20.0
    steps: int = 400
    s_end: float = 8.0
    spacing: Spacing = "effective"
    hold_steps: int = 0
    input_limit: float = 1000.0
    channel: FactorySpec = _SHORTHANDS["channel"]["perfect"]
    disturbance: FactorySpec = _SHORTHANDS["disturbance"]["none"]
    clock_shifts: tuple[float, ...] = ()
    slots: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ValueError(f"the name of a scenario is a string, got {self.name!r}")
        for field in _PARTS:
            object.__setattr__(self, field, _as_part(field, getattr(self, field)))
        require_positive("input_limit", self.input_limit)
        clock = self.built_clock  # validates deadline, gain, steps, s_end, spacing, hold_steps
        game, topology = self.built_game, self.built_topology
        if topology.num_players != game.num_players:
            raise ValueError(
                f"scenario {self.name!r}: the game has {game.num_players} players, the graphs {topology.num_players}"
            )
        if not topology.is_jointly_connected:
            kind = "graph is disconnected" if topology.is_fixed else "graphs are not jointly connected over a period"
            raise ValueError(
                f"scenario {self.name!r}: the {kind} (Assumptions 1 and 2), so no law can reach the equilibrium; add "
                f"links between the components of {topology.union!r}"
            )
        if not topology.is_fixed:
            longest = float(np.diff(clock.topology_times[topology.clock]).max())
            if topology.shortest_dwell < longest * (1 - 1e-9):
                raise ValueError(
                    f"scenario {self.name!r}: the shortest dwell, {topology.shortest_dwell:.4g} on the {topology.clock} "
                    f"clock, is shorter than the longest step, {longest:.4g}, so graphs would be skipped; use more "
                    "steps, another spacing or longer dwells"
                )
        self._check_players()
        # Fails here, not at the first reset, when the table of a fixed start has the wrong shape.
        self.built_start.draw(game.num_players, game.dimension, np.random.default_rng(0))
        if clock.shortfall > SHORTFALL_WARNING:
            warnings.warn(
                f"scenario {self.name!r}: the last step ends {clock.shortfall:.2%} of T short of the deadline; "
                "raise s_end to come closer",
                stacklevel=3,
            )

    def _check_players(self) -> None:
        """Check what has an entry for every player or neighbour, and that the remaining parts can be built."""
        degree = self.built_topology.union.largest_degree
        if self.slots is not None and require_count("slots", self.slots, 1) < degree:
            raise ValueError(
                f"scenario {self.name!r}: a player has {degree} neighbours and slots is {self.slots}; raise it to "
                f"{degree} at least"
            )
        shifts, players = self.clock_shifts, self.built_game.num_players
        if not isinstance(shifts, (tuple, list)):
            raise ValueError(f"clock_shifts is one number of seconds per player, or empty, got {shifts!r}")
        if len(shifts) not in (0, players):
            raise ValueError(
                f"scenario {self.name!r}: {players} players need {players} clock_shifts, or none, got {len(shifts)}"
            )
        object.__setattr__(self, "clock_shifts", tuple(require_finite("a clock shift", shift) for shift in shifts))
        self.built_channel, self.built_disturbance  # noqa: B018 - built here, so that they fail here

    def _build(self, field: str, **extra: Any) -> Any:
        part: FactorySpec = getattr(self, field)
        built = part.build(**extra)
        if not isinstance(built, _PARTS[field]):
            wanted = " or ".join(kind.__name__ for kind in _PARTS[field])
            raise ValueError(
                f"scenario {self.name!r}: the part {part.target!r} built a {type(built).__name__} where {field} needs "
                f"a {wanted}"
            )
        return built

    @cached_property
    def built_family(self) -> GameFamily:
        """The family of games, built once; of one member where ``game`` builds a game."""
        built: Game | GameFamily = self._build("game")
        return SingleGame(built) if isinstance(built, Game) else built

    @property
    def built_game(self) -> Game:
        """The game, or a typical member of the family."""
        return self.built_family.representative

    @property
    def has_random_game(self) -> bool:
        """Whether episodes play different games."""
        return not isinstance(self.built_family, SingleGame)

    @property
    def is_random(self) -> bool:
        """Whether two episodes of the same policy differ by randomness."""
        parts = (self.built_start, self.built_topology, self.built_channel, self.built_disturbance)
        return self.has_random_game or any(part.is_random for part in parts)

    @cached_property
    def built_topology(self) -> SwitchingTopology:
        """The switching topology, built once."""
        topology: SwitchingTopology = self._build("topology")
        return topology

    @cached_property
    def built_start(self) -> Start:
        """The law of the initial estimates, built once."""
        start: Start = self._build("start")
        return start

    @cached_property
    def built_channel(self) -> Channel:
        """What happens to messages, built once."""
        channel: Channel = self._build("channel")
        return channel

    @cached_property
    def built_disturbance(self) -> Disturbance:
        """The disturbance of the velocities, built once."""
        disturbance: Disturbance = self._build("disturbance")
        return disturbance

    @cached_property
    def built_clock(self) -> StepClock:
        """The table of steps, built once."""
        return StepClock(
            self._build("transformation", deadline=require_positive("deadline", self.deadline, " (T, in seconds)")),
            gain=self.gain,
            steps=self.steps,
            s_end=self.s_end,
            spacing=self.spacing,
            hold_steps=self.hold_steps,
        )

    def replace(self, **changes: Any) -> Scenario:
        """A copy with some fields changed.

        Raises:
            ValueError: when a key is not a field, naming the fields, or the result is not a valid scenario.
        """
        known = [field.name for field in dataclasses.fields(self)]
        unknown = sorted(set(changes) - set(known))
        if unknown:
            raise ValueError(
                f"unknown scenario field {', '.join(map(repr, unknown))}; the fields are {', '.join(known)}"
            )
        return dataclasses.replace(self, **changes) if changes else self

    def to_dict(self) -> dict[str, Any]:
        """A JSON object with one entry per field."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        values["clock_shifts"] = list(self.clock_shifts)
        return {name: value.to_dict() if isinstance(value, FactorySpec) else value for name, value in values.items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scenario:
        """The inverse of :meth:`to_dict`. Building it imports the modules that its parts name.

        Raises:
            ValueError: when a key is unknown or missing, or the scenario is not valid.
        """
        fields = dataclasses.fields(cls)
        unknown = sorted(set(data) - {field.name for field in fields})
        required = {field.name for field in fields if field.default is dataclasses.MISSING}
        missing = sorted(required - set(data))
        if unknown or missing:
            raise ValueError(f"not a scenario: unknown keys {unknown}, missing keys {missing}")
        return cls(**data)

    def to_json(self) -> str:
        """The scenario as a JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Scenario:
        """The inverse of :meth:`to_json`.

        Raises:
            ValueError: when the text is not JSON or not a valid scenario.
        """
        data = json.loads(text)
        if not isinstance(data, dict):
            raise ValueError(f"not a scenario: expected a JSON object, got {type(data).__name__}")
        return cls.from_dict(data)


def _catalogue() -> dict[str, Scenario]:
    energy = FactorySpec.of("ptne_env.games:EnergyGame")
    corrected = FactorySpec.of("ptne_env.games:NonQuadraticGame", variant="corrected")
    printed = FactorySpec.of("ptne_env.games:NonQuadraticGame", variant="printed")
    ring = FactorySpec.of("ptne_env.switching:fixed", graph=FactorySpec.of("ptne_env.graphs:cycle", players=5))
    physical = FactorySpec.of("ptne_env.switching:paper_topology", dwell=0.1, clock="physical")
    transformed = FactorySpec.of("ptne_env.switching:paper_topology", dwell=0.25, clock="transformed")
    start = _SHORTHANDS["start"]["paper"]
    family = FactorySpec.of("ptne_env.games:RandomEnergy", players=5)
    anywhere = _SHORTHANDS["start"]["random"]

    def in_games(name: str, **arguments: Any) -> FactorySpec:
        return FactorySpec.of(f"ptne_env.games:{name}", **arguments)

    def between(low: float, high: float) -> FactorySpec:
        return FactorySpec.of("ptne_env.starts:UniformStart", low=low, high=high)

    square = FactorySpec.of("ptne_env.switching:fixed", graph=FactorySpec.of("ptne_env.graphs:cycle", players=4))
    hvac = FactorySpec.of(
        "ptne_env.games:EnergyGame", target=(50.0, 55.0, 60.0, 65.0, 70.0), coupling=0.04, base_price=5.0
    )
    scenarios = [
        Scenario(name="energy", game=energy, topology=ring, start=start),
        Scenario(name="energy-switching", game=energy, topology=physical, start=start),
        Scenario(name="energy-switching-transformed", game=energy, topology=transformed, start=start),
        Scenario(name="non-quadratic", game=corrected, topology=ring, start=start),
        Scenario(name="non-quadratic-switching", game=corrected, topology=physical, start=start),
        Scenario(name="non-quadratic-printed", game=printed, topology=ring, start=start),
        Scenario(name="random-energy", game=family, topology=ring, start=anywhere, s_end=6.0),
        Scenario(name="random-energy-switching", game=family, topology=physical, start=anywhere, s_end=6.0),
        Scenario(
            name="random-energy-switching-transformed", game=family, topology=transformed, start=anywhere, s_end=6.0
        ),
        Scenario(name="hvac-ye-hu", game=hvac, topology=ring, start=between(0.0, 100.0)),
        Scenario(name="cournot", game=in_games("NetworkedCournot"), topology=ring, start=between(0.0, 6.0)),
        Scenario(name="oligopoly", game=in_games("Oligopoly"), topology=square, start=between(20.0, 60.0)),
        Scenario(name="robots", game=in_games("ConnectivityControl"), topology=ring, start=between(-10.0, 10.0)),
        Scenario(name="ev-charging", game=in_games("ElectricVehicleCharging"), topology=ring, start=between(0.0, 2.0)),
        Scenario(name="rate-control", game=in_games("RateControl"), topology=ring, start=between(0.0, 4.0)),
        Scenario(name="random-affine", game=in_games("RandomAffine", players=5), topology=ring, start=anywhere),
        Scenario(name="weakly-monotone", game=in_games("WeaklyMonotoneGame"), topology=ring, start=anywhere),
    ]
    return {scenario.name: scenario for scenario in scenarios}


CATALOGUE: Mapping[str, Scenario] = _catalogue()
"""The named scenarios, in the order in which tables list them."""


def get_scenario(scenario: str | Scenario, **overrides: Any) -> Scenario:
    """A scenario by name (or as it is), with some fields changed: ``get_scenario("energy", start="random")``.

    Raises:
        ValueError: for an unknown name or field, or an invalid result.
    """
    if isinstance(scenario, str):
        if scenario not in CATALOGUE:
            raise ValueError(f"unknown scenario {scenario!r}; the catalogue has {', '.join(CATALOGUE)}")
        scenario = CATALOGUE[scenario]
    return scenario.replace(**overrides)
