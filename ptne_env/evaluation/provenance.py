"""Provenance of results: hashes of content and files, and versions of libraries."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import file_digest, sha256
from importlib import metadata
from pathlib import Path
from typing import Any

from ptne_env._version import __version__

LIBRARIES = ("numpy", "scipy", "networkx")
"""The libraries that every result depends on."""


def content_hash(value: Any) -> str:
    """Return the SHA-256, in hexadecimal, of JSON with sorted keys, without spaces and keys whose value is ``None``."""

    def without_none(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {key: without_none(child) for key, child in item.items() if child is not None}
        return [without_none(child) for child in item] if isinstance(item, list | tuple) else item

    text = json.dumps(without_none(value), sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return sha256(text.encode()).hexdigest()


def file_hash(path: str | Path) -> str | None:
    """Return the SHA-256 of a file, in hexadecimal; ``None`` where there is none."""
    if not Path(path).is_file():
        return None
    with Path(path).open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def versions(others: Iterable[str] = ()) -> dict[str, str]:
    """Return the versions of the library, of :data:`LIBRARIES`, and of those of ``others`` that are installed."""
    installed = {"ptne_env": __version__, **{library: metadata.version(library) for library in LIBRARIES}}
    for library in others:
        with suppress(metadata.PackageNotFoundError):
            installed[library] = metadata.version(library)
    return installed
