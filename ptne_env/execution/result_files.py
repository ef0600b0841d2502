"""JSON files, whose damage is detected; files of results; a try before long work whether a file can be written."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.provenance import content_hash
from ptne_env.evaluation.results import FORMAT, Place, Results, Samples
from ptne_env.evaluation.tracks import Track
from ptne_env.shared.files import DamagedFileError, temporary_file

LARGEST_FILE = 32 * 2**20
"""Most bytes of a file of results."""


def read_json(path: Path, kind: str) -> dict[str, Any]:
    """The JSON object in a file.

    Args:
        path: of the file.
        kind: of file, for the message, such as "a file of results".

    Raises:
        OSError: when there is no such file, or it cannot be read.
        DamagedFileError: naming ``path``, when it holds no JSON object, or part of one.
    """
    if path.exists() and not path.is_file():  # a pipe or a device may never end
        raise DamagedFileError(f"{path} is not {kind}: it is no file")
    data = path.read_bytes()
    try:
        value = json.loads(data, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(f"{path} is not {kind}: it is cut off, damaged or something else ({error})") from error
    if not isinstance(value, dict):
        raise DamagedFileError(f"{path} is not {kind}: expected a JSON object, got {type(value).__name__}")
    return value


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not JSON")


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
    folder = target.parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(f"cannot write {path}: {folder} is not a folder")
    try:
        handle, temporary = temporary_file(folder, target.name)
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror} (in the folder {folder})") from error
    os.close(handle)
    Path(temporary).unlink()


def read_results(path: Path) -> dict[str, Any]:
    """The content of a file that holds :meth:`~ptne_env.evaluation.results.Results.to_dict`; nothing is imported.

    Args:
        path: of the file, or of its folder.

    Raises:
        OSError: when it cannot be read.
        ValueError: when it is damaged, too large, something else or of another format.
    """
    path = path / "results.json" if path.is_dir() else path
    if path.is_file() and path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path} is larger than {LARGEST_FILE // 2**20} MiB: it is no file of results")
    data = read_json(path, "a file of results")
    if data.get("format") != FORMAT:
        raise ValueError(f"{path} is no file of results of format {FORMAT}, which this library reads: run it again")
    content = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    if data.get("checksum") != content_hash(content):
        raise DamagedFileError(f"{path} was damaged or changed after it was written: run it again")
    return data


def results_of(data: Mapping[str, Any]) -> Results:
    """The results in a file; tables are computed again from the samples. Parts that the data name are imported.

    Raises:
        ValueError: when the data are no results, or a policy or scenario was an object of another process.
    """
    try:
        samples: dict[Place, Samples] = {}
        for kind in ("samples", "timings"):
            for track, found in data[kind].items():
                for policy, metrics in found.items():
                    count, known = data["episodes"][track]["count"], samples.setdefault((track, policy), {})
                    for metric, values in metrics.items():
                        array = np.array(values, dtype=np.float64)
                        known[metric] = np.repeat(array, count, axis=1) if kind == "timings" else array
        return Results(
            data["name"],
            data["suite"],
            tuple(Track.from_dict(track) for track in data["tracks"]),
            {policy["name"]: PolicySpec.from_dict(policy) for policy in data["policies"]},
            {name: _episode_set(chosen) for name, chosen in data["episodes"].items()},
            samples,
            {(item["track"], item["policy"]): item["reason"] for item in data["not_applicable"]},
            {(item["track"], item["policy"]): item["reason"] for item in data["failures"]},
        )
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"not results: {type(error).__name__}: {error}") from error


def _episode_set(data: Mapping[str, Any]) -> EpisodeSet:
    return EpisodeSet(**{**data, "track": data["track"] and tuple(data["track"])})
