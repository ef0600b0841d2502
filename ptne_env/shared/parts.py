"""Factory specs: an object named by ``module:object`` and the arguments to call it with. The extension mechanism."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import FunctionType
from typing import Any, Self

import numpy as np

_PARTS = ("games", "world", "laws", "field")
"""Modules and packages of the library in which parts are defined."""

_MAIN = "__main__"
"""Name of the module of the program or notebook that runs."""

LOADER = "ptne_env.learn:load"
"""The other part: it reads an ``.onnx`` file, which is data."""


def resolve(target: str) -> Any:
    """Import the object named by ``module:object``.

    Raises:
        ValueError: when the string has another form, or the module cannot be imported or has no such object.
    """
    module_name, separator, attribute = target.partition(":")
    if not (separator and module_name and attribute):
        raise ValueError(f"a part is named as 'module:object', got {target!r}")
    try:
        module = importlib.import_module(module_name)
    except (ImportError, TypeError) as error:  # a relative name is a TypeError
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


@cache
def is_part(target: str) -> bool:
    """Whether a target is a part of this library; it imports modules of the library alone.

    Parts are the public classes and functions that are defined in, not only imported into, the modules of games,
    graphs, switching topologies, clocks, starts, channels, disturbances and laws, and the loader of ``.onnx`` files.
    Every other target may run any code.
    """
    module, _, name = target.partition(":")
    if not _defines_parts(module) or name.startswith("_"):
        return target == LOADER
    try:
        found = resolve(target)
    except ValueError:
        return False
    return isinstance(found, type | FunctionType) and _defines_parts(found.__module__)


def _defines_parts(module: str) -> bool:
    library, _, name = module.partition(".")
    return library == "ptne_env" and name.partition(".")[0] in _PARTS


def foreign_targets(spec: FactorySpec) -> list[str]:
    """The targets of a spec, nested ones too, that are no part of this library; nothing foreign is imported."""
    return [part.target for part in spec.nested() if not is_part(part.target)]


class Part:
    """The base class of parts: an instance remembers the arguments that it is made with, so that a spec can name it."""

    _made_with: tuple[tuple[Any, ...], dict[str, Any]]

    def __new__(cls, *arguments: Any, **named: Any) -> Self:
        """An instance, which ``__init__`` fills."""
        made = super().__new__(cls)
        object.__setattr__(made, "_made_with", (arguments, named))
        return made


def main_file() -> str | None:
    """The path of the program that runs; ``None`` for a notebook or an interactive session."""
    path = getattr(sys.modules[_MAIN], "__file__", None)
    return None if sys.flags.interactive or hasattr(sys, "ps1") else path


def _target(definition: Any) -> str:
    """``module:object`` of a class or a function; the package that exports it stands for its module.

    Raises:
        ValueError: when no module has it under its name.
    """
    module, name = definition.__module__, definition.__qualname__
    if "." in name:
        raise ValueError(
            f"{name} is defined inside a function or a class: define it at the top of a module or notebook"
        )
    main = sys.modules[_MAIN]
    if module == _MAIN and not hasattr(main, name):  # it was sent from another process
        setattr(main, name, definition)
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


def _build(value: Any) -> Any:
    if isinstance(value, FactorySpec):
        return value.build()
    if isinstance(value, tuple):
        return tuple(_build(item) for item in value)
    return value


def _specs(value: Any) -> Iterator[FactorySpec]:
    if isinstance(value, FactorySpec):
        yield from value.nested()
    elif isinstance(value, tuple):
        for item in value:
            yield from _specs(item)


def _to_json(value: Any) -> Any:
    if isinstance(value, FactorySpec):
        return value.to_dict()
    if isinstance(value, tuple):
        return [_to_json(item) for item in value]
    return value


@dataclass(frozen=True)
class FactorySpec:
    """A callable named by ``module:object`` with keyword arguments; hashable and JSON-serialisable.

    Arguments may be numbers, strings, lists and other specs. :meth:`of` is the constructor to use.
    """

    target: str
    arguments: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, target: str | Callable[..., Any], /, **arguments: Any) -> FactorySpec:
        """The spec of ``target`` with keyword ``arguments``; lists and arrays become tuples.

        Args:
            target: ``module:object``, or the class or function itself.
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

    @property
    def is_local(self) -> bool:
        """Whether the target is defined in the program or notebook that runs, which other processes do not import."""
        return self.target.partition(":")[0] == _MAIN

    def __reduce__(self) -> tuple[Any, ...]:
        """A spec with a local target takes the definition along: cloudpickle, which workers use, sends it by value."""
        if not self.is_local:
            return FactorySpec, (self.target, self.arguments)
        return _arrived, (self.target, self.arguments, self.resolve(), main_file())

    def nested(self) -> Iterator[FactorySpec]:
        """This spec, and the specs among its arguments at any depth."""
        yield self
        for _, value in self.arguments:
            yield from _specs(value)

    def resolve(self) -> Any:
        """Import the target without calling it.

        Raises:
            ValueError: as :func:`resolve`.
        """
        return resolve(self.target)

    def build(self, /, **extra: Any) -> Any:
        """Import the target and call it with the arguments and with ``extra`` ones of the caller.

        Raises:
            ValueError: when the target cannot be imported or refuses the arguments.
        """
        target = self.resolve()
        arguments = {name: _build(value) for name, value in self.arguments}
        try:
            return target(**arguments, **extra)
        except (TypeError, AttributeError, LookupError, ArithmeticError) as error:  # typical effects of wrong arguments
            if not arguments and not isinstance(error, TypeError):
                raise  # without arguments the mistake is in the target
            given = sorted(arguments | extra)
            raise ValueError(f"part {self.target!r} refuses its arguments {given}: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """A JSON object ``{"target": ..., "arguments": {...}}``."""
        return {"target": self.target, "arguments": {name: _to_json(value) for name, value in self.arguments}}

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


def _arrived(target: str, arguments: tuple[tuple[str, Any], ...], definition: Any, file: str | None) -> FactorySpec:
    """The spec with a local target in another process, whose ``__main__`` gets the definition, and the file to hash."""
    main = sys.modules[_MAIN]
    setattr(main, target.partition(":")[2], definition)
    if main_file() != file:
        main.__file__ = file
    return FactorySpec(target, arguments)
