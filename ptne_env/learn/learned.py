"""Learned policies in ONNX files, read as data, without torch: no file executes code, and no network is large."""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.perception.policy import BLOCK, RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array, require_count
from ptne_env.shared.files import DamagedFileError, require_file
from ptne_env.shared.names import unknown_name

if TYPE_CHECKING:
    import onnx

    from ptne_env.learn.recurrent import RecurrentPolicy

_FOLDER = Path(__file__).parent
_METADATA, _DIGEST, _UNKNOWN = "ptne_env", "sha256", "0" * 64

SUFFIXES = (".onnx", ".npz")
"""Endings of policy files: networks without memory, and recurrent ones."""

LARGEST_FILE = 16 << 20
"""Bytes of the largest file that is read; the shipped ones have 30 kB."""

LARGEST_ARRAY, MOST_OPERATIONS = 1 << 20, 1000
"""Numbers in the largest array that a network may compute for a row, and its operations."""

OPERATORS = {
    "Add", "Cast", "Clip", "Concat", "Constant", "Div", "Elu", "Flatten", "Gather", "Gemm", "Identity", "LeakyRelu",
    "MatMul", "Max", "Min", "Mul", "Relu", "Reshape", "Selu", "Sigmoid", "Slice", "Softplus", "Squeeze", "Sub", "Tanh",
    "Unsqueeze",
}  # fmt: skip
"""The operations of a network: arithmetic, without loops, branches, other files, and arrays out of nothing."""

LAYOUT_VERSION = 1
"""Version of the meaning of observations and actions; files of another version are refused."""


