"""Parts: what scenarios and comparisons are made of, each named by a string and the arguments to call it with.

A part of this library has an id such as ``game:random-energy``, so that moving its file changes nothing that is stored.
Any other callable is named by ``module:object``.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any, Self

import numpy as np

from ptne_env.shared.names import unknown_name

PARTS: Mapping[str, str] = {
    "game:affine": "ptne_env.games:AffineGame",
    "game:coupled": "ptne_env.games:CoupledConstraint",
    "game:cournot": "ptne_env.games:NetworkedCournot",
    "game:energy": "ptne_env.games:EnergyGame",
    "game:ev-charging": "ptne_env.games:ElectricVehicleCharging",
    "game:non-quadratic": "ptne_env.games:NonQuadraticGame",
    "game:oligopoly": "ptne_env.games:Oligopoly",
    "game:priced": "ptne_env.games:priced",
    "game:random-affine": "ptne_env.games:RandomAffine",
    "game:random-energy": "ptne_env.games:RandomEnergy",
    "game:random-saturating": "ptne_env.games:RandomSaturating",
    "game:rate-control": "ptne_env.games:RateControl",
    "game:robots": "ptne_env.games:ConnectivityControl",
    "game:saturating": "ptne_env.games:SaturatingGame",
    "game:single": "ptne_env.games:SingleGame",
    "game:weakly-monotone": "ptne_env.games:WeaklyMonotoneGame",
    "topology:circulant": "ptne_env.world.graphs:circulant",
    "topology:complete": "ptne_env.world.graphs:complete",
    "topology:cycle": "ptne_env.world.graphs:cycle",
    "topology:edges": "ptne_env.world.graphs:from_edges",
    "topology:episode": "ptne_env.world.switching:EpisodeTopology",
    "topology:graph": "ptne_env.world.graphs:Graph",
    "topology:paper": "ptne_env.world.switching:paper_topology",
    "topology:path": "ptne_env.world.graphs:path",
    "topology:periodic": "ptne_env.world.switching:SwitchingTopology",
    "topology:random": "ptne_env.world.switching:RandomTopology",
    "topology:random-edges": "ptne_env.world.switching:random_edges",
    "topology:random-graphs": "ptne_env.world.switching:random_graphs",
    "topology:star": "ptne_env.world.graphs:star",
    "start:fixed": "ptne_env.world.starts:FixedStart",
    "start:paper": "ptne_env.world.starts:PaperStart",
    "start:uniform": "ptne_env.world.starts:UniformStart",
    "transformation:exponential": "ptne_env.world.clock:Exponential",
    "transformation:rational": "ptne_env.world.clock:Rational",
    "transformation:tanh": "ptne_env.world.clock:HyperbolicTangent",
    "channel:bias": "ptne_env.world.channels:Bias",
    "channel:bursts": "ptne_env.world.channels:BurstLoss",
    "channel:chain": "ptne_env.world.channels:Chain",
    "channel:delay": "ptne_env.world.channels:Delay",
    "channel:heavy-tails": "ptne_env.world.channels:HeavyTails",
    "channel:late-noise": "ptne_env.world.channels:LateNoise",
    "channel:liar": "ptne_env.world.channels:Lying",
    "channel:loss": "ptne_env.world.channels:Loss",
    "channel:noise": "ptne_env.world.channels:AdditiveNoise",
    "channel:perfect": "ptne_env.world.channels:perfect",
    "channel:rounding": "ptne_env.world.channels:UniformQuantiser",
    "disturbance:uniform": "ptne_env.world.disturbances:UniformDisturbance",
    "law:adaptive": "ptne_env.laws:Adaptive",
    "law:adaptive-grounded": "ptne_env.laws:AdaptiveGrounded",
    "law:contact-relay": "ptne_env.laws:ContactRelay",
    "law:corollary-one": "ptne_env.laws:CorollaryOne",
    "law:grounded": "ptne_env.laws:Grounded",
    "law:observer-relay": "ptne_env.laws:ObserverRelay",
    "law:residual-coder": "ptne_env.laws:ResidualCoder",
    "law:oracle": "ptne_env.laws:Oracle",
    "law:projected-gradient": "ptne_env.laws:ProjectedGradient",
    "law:proximal-best-response": "ptne_env.laws:ProximalBestResponse",
    "law:random": "ptne_env.laws:RandomPolicy",
    "law:routed-unknown": "ptne_env.laws:RoutedUnknown",
    "law:static": "ptne_env.laws:Static",
    "law:zero-input": "ptne_env.laws:ZeroInput",
    "policy:file": "ptne_env.learn:load",
}
"""The parts that ship, by id. Adding one takes its class or function and one line here; tests import each."""

_IDS = {target: name for name, target in PARTS.items()}

_MAIN = "__main__"
"""Name of the module of the program or notebook that runs."""


def part_id(target: str) -> str:
    """The id of a part of this library that is named by ``module:object``; any other target as it is."""
    return _IDS.get(target, target)


def is_part(target: str) -> bool:
    """Whether a target is a part of this library; any other target may run any code."""
    return part_id(target) in PARTS


def foreign_targets(data: Any) -> list[str]:
    """The targets in a spec, or in JSON data at any depth, that are no parts of this library; nothing is imported.

    Args:
        data: a :class:`FactorySpec`, or the content of a file: a scenario, a suite or results. In all of these, what
            names a callable is an object with the key ``target``.

    Returns:
        The targets, sorted, each once.
    """
    found, pending = set(), [data]
    while pending:
        value = pending.pop()
        if isinstance(value, FactorySpec):
            value = value.to_dict()
        if isinstance(value, Mapping):
            target = value.get("target")
            if isinstance(target, str) and not is_part(target):
                found.add(target)
            pending.extend(value.values())
        elif isinstance(value, list | tuple):
            pending.extend(value)
    return sorted(found)


def resolve(target: str) -> Any:
    """Import the object that an id or ``module:object`` names.

    Raises:
        ValueError: when the string has another form, or the module cannot be imported or has no such object.
    """
    module_name, separator, attribute = PARTS.get(target, target).partition(":")
    if not (separator and module_name and attribute):
        raise ValueError(f"a part is named by an id such as 'law:static' or by 'module:object', got {target!r}")
    try:
        module = importlib.import_module(module_name)
    except (ImportError, TypeError) as error:  # a relative name is a TypeError
        alike = [name.partition(":")[2] for name in PARTS if name.startswith(f"{module_name}:")]
        if alike:
            raise ValueError(unknown_name(module_name, attribute, alike)) from error
        raise ValueError(f"cannot import the module of part {target!r}: {error}") from error
    try:
        return getattr(module, attribute)
    except AttributeError as error:
        if module_name == _MAIN:
            raise ValueError(
                f"part {target!r} was defined in a program or notebook that is not the one that runs: "
                "define it in a module, which every program can import"
            ) from error
        raise ValueError(f"module {module_name!r} has no {attribute!r}; part {target!r} cannot be built") from error


class Part:
    """The base class of parts: an instance remembers the arguments that it is made with, so that a spec can name it."""

    _made_with: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *arguments: Any, **named: Any) -> Self:
        """An instance, which ``__init__`` fills."""
        made = super().__new__(cls)
        object.__setattr__(made, "_made_with", (arguments, named))
        return made


def _target(definition: Any) -> str:
    """``module:object`` of a class or a function; the package that exports it stands for its module.

    Raises:
        ValueError: when no module has it under its name.
    """
    if not isinstance(definition, type | FunctionType):
        raise TypeError(f"a part is named by a string, a class or a function, got {definition!r}")
    module, name = definition.__module__, definition.__qualname__
    if "." in name:
        raise ValueError(
            f"{name} is defined inside a function or a class: define it at the top of a module or notebook"
        )
    if module == _MAIN and not hasattr(sys.modules[_MAIN], name):  # it was sent from another process
        setattr(sys.modules[_MAIN], name, definition)
    if getattr(sys.modules.get(module), name, None) is not definition:
        raise ValueError(
            f"module {module!r} has no {name}, or another one since this object was made: define {name} at the top of "
            "a module or notebook, and make the object again"
        )
    package = module.rpartition(".")[0]
    while package and getattr(sys.modules[package], name, None) is definition:
        module, package = package, package.rpartition(".")[0]
    return f"{module}:{name}"


def _by_name(signature: inspect.Signature, arguments: tuple[Any, ...], named: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a call by name; ``TypeError`` where one has none."""
    found = dict(signature.bind(*arguments, **named).arguments)
    for name, parameter in signature.parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            found |= found.pop(name, {})
        elif parameter.kind in (parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY) and name in found:
            raise TypeError(f"argument {name!r} has no name in a call")
    return found


