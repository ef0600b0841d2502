"""Content hashes, versions and file hashes: everything that a number depends on."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from hashlib import sha256
from importlib import metadata
from inspect import getsourcefile, unwrap
from pathlib import Path
from typing import Any

from ptne_env._version import __version__
from ptne_env.factory import FactorySpec
from ptne_env.policies import shipped_path

_PACKAGE = Path(__file__).parents[1]
_NOT_COMPUTING = ("cli", "paper", "report", "training")
"""Parts of the library on which no result of a job depends."""

_LIBRARIES = ("numpy", "scipy", "onnxruntime", "torch")


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


def is_hash_of(digest: Any, content: Any) -> bool:
    """Whether ``digest`` is the content hash of ``content``; content without a hash has no digest."""
    try:
        return bool(digest == content_hash(content))
    except (ValueError, RecursionError):  # NaN, or too deeply nested
        return False


@cache
def versions() -> dict[str, str]:
    """Versions of the library, Python and the libraries it computes with, and a hash of the computing sources."""
    sources = sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        name = path.relative_to(_PACKAGE)
        if name.parts[0] not in _NOT_COMPUTING:
            sources.update(name.as_posix().encode() + path.read_bytes())
    found = {"ptne_env": __version__, "sources": sources.hexdigest(), "python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            continue
    return found


def file_hashes(value: Any) -> dict[str, str]:
    """SHA-256 of the files outside the library's sources that factory specs need, by file name.

    Args:
        value: a factory spec, or a tuple of them; other values need no files.
    """
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in _paths(value) if path.is_file()}


def source_hashes(definitions: Iterable[Any]) -> dict[str, str]:
    """SHA-256 of the files outside the library's sources that define classes or functions, by file name."""
    found = {path for definition in definitions for path in _source(definition)}
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in sorted(found) if path.is_file()}


def _source(definition: Any) -> Iterator[Path]:
    try:
        source = getsourcefile(unwrap(definition))  # as it was written, whatever a decorator compiles later
    except TypeError:  # an object that is no class, function or module
        source = None
    if source is not None and not Path(source).is_relative_to(_PACKAGE):
        yield Path(source)


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, FactorySpec):
        yield from _source(value.resolve())
        yield from _paths(tuple(argument for _, argument in value.arguments))
    elif isinstance(value, tuple):
        for item in value:
            yield from _paths(item)
    elif isinstance(value, str):
        yield shipped_path(value) or Path(value)
