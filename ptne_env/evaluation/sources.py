"""Hashes of the user's modules, which are found and read without importing them: an import runs their code."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import sysconfig
import warnings
from base64 import b64decode
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import file_digest, sha256
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec, PathFinder
from importlib.util import resolve_name, spec_from_file_location
from itertools import accumulate
from pathlib import Path
from pickletools import genops
from zipfile import ZipFile

UNHASHED = "cannot be hashed: "
"""Beginning of the text that stands in place of a hash; the reason follows."""

_INSTALLED = {"site-packages", "dist-packages"}
"""Names of the folders of installed packages."""

_STANDARD = {Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")}
"""The folders of Python's standard library."""

_TARGET = re.compile(r"(?a:([A-Za-z_][\w.]*):[A-Za-z_]\w*)")
_NO_SCRIPT = "a notebook or an interactive session has no source file; define it in a module"
_LONGEST_NAME = 4096
"""Characters of the longest path on Linux."""


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file in hexadecimal, or :data:`UNHASHED` with the reason where it cannot be read."""
    try:
        with Path(path).open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except OSError as error:
        return f"{UNHASHED}{error.strerror}"


def is_file(path: str | Path) -> bool:
    """Whether a file has this name; any text may be asked for, also one that cannot be a name."""
    return os.path.isfile(path)  # noqa: PTH113 - Path.is_file raises where a name is too long


def pickled_names(archive: str | Path) -> set[str]:
    """The strings in the pickles of a Stable-Baselines3 archive that may be names of modules; nothing is unpickled.

    An archive that cannot be read has none: loading it fails.
    """
    try:
        with ZipFile(archive) as file:
            data = json.loads(file.read("data"))
        pickles = [
            b64decode(item[":serialized:"])
            for item in data.values()
            if isinstance(item, dict) and ":serialized:" in item
        ]
        arguments = [argument for content in pickles for _, argument, _ in genops(content)]
    except Exception:  # noqa: BLE001 - foreign bytes may raise anything
        return set()
    words = {argument.partition(" ")[0] for argument in arguments if isinstance(argument, str)}  # "module name", or one
    return {word for word in words - {"__main__"} if all(part.isidentifier() for part in word.split("."))}


def module_hashes(names: Iterable[str], possible: Iterable[str] = ()) -> dict[str, str]:
    """SHA-256 of modules, of the modules of the user that they import, and of the files that their sources name.

    Modules of Python and of this library are left out, because their versions are known. An installed module is hashed
    alone. A module of the user is hashed with its packages, with all modules of the user that it imports or names as
    ``"module:object"``, and with the files that its source names by a string, relative to the module's folder or to the
    current folder.

    Args:
        names: of the modules, with dots.
        possible: names that may be modules of the user, or anything else.

    Returns:
        By the name of a module, by ``"module/path"`` of a file relative to its folder, and by the path of another file.
        :data:`UNHASHED` with the reason stands for a module that is not found or has no source.
    """
    asked = set(names)
    hashes: dict[str, str] = {}
    seen: set[tuple[str, bool]] = set()
    waiting = [(each, True) for name in asked for each in _with_packages(name)]
    waiting += [(each, False) for name in possible for each in _with_packages(name)]
    _find.cache_clear()  # files may have changed
    while waiting:
        name, is_needed = waiting.pop()
        if name in hashes or (name, is_needed) in seen:
            continue
        seen.add((name, is_needed))
        found = _find(name)
        if found is None:
            if is_needed:
                hashes[name] = f"{UNHASHED}{_NO_SCRIPT if name == '__main__' else 'no such module is found'}"
        elif _is_versioned(name, found) or (_is_installed(found) and name not in asked):
            continue
        elif _is_installed(found) or not str(found.origin).endswith(tuple(SOURCE_SUFFIXES)):
            hashes[name] = _hash_alone(found)
        else:
            module, hashes[name] = _read(name, found)
            hashes |= _data_hashes(name, Path(str(found.origin)).parent, module.texts)
            waiting += [(each, True) for imported in module.needed for each in _with_packages(imported)]
            waiting += [(each, False) for imported in module.possible for each in _with_packages(imported)]
    return hashes


@dataclass(frozen=True)
class _Module:
    """What the source of a module names.

    Attributes:
        needed: modules that it imports whenever it is imported.
        possible: modules that it may import.
        texts: strings that may name files.
    """

    needed: frozenset[str] = frozenset()
    possible: frozenset[str] = frozenset()
    texts: frozenset[str] = frozenset()


def _read(name: str, found: ModuleSpec) -> tuple[_Module, str]:
    """What a module of the user names, and the hash of its source."""
    is_package = found.submodule_search_locations is not None
    try:
        source = Path(str(found.origin)).read_bytes()
        return _parsed(source, name if is_package else name.rpartition(".")[0]), sha256(source).hexdigest()
    except OSError as error:
        return _Module(), f"{UNHASHED}{error.strerror}"
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return _Module(), f"{UNHASHED}its source cannot be parsed"


@lru_cache(maxsize=1000)
def _parsed(source: bytes, package: str) -> _Module:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tree = ast.parse(source)
    needed = {name for node in tree.body for name in _imported(node, package)}
    possible, texts = set(), set()
    for node in ast.walk(tree):
        possible.update(_imported(node, package))
        if isinstance(node, ast.ImportFrom):
            possible.update(f"{base}.{alias.name}" for base in _imported(node, package) for alias in node.names)
        elif isinstance(node, ast.Call):
            possible.update(_imported_by_call(node, package))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and 0 < len(node.value) < _LONGEST_NAME:
            texts.add(node.value)
            if target := _TARGET.fullmatch(node.value):
                possible.add(target[1])
    return _Module(frozenset(needed), frozenset(possible - needed), frozenset(texts))


def _imported(node: ast.AST, package: str) -> list[str]:
    """The modules that an import statement names before ``import``, or after it where nothing stands before."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        try:
            return [resolve_name("." * node.level + (node.module or ""), package)]
        except ImportError:  # beyond the outermost package: the statement fails
            return []
    return []