def _alike(first: Any, second: Any) -> bool:
    """Whether two objects that were made in the same way hold the same numbers and strings."""
    if type(first) is not type(second):
        return False
    if isinstance(first, Part):
        first, second = ({**vars(part), "_made_with": ()} for part in (first, second))
    if isinstance(first, np.ndarray):
        return first.dtype == object or np.array_equal(first, second, equal_nan=first.dtype.kind in "fc")
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(_alike, first, second))
    if isinstance(first, dict):  # a cached property is in one of them only
        return all(_alike(first[name], second[name]) for name in first.keys() & second.keys())
    return not isinstance(first, str | bool | int | float) or first == second or first != first  # noqa: PLR0124 - NaN


def _freeze(value: Any) -> Any:
    if isinstance(value, Mapping):
        return FactorySpec.from_dict(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_freeze(item) for item in value)
    if isinstance(value, str | bool | int | float | FactorySpec) or value is None:
        return value
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _freeze(value.tolist())
    if isinstance(value, Part | type | FunctionType):
        return FactorySpec.naming(value)
    raise TypeError(f"arguments of a part are numbers, strings, lists and parts, got {type(value).__name__}")


def _mapped(value: Any, change: Callable[[FactorySpec], Any], sequence: type[Any] = tuple) -> Any:
    """An argument with every spec in it changed, and every tuple a ``sequence``."""
    if isinstance(value, FactorySpec):
        return change(value)
    return sequence(_mapped(item, change, sequence) for item in value) if isinstance(value, tuple) else value


