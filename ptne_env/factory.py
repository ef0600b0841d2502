"""Factory specs: an object named by ``module:object`` and the arguments to call it with. The extension mechanism."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


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
    except ImportError as error:
        raise ValueError(f"cannot import the module of part {target!r}: {error}") from error
    try:
        return getattr(module, attribute)
    except AttributeError as error:
        raise ValueError(f"module {module_name!r} has no {attribute!r}; part {target!r} cannot be built") from error


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
            ValueError: unless the keys are ``target``, a string, and optionally ``arguments``, an object.
        """
        if not {"target"} <= set(data) <= {"target", "arguments"}:
            raise ValueError(f"a part is an object with 'target' and 'arguments', got the keys {sorted(data)}")
        target, arguments = data["target"], data.get("arguments", {})
        if not (isinstance(target, str) and isinstance(arguments, Mapping)):
            raise ValueError(f"a part has a string 'target' and an object 'arguments', got {dict(data)!r}")
        return cls.of(target, **arguments)
