"""Parts: what scenarios and comparisons are made of, each named by a string and the arguments to call it with.

A part of this library has an id such as ``game:random-energy``, so that moving its file changes nothing that is stored.
Any other callable is named by ``module:object``.
"""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property, wraps
from inspect import get_annotations, signature
from reprlib import repr as short_repr
from types import FunctionType
from typing import Any, ClassVar, dataclass_transform

import numpy as np

from ptne_env.shared.names import suggestion, unknown_name

PARTS: Mapping[str, str] = {
    "game:costs": "ptne_env.games:CostGame",
    "game:coupled": "ptne_env.games:CoupledConstraint",
    "game:cournot": "ptne_env.games:NetworkedCournot",
    "game:energy": "ptne_env.games:EnergyGame",
    "game:ev-charging": "ptne_env.games:ElectricVehicleCharging",
    "game:market": "ptne_env.games:CournotMarket",
    "game:market-118": "ptne_env.games:Market118",
    "game:non-quadratic": "ptne_env.games:NonQuadraticGame",
    "game:oligopoly": "ptne_env.games:Oligopoly",
    "game:priced": "ptne_env.games:price_constraint",
    "game:priced-costs": "ptne_env.games:PricedGame",
    "game:quadratic": "ptne_env.games:QuadraticGame",
    "game:random-affine": "ptne_env.games:RandomAffine",
    "game:random-energy": "ptne_env.games:RandomEnergy",
    "game:random-saturating": "ptne_env.games:RandomSaturating",
    "game:rate-control": "ptne_env.games:RateControl",
    "game:robots": "ptne_env.games:ConnectivityControl",
    "game:saturating": "ptne_env.games:SaturatingGame",
    "game:weakly-monotone": "ptne_env.games:WeaklyMonotoneGame",
    "topology:circulant": "ptne_env.world.graphs:circulant",
    "topology:complete": "ptne_env.world.graphs:complete",
    "topology:cycle": "ptne_env.world.graphs:cycle",
    "topology:edges": "ptne_env.world.graphs:from_edges",
    "topology:episode": "ptne_env.world.switching:EpisodeTopology",
    "topology:graph": "ptne_env.world.graphs:Graph",
    "topology:market-118": "ptne_env.world.graphs:market_118",
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
    "law:coded": "ptne_env.laws:Coded",
    "law:corollary-one": "ptne_env.laws:CorollaryOne",
    "law:fixed-time": "ptne_env.laws:FixedTime",
    "law:grounded": "ptne_env.laws:Grounded",
    "law:relay": "ptne_env.laws:Relay",
    "law:oracle": "ptne_env.laws:Oracle",
    "law:projected-gradient": "ptne_env.laws:ProjectedGradient",
    "law:proximal-best-response": "ptne_env.laws:ProximalBestResponse",
    "law:random": "ptne_env.laws:RandomPolicy",
    "law:routed-unknown": "ptne_env.laws:RoutedUnknown",
    "law:static": "ptne_env.laws:Static",
    "law:zero-input": "ptne_env.laws:ZeroInput",
    "policy:file": "ptne_env.learn:load",
    "suite:ptne-v1": "ptne_env.suites.ptne_v1:SUITE",
    "suite:robustness": "ptne_env.suites.robustness:robustness",
}
"""The parts that ship, by id. Adding one takes its class or function and one line here; tests import each."""

_IDS = {target: name for name, target in PARTS.items()}
"""The ids of parts by ``module:object``."""

_MAIN = "__main__"
"""Name of the module of the program or notebook that runs."""


def names_of(kind: str) -> list[str]:
    """Return the names of the parts of a kind, such as ``"law"``: their ids without the kind."""
    return [target.partition(":")[2] for target in PARTS if target.startswith(f"{kind}:")]


def target_of(kind: str, name: str, *others: str) -> str:
    """Return the target of a part by its name, id or ``module:object``; ``ValueError`` for a name of no part."""
    if ":" in name or name in (known := names_of(kind)):
        return name if ":" in name else f"{kind}:{name}"
    raise ValueError(unknown_name(kind, name, [*known, *others], "'module:object', an object or a FactorySpec"))


def is_part(target: str) -> bool:
    """Return whether a target is a part of this library; any other target may run any code."""
    return target in PARTS or target in _IDS


