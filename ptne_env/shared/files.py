"""Files: atomic writes, JSON whose damage is detected, and checks before files are read or written."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

LARGEST_FILE = 32 << 20
"""Size in bytes above which a file is refused, unless its kind has a limit of its own."""


class DamagedFileError(ValueError):
    """A file that is cut off, damaged or something else than expected."""


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write ``content`` to ``path`` so that readers, also after an interruption, find the old file or the new one.

    Missing folders are created. A link stays, and its target is written. A device or a pipe, such as ``/dev/null``, is
    written to directly.

    Raises:
        OSError: naming ``path``, when it cannot be written, as on a full or read-only disk; the old file is untouched
            then.
    """
    # Python has the bytes of paths that are not in the encoding of the locale as surrogates.
    data = content.encode(errors="surrogateescape") if isinstance(content, str) else content
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
        else:
            _replace(Path(os.path.realpath(path)), data)
    except OSError as error:  # which may name a temporary file, or none
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _replace(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)  # mkstemp's files are private; this one is the user's like any other
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def require_file(path: str | Path) -> None:
    """Check that there is a regular file to read, or a link to one; a pipe or a device may never end.

    Raises:
        FileNotFoundError: when there is nothing at ``path``.
        IsADirectoryError: when there is a folder.
        DamagedFileError: when there is a pipe or a device.
    """
    if os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises where a name is too long
        raise IsADirectoryError(f"{str(path)!r} is a folder: name a file")
    if not os.path.exists(path):  # noqa: PTH110 - likewise
        raise FileNotFoundError(f"there is no file {str(path)!r}")
    if not os.path.isfile(path):  # noqa: PTH113 - likewise
        raise DamagedFileError(f"{str(path)!r} is a pipe or a device: name a regular file")


def read_file(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a regular file, which may have at most ``largest`` bytes.

    Raises:
        OSError: as :func:`require_file`, or when the file cannot be read.
        DamagedFileError: naming ``path``, when it is no regular file, or larger.
    """
    require_file(path)
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise DamagedFileError(f"{path} has more than {largest >> 20} MiB")
    return content


def read_json(path: Path, kind: str) -> dict[str, Any]:
    """Return the JSON object in a file of a ``kind``, which messages name, such as "a file of results".

    Errors are those of :func:`read_file`, and ``DamagedFileError`` when it holds no JSON object, or part of one.
    """
    data = read_file(path)
    try:
        value = json.loads(data, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"{path} is not {kind}: it is cut off, damaged or something else ({error})") from error
    if not isinstance(value, dict):
        raise DamagedFileError(f"{path} is not {kind}: expected a JSON object, got {type(value).__name__}")
    return value


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not JSON")


def require_suffix(subject: str, path: Path, known: Iterable[str]) -> str:
    """Return the suffix of a path in small letters; ``ValueError`` about the ``subject`` where it is not known."""
    if (suffix := path.suffix.lower()) not in (suffixes := list(known)):
        others = ", ".join(suffixes[:-1])
        raise ValueError(f"{subject} written to a file that ends in {others} or {suffixes[-1]}, got {path.name!r}")
    return suffix


def require_writable(path: Path) -> None:
    """Try before long work whether its result can be written atomically; nothing is left behind.

    Raises:
        OSError: naming ``path``, when it is a folder, its parent is no folder, or no file can be made there.
    """
    if path.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder")
    if path.exists() and not path.is_file():  # such as /dev/null, which is written to directly
        return
    target = Path(os.path.realpath(path))
    folder = next(parent for parent in target.parents if parent.exists())
    if not folder.is_dir():
        raise NotADirectoryError(f"cannot write {path}: {folder} is not a folder")
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix=f".{target.name}."):
            pass
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror} (in the folder {folder})") from error
