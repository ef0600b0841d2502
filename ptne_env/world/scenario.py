"""The schema of a scenario: a frozen, serialisable record that names the parts of a world."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from types import FunctionType
from typing import TYPE_CHECKING, Any

from ptne_env.shared.arrays import require_printable
from ptne_env.shared.names import require_name
from ptne_env.shared.parts import FactorySpec, Part, as_tuples, read_call, target_of

if TYPE_CHECKING:  # so that the registries can read the catalogue without importing what builds a world
    from ptne_env.world.clock import Spacing

UNIFORM_START = FactorySpec.of("start:uniform", low=-20.0, high=20.0)

PART_FIELDS = ("game", "topology", "start", "transformation", "channel", "disturbance")
"""The fields that name a part; each is the kind of the ids of its parts."""

_ARRAYS = {"topology": ("topology:graph", "adjacency"), "start": ("start:fixed", "estimates")}
"""The parts that an array makes: their target, and the argument that is the array."""

_OTHERS = {"topology": ", an adjacency matrix, a graph of networkx", "start": ", an array (N, n)"}


def _as_spec(field: str, value: Any) -> FactorySpec:
    """Return the spec that a value of a field stands for."""
    if isinstance(value, FactorySpec):
        return value
    if isinstance(value, Mapping):
        return FactorySpec.from_dict(value)
    if isinstance(value, str):
        if (field, value) == ("start", "random"):
            return UNIFORM_START
        name, arguments = read_call(value) or (value, {})
        return FactorySpec.of(target_of(field, name, *["random"] * (field == "start")), **arguments)
    value = as_tuples(_read_topology(value) if field == "topology" else value)
    if isinstance(value, Part | type | FunctionType):
        return FactorySpec.of(value)
    if not isinstance(value, tuple) or field not in _ARRAYS:
        raise ValueError(
            f"{field} is an object of the library's class for it, the id of a part, a 'module:object' string or a "
            f"FactorySpec{_OTHERS.get(field, '')}, got a {type(value).__name__}"
        )
    target, argument = _ARRAYS[field]
    return FactorySpec.of(target, **{argument: value})


def _read_topology(value: Any) -> Any:
    """Return the matrix of a graph, the topology of a list of graphs with dwell times, and anything else as it is."""
    from ptne_env.world.graphs import adjacency
    from ptne_env.world.switching import SwitchingTopology

    first = value[0] if isinstance(value, list | tuple) and value else 0.0
    entries = first if isinstance(first, list | tuple) else [first]
    if all(isinstance(entry, Real | str) or getattr(entry, "ndim", 2) < 2 for entry in entries):  # of a matrix
        return adjacency(value)
    if not all(isinstance(pair, list | tuple) and len(pair) == 2 and isinstance(pair[1], Real) for pair in value):
        raise ValueError("graphs that take turns are pairs with dwell times, such as [(ring, 0.1), (star, 0.2)]")
    return SwitchingTopology([graph for graph, _ in value], [dwell for _, dwell in value])


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """The physics of an experiment. Two scenarios are equal when every field is, and can be dictionary keys.

    A scenario only names its parts; :class:`~ptne_env.world.world.World` builds and checks them. ``game``,
    ``topology``, ``start``, ``transformation``, ``channel`` and ``disturbance`` accept a
    :class:`~ptne_env.shared.parts.FactorySpec`, the id of a part, whole or without its kind, and perhaps with arguments
    (``channel="noise(std=0.1)"``), a ``"module:object"`` string, or the part itself (``game=MyGame(2.0)``), its class
    or a function that makes it, and hold a FactorySpec afterwards, which
    :meth:`~ptne_env.shared.parts.FactorySpec.of` explains.

    Attributes:
        name: for tables and files.
        game: builds a :class:`~ptne_env.games.Game`, or a :class:`~ptne_env.games.GameFamily` of which every episode
            draws one game.
        topology: builds a :class:`~ptne_env.world.switching.SwitchingTopology` on the game's players, or a
            :class:`~ptne_env.world.graphs.Graph` that never changes; also its matrix a_ij, (N, N), where i hears j, or
            a graph of networkx, as :func:`~ptne_env.world.graphs.adjacency` reads it; also a list of pairs of these
            with dwell times in seconds, ``[(ring, 0.1), (star, 0.2)]``, which take turns.
        start: builds a :class:`~ptne_env.world.starts.Start`; ``"paper"`` or ``"random"`` (every estimate U(−20, 20));
            also an array (N, n), row i being x^i(0).
        transformation: builds a :class:`~ptne_env.world.clock.TimeTransformation` from ``deadline``; ``"exponential"``
            (paper), ``"rational"`` or ``"tanh"``; an object must have the deadline of the scenario.
        deadline: T in seconds.
        gain: c in 1/s, the constant part of the prescribed-time gain.
        steps: K, steps to the deadline.
        s_end: transformed time of the last step's end.
        spacing: ``"effective"``, ``"transformed"`` or ``"physical"``; see :class:`~ptne_env.world.clock.StepClock`.
        hold_steps: steps after the deadline.
        input_limit: largest |u| of every component, the same for every policy.
        channel: builds a :class:`~ptne_env.world.channels.Channel`, the path of messages; ``"perfect"``.
        disturbance: builds a :class:`~ptne_env.world.disturbances.Disturbance` of the strategies' velocities, if any.
        slots: neighbour slots per player, unused ones being padded, so that graphs of different degrees have one
            layout; the largest degree in the union graph if ``None``.
        message_range: R, the range of every link: messages are clipped to ±R before the channel, and players know R. No
            range if ``None``.

    Raises:
        ValueError: when the name is no string, a part is named in none of the ways above, or the transformation has
            another deadline.
    """

    name: str
    game: FactorySpec
    topology: FactorySpec
    start: FactorySpec = UNIFORM_START
    transformation: FactorySpec = FactorySpec("transformation:exponential")
    deadline: float = 1.2
    gain: float = 20.0
    steps: int = 400
    s_end: float = 8.0
    spacing: Spacing = "effective"
    hold_steps: int = 0
    input_limit: float = 1000.0
    channel: FactorySpec = FactorySpec("channel:perfect")
    disturbance: FactorySpec | None = None
    slots: int | None = None
    message_range: float | None = None

    def __post_init__(self) -> None:
        require_printable("the name of a scenario", self.name)
        for field in PART_FIELDS:
            value = getattr(self, field)
            if value is not None or field != "disturbance":
                object.__setattr__(self, field, _as_spec(field, value))
        arguments = dict(self.transformation.arguments)
        if (own := arguments.pop("deadline", None)) not in (None, self.deadline):
            raise ValueError(
                f"the transformation has the deadline {own} and the scenario {self.deadline}: say deadline={own}, too"
            )
        object.__setattr__(self, "transformation", FactorySpec.of(self.transformation.target, **arguments))

    def replace(self, **changes: Any) -> Scenario:
        """Return a copy with some fields changed.

        Raises:
            ValueError: when a key is not a field, naming the fields, or as for a new scenario.
        """
        known = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            require_name("scenario field", name, known)
        return dataclasses.replace(self, **changes) if changes else self

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object with one entry per field."""
        fields = vars(self).items()
        return {name: value.to_dict() if isinstance(value, FactorySpec) else value for name, value in fields}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scenario:
        """Make a scenario from a JSON object, the inverse of :meth:`to_dict`; ``ValueError`` for other data."""
        fields = dataclasses.fields(cls)
        unknown = sorted(set(data) - {field.name for field in fields})
        required = {field.name for field in fields if field.default is dataclasses.MISSING}
        missing = sorted(required - set(data))
        if unknown or missing:
            raise ValueError(f"not a scenario: unknown keys {unknown}, missing keys {missing}")
        # A part is an object here, in which foreign_targets() sees what it names.
        named = [field for field in PART_FIELDS if isinstance(data.get(field), str)]
        if named:
            raise ValueError(f"not a scenario: {named[0]} is an object with the key 'target', got {data[named[0]]!r}")
        return cls(**data)
