"""Networks in ``.npz`` files, run by numpy: arrays and a description, of which none executes code."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from ptne_env.learn.layers import LayeredPolicy, Metadata, Weights
from ptne_env.learn.recurrent import RecurrentPolicy
from ptne_env.perception.policy import PolicyFileError

LARGEST_UNPACKED = 16 << 20
"""The largest number of bytes to which a file may unpack; the shipped ones have 30 to 280 kB."""

_DESCRIPTION, _VERSION = "metadata", 6
"""The name of the description, and the version of files and of the meaning of observations and actions in them."""


def seal(weights: Weights, training: Mapping[str, Any] | Metadata) -> bytes:
    """Return the content of a policy file: the weights, and a description with their SHA-256.

    Args:
        weights: those of a :class:`RecurrentPolicy`, or of a :class:`LayeredPolicy`.
        training: how a recurrent policy was trained; for a layered one, also where it can act.

    Raises:
        ValueError: when a weight is not finite.
    """
    _require(_are_finite(weights), "a weight is not finite: the training diverged; try a smaller learning_rate")
    arrays = {name: np.asarray(weights[name], dtype=np.float32) for name in sorted(weights)}
    described = training.to_dict() if isinstance(training, Metadata) else dict(training)
    kind = "layered" if isinstance(training, Metadata) else "training"
    description = {"version": _VERSION, "sha256": _compute_digest(arrays, described), kind: described}
    arrays[_DESCRIPTION] = np.frombuffer(json.dumps(description).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # its stubs want allow_pickle among them
    return buffer.getvalue()


def open_policy(path: Path, content: bytes) -> RecurrentPolicy | LayeredPolicy:
    """Check the content of an ``.npz`` file, its size before anything is unpacked, and return its policy.

    Raises:
        PolicyFileError: when the content is damaged, foreign, too large or of another version.
    """
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        _require(size <= LARGEST_UNPACKED, f"it unpacks to more than {LARGEST_UNPACKED >> 20} MiB")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            weights = {name: file[name] for name in file.files}
        description = json.loads(weights.pop(_DESCRIPTION).tobytes())
        made_by = description["version"]
        advice = "use the version of ptne_env that made it, or train it again"
        _require(made_by == _VERSION, f"it is of version {made_by}, and {_VERSION} is expected: {advice}")
        _require(all(each.dtype == np.float32 for each in weights.values()), "its weights are not float32")
        is_layered = "layered" in description
        described = description["layered" if is_layered else "training"]
        _require(_compute_digest(weights, described) == description["sha256"], "it has another SHA-256")
        _require(_are_finite(weights), "a weight is not finite")
        if is_layered:
            return LayeredPolicy(path.stem, weights, Metadata.from_dict(described))
        return RecurrentPolicy(path.stem, weights, None, described)
    except Exception as error:  # zip files raise many classes
        raise PolicyFileError(f"{path} is damaged, or no policy of this library: {error}") from error


def _are_finite(weights: Weights) -> bool:
    return all(np.isfinite(each).all() for each in weights.values())


def _require(holds: bool, otherwise: str) -> None:  # noqa: FBT001 - private
    if not holds:
        raise ValueError(otherwise)


def _compute_digest(weights: Weights, described: Any) -> str:
    text = json.dumps(described, sort_keys=True).encode()
    return sha256(b"".join([text, *(weights[name].tobytes() for name in sorted(weights))])).hexdigest()
