"""Content hashes, versions and file hashes: everything that a number depends on."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from types import FunctionType
from typing import Any

from ptne_env._version import __version__
from ptne_env.evaluation.sources import UNHASHED, file_hash, is_file, module_hashes, pickled_names
from ptne_env.learn import shipped_path
from ptne_env.shared.parts import PARTS, FactorySpec, is_part

_PACKAGE = Path(__file__).parents[1]
_NOT_COMPUTING = ("cli", "paper", "report", "training")
"""Parts of the library on which no result of a job depends."""

_LIBRARIES = ("numpy", "scipy", "networkx", "onnxruntime", "stable_baselines3", "torch")


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


def file_hashes(value: FactorySpec | tuple[FactorySpec, ...]) -> dict[str, str]:
    """SHA-256 of the modules and files that factory specs need; nothing is imported.

    The modules of all targets, nested ones too, are hashed by :func:`~ptne_env.evaluation.sources.module_hashes`. A
    string argument that names a file is hashed with the file; where the target is no part of the library, one that
    names a folder is hashed with all files in it. An archive of Stable-Baselines3 is hashed with the modules of the
    user that its pickles name. Names that a program computes are not seen.

    Args:
        value: a factory spec, or a tuple of them.

    Returns:
        By the name of a module, by ``"module/path"`` of a file that a module names, and by the path of another file as
        it was written. A text with the reason stands for what cannot be hashed: see :func:`unhashed`.
    """
    specs = [part for spec in (value if isinstance(value, tuple) else (value,)) for part in spec.nested()]
    texts = [(part, text) for part in specs for text in _texts(tuple(argument for _, argument in part.arguments))]
    archives = {text for _, text in texts if text.endswith(".zip")}
    found = module_hashes(
        (PARTS.get(part.target, part.target).partition(":")[0] for part in specs), (name for path in archives for name in pickled_names(path))
    )
    for part, text in texts:
        found |= _argument_hashes(text, with_folders=not is_part(part.target))
    return found


def source_hashes(definitions: Iterable[Any]) -> dict[str, str]:
    """SHA-256 of the modules and files that functions and classes need, as those of :func:`file_hashes`."""
    found, modules = {}, []
    for definition in definitions:
        if isinstance(definition, type | FunctionType):
            modules.append(definition.__module__)
        else:
            found[f"a {type(definition).__name__}"] = f"{UNHASHED}it is neither a function nor a class"
    return found | module_hashes(modules)


def unhashed(hashes: Mapping[str, str]) -> dict[str, str]:
    """The names in hashes of files of which nothing could be hashed, each with the reason."""
    return {name: value.removeprefix(UNHASHED) for name, value in hashes.items() if value.startswith(UNHASHED)}


def _texts(value: Any) -> Iterator[str]:
    """The strings in arguments; those of specs among the arguments are not in it."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _texts(item)


def _is_content(path: Path) -> bool:
    """Whether a path in a folder is hashed; a link to another folder is, as one of which nothing can be hashed."""
    return path.is_file() or (path.is_symlink() and path.is_dir())


def _argument_hashes(text: str, *, with_folders: bool) -> dict[str, str]:
    path = shipped_path(text) or Path(text)
    if is_file(path):
        return {text: file_hash(path)}
    if with_folders and path.name not in ("", "..") and os.path.isdir(path):  # noqa: PTH112 - as is_file
        inside = (each for each in path.rglob("*") if _is_content(each) and "__pycache__" not in each.parts)
        return {f"{text}/{each.relative_to(path).as_posix()}": file_hash(each) for each in sorted(inside)}
    return {}
