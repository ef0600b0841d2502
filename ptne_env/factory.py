"""Factory specs: an object named by ``module:object`` and the arguments to call it with. The extension mechanism."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import FunctionType
from typing import Any

_PARTS = ("games", "graphs", "switching", "clock", "starts", "channel", "disturbances", "laws")
"""Modules and packages of the library in which parts are defined."""

LOADER = "ptne_env.policies:load"
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


def _freeze(value: Any) -> Any:
    if isinstance(value, Mapping):
        return FactorySpec.from_dict(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_freeze(item) for item in value)
    if isinstance(value, str | bool | int | float | FactorySpec) or value is None:
        return value
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _freeze(value.tolist())
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
    def of(cls, target: str, /, **arguments: Any) -> FactorySpec:
        """The spec of ``target`` with keyword ``arguments``; lists and arrays become tuples."""
        return cls(target, tuple((name, _freeze(value)) for name, value in sorted(arguments.items())))

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
            raise ValueError(f"part {self.target!r} refuses its arguments {sorted(arguments)}: {error}") from error

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