def foreign_targets(data: Any) -> list[str]:
    """List the targets in a spec or in JSON data that are no parts of this library, sorted; nothing is imported.

    The data may be the content of a file: a scenario, a suite or results. In all of these an object with the key
    ``target``, at any depth, names a callable.
    """
    foreign, pending = set(), [data]
    while pending:
        value = pending.pop()
        if isinstance(value, FactorySpec):
            value = value.to_dict()
        if isinstance(value, Mapping):
            target = value.get("target")
            if isinstance(target, str) and not is_part(target):
                foreign.add(target)
            pending.extend(value.values())
        elif isinstance(value, list | tuple):
            pending.extend(value)
    return sorted(foreign)


def resolve(target: str) -> Any:
    """Import and return the object that an id or ``module:object`` names.

    Raises:
        ValueError: when the string has another form, or the module cannot be imported or has no such object.
    """
    module_name, separator, attribute = PARTS.get(target, target).partition(":")
    if not (separator and module_name and attribute):
        raise ValueError(f"a part is named by an id such as 'law:static' or by 'module:object', got {target!r}")
    try:
        module = importlib.import_module(module_name)
    except (ImportError, TypeError, SystemExit) as error:  # a relative name is a TypeError
        if alike := names_of(module_name):
            raise ValueError(unknown_name(module_name, attribute, alike)) from error
        where = "modules are looked for in the current folder and on the Python path"
        raise ValueError(f"cannot import the module of part {target!r}: {error}; {where}") from error
    try:
        return getattr(module, attribute)
    except AttributeError as error:
        if module_name == _MAIN:
            raise ValueError(
                f"part {target!r} was defined in a program or notebook that is not the one that runs: "
                "define it in a module, which every program can import"
            ) from error
        public = [name for name in vars(module) if not name.startswith("_")]
        advice = suggestion(attribute, public)
        raise ValueError(f"module {module_name!r} has no {attribute!r} for the part {target!r}; {advice}") from error


def make(target: str) -> Any:
    """Return what a target names, or what it makes if it is a function or a class; errors are those of resolve."""
    named = resolve(target)
    return named() if callable(named) else named


def read_call(text: str) -> tuple[str, dict[str, Any]] | None:
    """Return name and arguments, if any, of ``"static(kappa=4)"``; ``ValueError`` for other than named constants."""
    if (parts := re.fullmatch(r"([^()=]+)\((.*)\)", text)) is None:
        return None
    try:
        call = ast.parse(f"_({parts[2]})", mode="eval").body
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and not call.args:
            return parts[1], {str(each.arg): ast.literal_eval(each.value) for each in call.keywords}
    except (SyntaxError, ValueError):
        pass
    raise ValueError(f"arguments are written as in 'static(kappa=4)', got {text!r}")


def checked(check: Callable[..., Any], *limits: Any, default: Any = MISSING) -> Any:
    """Declare a field of a part whose value is ``check(name, value, *limits)``, such as ``require_count`` and 1."""
    return field(default=default, metadata={"check": check, "limits": limits})


@dataclass_transform(eq_default=False, frozen_default=True, field_specifiers=(field, checked))
@dataclass(frozen=True, eq=False, repr=False)
class Part:
    """The base class of parts. Every subclass becomes a frozen dataclass, whose fields are its arguments.

    A subclass declares fields and derives everything else in (cached) properties, so that :meth:`FactorySpec.of` can
    read an object off its fields. :func:`checked` checks one field, ``__post_init__``, which calls that of its base,
    several together. Arrays are copied to read-only arrays, and lists to tuples. Two parts are equal if they have the
    same class and equal fields, where arrays, lists and tuples with the same entries are equal.

    A subclass may turn a field of its base into a class attribute or a property: ``clock = "physical"``. A field
    without a default is keyword-only where fields of the base have one.

    Raises:
        TypeError: when a subclass defines ``__init__``.
        dataclasses.FrozenInstanceError: when an attribute of an object is assigned.
    """

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "__init__" in vars(cls):
            raise TypeError(
                f"{cls.__name__} defines __init__, but the arguments of a part are its fields: declare them, such as "
                "`size: float = 1.0`, check them in __post_init__, and derive other attributes in cached properties"
            )
        own, inherited = get_annotations(cls).keys(), {each.name: each for each in fields(cls)}
        for name in (inherited.keys() & vars(cls).keys()) - own:
            cls.__annotations__[name] = ClassVar  # else the default of the base would hide it
        follows_default = any(
            inherited[name].default is not MISSING for name in inherited.keys() - vars(cls).keys() - own
        )
        for name in own - vars(cls).keys():  # else an attribute of the base with this name would be its default
            setattr(cls, name, field(kw_only=follows_default and name not in inherited))
        for value in vars(cls).values():
            if isinstance(value, cached_property):
                value.lock = nullcontext()  # type: ignore[attr-defined]  # Python 3.11 has a lock here, which no pickle holds
        dataclass(frozen=True, eq=False, repr=False)(cls)
        assign: Any = cls.__init__

        @wraps(assign)
        def __init__(self: Part, *arguments: Any, **named: Any) -> None:  # noqa: N807 - it becomes the method
            assign(
                self,
                *map(_copy_immutably, arguments),
                **{name: _copy_immutably(value) for name, value in named.items()},
            )

        cls.__init__ = __init__  # type: ignore[assignment,method-assign]  # it takes the fields, as assign does

    def __post_init__(self) -> None:
        for argument in fields(self):
            if "check" in argument.metadata:
                check, limits = argument.metadata["check"], argument.metadata["limits"]
                vars(self)[argument.name] = check(argument.name, getattr(self, argument.name), *limits)

    @cached_property
    def _values(self) -> tuple[Any, ...]:
        return tuple(as_tuples(getattr(self, argument.name)) for argument in fields(self))

    def __eq__(self, other: object) -> bool:
        return self is other or (type(self) is type(other) and self._values == other._values)

    def __hash__(self) -> int:
        return hash((type(self), self._values))

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={short_repr(value)}" for name, value in _changed_fields(self).items())
        return f"{type(self).__name__}({values})"