def _imported_by_call(node: ast.Call, package: str) -> list[str]:
    """The module of ``importlib.import_module("name")`` or ``__import__("name")``."""
    function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", None)
    name = node.args[0].value if node.args and isinstance(node.args[0], ast.Constant) else None
    if function not in ("import_module", "__import__") or not (isinstance(name, str) and name.strip(".")):
        return []
    try:
        return [resolve_name(name, package)]
    except ImportError:  # beyond the outermost package: the call fails
        return []


def _with_packages(name: str) -> Iterator[str]:
    """``a``, ``a.b``, ``a.b.c``: an import runs the packages of a module first."""
    return accumulate(name.split("."), "{}.{}".format)


@cache
def _find(name: str) -> ModuleSpec | None:
    """Where a module is, as an import would find it; no package is imported for that."""
    package, _, last = name.rpartition(".")
    if package:
        parent = _find(package)
        folders = None if parent is None else parent.submodule_search_locations
        return None if folders is None else PathFinder.find_spec(last, list(folders))
    if name == "__main__":
        path = getattr(sys.modules["__main__"], "__file__", None)
        return None if path is None else spec_from_file_location(name, path)
    finders = (getattr(finder, "find_spec", None) for finder in sys.meta_path)  # editable installations have their own
    return next((found for find in finders if find is not None and (found := find(name, None)) is not None), None)


def _is_versioned(name: str, found: ModuleSpec) -> bool:
    """Whether a module is of this library, of Python, or a folder without code of its own."""
    if name.partition(".")[0] == "ptne_env" or found.origin in ("built-in", "frozen"):
        return True
    if found.origin is None:
        return found.submodule_search_locations is not None
    return not _is_installed(found) and not _STANDARD.isdisjoint(Path(found.origin).parents)


def _is_installed(found: ModuleSpec) -> bool:
    return found.origin is not None and not _INSTALLED.isdisjoint(Path(found.origin).parts)


def _hash_alone(found: ModuleSpec) -> str:
    if found.origin is None or not found.origin.endswith((*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)):
        return f"{UNHASHED}its source is missing"
    return file_hash(found.origin)


def _data_hashes(module: str, folder: Path, texts: Iterable[str]) -> dict[str, str]:
    """The hashes of the files that strings in the source of a module name."""
    found = {}
    for text in texts:
        beside = folder / text
        if is_file(beside):
            found[text if Path(text).is_absolute() else f"{module}/{text}"] = file_hash(beside)
        if is_file(text) and not (is_file(beside) and beside.samefile(text)):
            found[text] = file_hash(text)
    return found