@dataclass(frozen=True)
class FactorySpec:
    """A callable, named by the id of a part or by ``module:object``, with keyword arguments; hashable, as JSON too.

    Arguments may be numbers, strings, lists and other specs. :meth:`of` is the constructor to use.

    Attributes:
        target: the id of a part that ships, also where ``module:object`` of one was given; else ``module:object``.
        arguments: names and values, sorted.
    """

    target: str
    arguments: tuple[tuple[str, Any], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", part_id(self.target))

    @classmethod
    def of(cls, target: str | Callable[..., Any], /, **arguments: Any) -> FactorySpec:
        """The spec of ``target`` with keyword ``arguments``; lists and arrays become tuples.

        Args:
            target: an id, ``module:object``, or the class or function itself.
            **arguments: to call it with.

        Raises:
            ValueError: for a class or function that no module has under its name.
            TypeError: for an argument that is none of the above.
        """
        name = target if isinstance(target, str) else _target(target)
        return cls(name, tuple((name, _freeze(value)) for name, value in sorted(arguments.items())))

    @classmethod
    def naming(cls, part: Part | Callable[..., Any]) -> FactorySpec:
        """The spec that makes an object like ``part``, from the arguments that this one was made with.

        Args:
            part: an instance, or a class or function that is called without arguments.

        Raises:
            ValueError: when its class is in no module, its arguments are no numbers, strings, lists or parts, or the
                spec makes another object, because this one was changed or its constructor draws random numbers.
        """
        if not isinstance(part, Part):
            return cls.of(part)
        kind, (arguments, named) = type(part), part._made_with  # noqa: SLF001 - of this module
        try:
            spec = cls.of(kind, **_by_name(inspect.signature(kind), arguments, named))
        except TypeError as error:
            raise ValueError(
                f"a {kind.__name__} cannot be named by its arguments ({error}): define a function without arguments "
                "that makes it, at the top of a module, and name the function"
            ) from error
        if not _alike(part, spec.build()):
            raise ValueError(
                f"the arguments of this {kind.__name__} make another one: it was changed later, or it draws random "
                "numbers when it is made; give what differs, such as a seed, as an argument"
            )
        return spec

    def __reduce__(self) -> tuple[Any, ...]:
        """A spec takes a target in a notebook along, which workers cannot import: cloudpickle sends it by value."""
        if self.target.partition(":")[0] != _MAIN:
            return FactorySpec, (self.target, self.arguments)
        return _arrived, (self.target, self.arguments, resolve(self.target))

    def build(self, /, **extra: Any) -> Any:
        """Import the target and call it with the arguments and with ``extra`` ones of the caller.

        Raises:
            ValueError: when the target cannot be imported or refuses the arguments.
        """
        target = resolve(self.target)
        arguments = {name: _mapped(value, FactorySpec.build) for name, value in self.arguments}
        try:
            return target(**arguments, **extra)
        except (TypeError, AttributeError, LookupError, ArithmeticError) as error:  # typical effects of wrong arguments
            if not arguments and not isinstance(error, TypeError):
                raise  # without arguments the mistake is in the target
            given = sorted(arguments | extra)
            advice = f"; name it with arguments, FactorySpec.of({self.target!r}, ...)" * (not given)
            raise ValueError(f"part {self.target!r} refuses its arguments {given}: {error}{advice}") from error

    def to_dict(self) -> dict[str, Any]:
        """A JSON object ``{"target": ..., "arguments": {...}}``."""
        arguments = {name: _mapped(value, FactorySpec.to_dict, list) for name, value in self.arguments}
        return {"target": self.target, "arguments": arguments}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> FactorySpec:
        """The inverse of :meth:`to_dict`.

        Raises:
            ValueError: unless the keys are ``target``, a string, and optionally ``arguments``, an object, or when
                parts are nested too deeply.
        """
        if not {"target"} <= set(data) <= {"target", "arguments"}:
            raise ValueError(f"a part is an object with 'target' and 'arguments', got the keys {sorted(data)}")
        target, arguments = data["target"], data.get("arguments", {})
        if not (isinstance(target, str) and isinstance(arguments, Mapping)):
            raise ValueError(f"a part has a string 'target' and an object 'arguments', got {dict(data)!r}")
        try:
            return cls.of(target, **arguments)
        except RecursionError:
            raise ValueError(f"the arguments of part {target!r} are nested too deeply") from None


def _arrived(target: str, arguments: tuple[tuple[str, Any], ...], definition: Any) -> FactorySpec:
    """The spec with a local target in another process, whose ``__main__`` gets the definition."""
    setattr(sys.modules[_MAIN], target.partition(":")[2], definition)
    return FactorySpec(target, arguments)