def _changed_fields(part: Part) -> dict[str, Any]:
    """Return the fields of a part that differ from their defaults, by name."""
    values = {}
    for argument in fields(part):
        default = argument.default if argument.default_factory is MISSING else argument.default_factory()
        value = getattr(part, argument.name)
        if default is MISSING or as_tuples(value) != as_tuples(default):
            values[argument.name] = value
    return values


def _copy_immutably(value: Any) -> Any:
    """Return an argument that nobody can change: a read-only copy of an array, a tuple for a list."""
    if isinstance(value, np.ndarray):
        value = np.array(value, subok=True)
        value.flags.writeable = False
    return tuple(map(_copy_immutably, value)) if isinstance(value, list | tuple) else value


def as_tuples(value: Any) -> Any:
    """Turn sequences, arrays, tensors and sparse matrices into tuples of Python's numbers, and leave all else."""
    for method in ("todense", "to_dense", "tolist"):
        value = getattr(value, method)() if hasattr(value, method) else value
    is_sequence = isinstance(value, Sequence) and not isinstance(value, str)
    return tuple(map(as_tuples, value)) if is_sequence else value


def _target(definition: Any) -> str:
    """Return the ``module:object`` that names a class or a function, with the package that exports it as the module.

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


def _as_argument(name: str, value: Any) -> Any:
    """Return a value as a spec holds it: hashable, and made of specs and of what JSON can hold."""
    value = as_tuples(value)
    if isinstance(value, tuple):
        return tuple(_as_argument(name, item) for item in value)
    if isinstance(value, Mapping):
        return FactorySpec.from_dict(value)
    if isinstance(value, Part | type | FunctionType):
        return FactorySpec.of(value)
    if isinstance(value, str | bool | int | float | FactorySpec) or value is None:
        return value
    kind = type(value).__name__
    raise TypeError(f"arguments of a part are numbers, strings, lists and parts, got {kind} for {name!r}")


def _replace_specs(value: Any, change: Callable[[FactorySpec], Any], sequence: type[Any] = tuple) -> Any:
    """Return an argument in which every spec is changed, and every tuple is a ``sequence``."""
    if isinstance(value, FactorySpec):
        return change(value)
    return sequence(_replace_specs(item, change, sequence) for item in value) if isinstance(value, tuple) else value


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
        object.__setattr__(self, "target", _IDS.get(self.target, self.target))

    @classmethod
    def of(cls, target: str | Part | Callable[..., Any], /, **arguments: Any) -> FactorySpec:
        """Return the spec of ``target`` with keyword ``arguments``; lists and arrays become tuples.

        Args:
            target: an id, ``module:object``, a class or function, or a part, whose fields are further arguments where
                they differ from their defaults.
            **arguments: numbers, strings, lists, arrays, parts and specs.

        Raises:
            ValueError: for a class or function that no module has under its name, or a part with a field that is none
                of the above.
            TypeError: for an argument that is none of the above.
        """
        if isinstance(target, Part):
            try:
                return cls.of(type(target), **{**_changed_fields(target), **arguments})
            except TypeError as error:
                raise ValueError(
                    f"a {type(target).__name__} cannot be named by its fields ({error}): define a function without "
                    "arguments that makes it, at the top of a module, and name the function"
                ) from error
        name = target if isinstance(target, str) else _target(target)
        return cls(name, tuple((name, _as_argument(name, value)) for name, value in sorted(arguments.items())))

    def __str__(self) -> str:
        """Return the form of a call, as in ``"static(kappa=2.0)"``; a part goes by its name."""
        arguments = ", ".join(f"{name}={value!r}" for name, value in self.to_dict()["arguments"].items())
        return f"{self.target.rpartition(':')[2] if is_part(self.target) else self.target}({arguments})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Take a target in a notebook along, which workers cannot import: cloudpickle sends it by value."""
        if self.target.partition(":")[0] != _MAIN:
            return FactorySpec, (self.target, self.arguments)
        return _unpickle, (self.target, self.arguments, resolve(self.target))

    def build(self, /, **extra: Any) -> Any:
        """Import the target and call it with the arguments and with the caller's ``extra`` ones, as nested parts are.

        Raises:
            ValueError: when the target cannot be imported or refuses the arguments.
        """
        target = resolve(self.target)
        arguments = {
            name: _replace_specs(value, lambda spec: FactorySpec._as_value(spec, **extra))
            for name, value in self.arguments
        }
        try:
            return target(**arguments, **extra)
        except (TypeError, AttributeError, LookupError, ArithmeticError) as error:  # typical effects of wrong arguments
            if not arguments and not isinstance(error, TypeError):
                raise  # without arguments the mistake is in the target
            names = sorted(arguments | extra)
            ways = f"'{self.target}(...)' or FactorySpec.of({self.target!r}, ...)"
            advice = f"; name it with arguments, {ways}" * (not names)
            if isinstance(target, type | FunctionType) and "unexpected keyword" in str(error):
                taken = signature(target).parameters
                for name in sorted(arguments.keys() - taken):
                    reason = f"has no argument {name!r}; {suggestion(name, taken)}"
                    raise ValueError(f"part {self.target!r} {reason}") from error
            raise ValueError(f"part {self.target!r} refuses its arguments {names}: {error}{advice}") from error

    def _as_value(self, /, **extra: Any) -> Any:
        """Return the argument that this stands for: what it makes, or a function that needs more, such as costs(x)."""
        target = resolve(self.target)
        if isinstance(target, FunctionType) and not self.arguments:
            needed = [each for each in signature(target).parameters.values() if each.default is each.empty]
            if any(each.name not in extra and each.kind is each.POSITIONAL_OR_KEYWORD for each in needed):
                return target
        return self.build(**extra)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object ``{"target": ..., "arguments": {...}}``."""
        arguments = {name: _replace_specs(value, FactorySpec.to_dict, list) for name, value in self.arguments}
        return {"target": self.target, "arguments": arguments}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> FactorySpec:
        """Make a spec from a JSON object, the inverse of :meth:`to_dict`.

        Raises:
            ValueError: unless the keys are ``target``, a string, and optionally ``arguments``, an object or its
                pairs, as ``dataclasses.asdict`` and so the JSON of Gymnasium's specs have them; or when parts are
                nested too deeply.
        """
        if not {"target"} <= set(data) <= {"target", "arguments"}:
            raise ValueError(f"a part is an object with 'target' and 'arguments', got the keys {sorted(data)}")
        target, arguments = data["target"], data.get("arguments", {})
        if isinstance(arguments, list | tuple) and all(
            isinstance(item, list | tuple) and len(item) == 2 and isinstance(item[0], str) for item in arguments
        ):
            arguments = dict(arguments)
        if not (isinstance(target, str) and isinstance(arguments, Mapping)):
            raise ValueError(f"a part has a string 'target' and an object 'arguments', got {dict(data)!r}")
        try:
            return cls.of(target, **arguments)
        except RecursionError:
            raise ValueError(f"the arguments of part {target!r} are nested too deeply") from None


def _unpickle(target: str, arguments: tuple[tuple[str, Any], ...], definition: Any) -> FactorySpec:
    """Return a spec that was sent by another process, and define its target in this one's ``__main__``."""
    setattr(sys.modules[_MAIN], target.partition(":")[2], definition)
    return FactorySpec(target, arguments)