class PolicyFileError(DamagedFileError):
    """A file is not a policy of this library, is damaged, or was made for other observations."""


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """The description of a policy.

    Attributes:
        interface: of the policy.
        action_dims: n_i of each player it was trained with.
        slots: D, neighbour slots per player.
        training: how it was trained, such as scenario, agent-steps, seed and versions; nothing depends on it.
        layout_version: version of the meaning of observations and actions.

    Raises:
        ValueError, TypeError: for a value of a wrong type or out of range.
    """

    interface: Interface
    action_dims: tuple[int, ...]
    slots: int
    training: Mapping[str, Any]
    layout_version: int = LAYOUT_VERSION

    def __post_init__(self) -> None:
        require_count("slots", self.slots, 0)
        require_count("layout_version", self.layout_version, 0)
        for dim in self.action_dims:
            require_count("action_dims", dim, 1)

    def to_json(self) -> str:
        """The description as a JSON text."""
        return json.dumps(asdict(self) | {"interface": self.interface.kind}, allow_nan=False, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Metadata:
        """The inverse of :meth:`to_json`.

        Raises:
            PolicyFileError: when the text is damaged or of another layout version.
        """
        try:
            data: dict[str, Any] = json.loads(text)
            data |= {"interface": Interface(data["interface"]), "action_dims": tuple(data["action_dims"])}
            metadata = cls(**data)
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise PolicyFileError(f"the policy's metadata is damaged or of another version: {error!r}") from error
        if metadata.layout_version != LAYOUT_VERSION:
            raise PolicyFileError(
                f"the policy was made for layout version {metadata.layout_version}, this library has {LAYOUT_VERSION}; "
                "use the version of ptne_env that made it, or train it again"
            )
        return metadata


class LearnedPolicy(RowPolicy):
    """A policy from a file; see :class:`ptne_env.perception.policy.Policy`.

    :func:`load` and :func:`ptne_env.learn.archive.load_archive` make one.

    Attributes:
        name: of the file, without its ending.
        interface: of the policy.
        metadata: description in the file; ``None`` of an archive, which has none.
    """

    block = BLOCK

    def __init__(
        self,
        name: str,
        made_for: Mapping[str, Any],
        decide: Callable[..., tuple[Float32Array, Any]],
        metadata: Metadata | None = None,
    ) -> None:
        self.name = name
        self.interface: Interface = made_for["interface"]
        self.metadata = metadata
        self._made_for = made_for  # attributes of a layout, among them its size
        self._decide = decide  # as predict, for whole blocks

    @property
    def made_for(self) -> Mapping[str, Any]:
        """The size of the observations, the interface, and what else the file says of its layout."""
        return self._made_for

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:
        """Return the actions and the memory; see :meth:`ptne_env.perception.policy.RowPolicy.decide`."""
        return self._decide(rows, memory, starts, deterministic)


def shipped() -> list[str]:
    """The names of the policies in the library."""
    return sorted(path.stem for ending in SUFFIXES for path in _FOLDER.glob(f"*{ending}"))


def shipped_path(name: str) -> Path:
    """The file of a policy in the library.

    Raises:
        ValueError: for another name.
    """
    if name not in shipped():
        raise ValueError(unknown_name("learned policy", name, shipped(), "an .onnx or .npz file"))
    return next(path for ending in SUFFIXES if (path := _FOLDER / f"{name}{ending}").exists())


def sealed(model: onnx.ModelProto, metadata: Metadata) -> bytes:
    """The content of a policy file: a network from observations (R, size) to actions, float32, and its description.

    Its SHA-256 is in it, so that :func:`load` detects damage.
    """
    from onnx import helper

    helper.set_model_props(model, {_METADATA: metadata.to_json(), _DIGEST: _UNKNOWN})
    content: bytes = model.SerializeToString()
    return content.replace(_UNKNOWN.encode(), sha256(content).hexdigest().encode())


def load(path_or_name: str | Path, layout: ObservationLayout | None = None) -> LearnedPolicy | RecurrentPolicy:
    """A learned policy from an ``.onnx`` or ``.npz`` file, or a shipped policy by name.

    Args:
        path_or_name: the file or name.
        layout: of the environment in which the policy must be able to act; not checked if left out. The policy of an
            ``.npz`` file needs it before it acts.

    Raises:
        ValueError: for an unknown name.
        FileNotFoundError: when there is no such file.
        PolicyFileError: when the file is damaged, foreign, too large or of another version, refers to other files,
            or has other operations than :data:`OPERATORS`.
        LayoutError: when the policy was made for another layout.
        ImportError: without onnx and onnxruntime, which ``.onnx`` files need, naming the extra to install.
    """
    is_file = Path(path_or_name).suffix in SUFFIXES
    path = Path(path_or_name) if is_file else shipped_path(str(path_or_name))
    if path.suffix == ".onnx" and not all(map(importlib.util.find_spec, ("onnx", "onnxruntime"))):
        raise ImportError('learned policies need onnx and onnxruntime: pip install "ptne-env[bench]"')
    require_file(path)
    if path.stat().st_size > LARGEST_FILE:
        raise PolicyFileError(f"{path} has more than {LARGEST_FILE >> 20} MiB")
    from ptne_env.learn import recurrent  # which needs the errors of this module

    opened = _opened if path.suffix == ".onnx" else recurrent.opened
    policy: LearnedPolicy | RecurrentPolicy = opened(path, path.read_bytes())
    return policy if layout is None else policy.with_layout(layout)


def _opened(path: Path, content: bytes) -> LearnedPolicy:
    """The policy in a file, checked and tried with one row."""
    import onnx
    import onnxruntime

    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # of protobuf
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else") from error
    properties = {each.key: each.value for each in model.metadata_props}
    if not {_METADATA, _DIGEST} <= properties.keys():
        raise PolicyFileError(f"{path} is damaged, or an ONNX file without the metadata of a ptne_env policy")
    digest = properties[_DIGEST]
    if sha256(content.replace(digest.encode(), _UNKNOWN.encode())).hexdigest() != digest:
        raise PolicyFileError(f"{path} is damaged: it does not have the SHA-256 that it names")
    metadata = Metadata.from_json(properties[_METADATA])
    if reason := _refusal(model):
        raise PolicyFileError(f"{path} {reason}")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # the networks are small, and one thread gives the same bits in every run
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)
        (taken,) = session.get_inputs()
        (actions,) = session.run(None, {taken.name: np.zeros((BLOCK, taken.shape[1]), dtype=np.float32)})
    except Exception as error:  # onnxruntime raises its own classes, which are not public
        raise PolicyFileError(f"{path} cannot decide a batch of any number of rows of observations: {error}") from error
    if actions.dtype != np.float32 or actions.shape != (BLOCK, sum(metadata.action_dims)):
        raise PolicyFileError(f"{path} does not answer with actions of {sum(metadata.action_dims)} float32 numbers")

    def decide(rows: Float32Array, state: Any, *_: Any) -> tuple[Float32Array, Any]:
        return session.run(None, {taken.name: rows})[0], state

    made_for = {name: getattr(metadata, name) for name in ("interface", "action_dims", "slots")}
    return LearnedPolicy(path.stem, made_for | {"size": taken.shape[1]}, decide, metadata)


def _refusal(model: onnx.ModelProto) -> str | None:
    """Why a network is not run; ``None`` for one that takes little memory, and reads no other file."""
    import onnx

    graph = model.graph
    tensors = [*graph.initializer, *(each.t for node in graph.node for each in node.attribute)]
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in tensors):
        return "refers to other files"
    if others := {f"{node.domain}.{node.op_type}".strip(".") for node in graph.node} - OPERATORS:
        return f"has operations that are not allowed: {', '.join(sorted(others))}"
    if len(graph.node) > MOST_OPERATIONS or model.functions or graph.sparse_initializer:
        return f"has more than {MOST_OPERATIONS} operations, functions or sparse arrays"
    try:
        graph = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True).graph
    except Exception as error:  # noqa: BLE001 - of onnx
        return f"is no valid network: {error}"
    values = (*graph.input, *graph.value_info, *graph.output)
    shapes = {each.name: [max(dim.dim_value, 1) for dim in each.type.tensor_type.shape.dim] for each in values}
    for name in [each.name for each in graph.input] + [name for node in graph.node for name in node.output]:
        if math.prod(shapes.get(name, [LARGEST_ARRAY + 1])) > LARGEST_ARRAY:
            return f"computes an array of unknown size or of more than {LARGEST_ARRAY} numbers, {name!r}"
    return None
