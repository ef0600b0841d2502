"""Atomic writes, and a check before files are read."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


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
    data = content.encode() if isinstance(content, str) else content
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
        else:
            _replace(Path(os.path.realpath(path)), data)
    except OSError as error:  # which may name a temporary file, or none
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _replace(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = temporary_file(path.parent, path.name)
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
    """Check that there is a file to read; a link to a file, a pipe or a device is one.

    Raises:
        FileNotFoundError: when there is nothing at ``path``.
        IsADirectoryError: when there is a folder.
    """
    if os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises where a name is too long
        raise IsADirectoryError(f"{str(path)!r} is a folder: name a file")
    if not os.path.exists(path):  # noqa: PTH110 - likewise
        raise FileNotFoundError(f"there is no file {str(path)!r}")


def temporary_file(folder: Path, name: str) -> tuple[int, str]:
    """A new file beside the file ``name``: its handle and its path."""
    return tempfile.mkstemp(dir=folder, prefix=f".{name}.")
