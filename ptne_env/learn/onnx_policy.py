"""Networks in ONNX files, run by onnxruntime without torch: no file executes code, and no network is large."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.perception.policy import BLOCK, NetworkPolicy, PolicyFileError
from ptne_env.shared.arrays import Float32Array, require_count

if TYPE_CHECKING:
    import onnx

_METADATA, _DIGEST, _UNKNOWN = "ptne_env", "sha256", "0" * 64

LARGEST_ARRAY, MOST_OPERATIONS = 1 << 20, 1000
"""The size of the largest array that a network may compute for a row, and the number of its operations."""

OPERATORS = {
    "Add", "Cast", "Clip", "Concat", "Constant", "Div", "Elu", "Erf", "Flatten", "Gather", "Gelu", "Gemm", "Identity",
    "LeakyRelu", "MatMul", "Max", "Min", "Mul", "Relu", "Reshape", "Selu", "Sigmoid", "Slice", "Softplus", "Squeeze",
    "Sub", "Tanh", "Unsqueeze",
}  # fmt: skip
"""The operations that a network may have: arithmetic, but no loop, branch, other file or array out of nothing."""

LAYOUT_VERSION = 1
"""The version of the meaning of observations and actions; files of another version are refused."""


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """The description of a policy in an ONNX file.

    Attributes:
        interface: the interface of the policy.
        action_dims: n_i of each player with which it was trained.
        slots: D, the number of neighbour slots per player.
        training: how it was trained, such as scenario, agent-steps, seed and versions; nothing depends on it.
        layout_version: the version of the meaning of observations and actions.

    Raises:
        ValueError, TypeError: when a value has a wrong type or is out of range.
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

    @classmethod
    def of(cls, layout: ObservationLayout, training: Mapping[str, Any]) -> Metadata:
        """Describe a policy that was trained with a layout."""
        return cls(interface=layout.interface, action_dims=layout.action_dims, slots=layout.slots, training=training)

    def to_json(self) -> str:
        """Return the description as a JSON text."""
        interface = self.interface.to_dict()
        named = {"interface": interface["kind"] if interface.keys() == {"kind"} else interface}
        return json.dumps(asdict(self) | named, allow_nan=False, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Metadata:
        """Read what :meth:`to_json` wrote.

        Raises:
            PolicyFileError: when the text is damaged or of another layout version.
        """
        try:
            data: dict[str, Any] = json.loads(text)
            interface = data["interface"]
            interface = Interface.from_dict(interface) if isinstance(interface, dict) else Interface(interface)
            data |= {"interface": interface, "action_dims": tuple(data["action_dims"])}
            metadata = cls(**data)
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise PolicyFileError(f"the policy's metadata is damaged or of another version: {error!r}") from error
        if metadata.layout_version != LAYOUT_VERSION:
            raise PolicyFileError(
                f"the policy was made for layout version {metadata.layout_version}, this library has {LAYOUT_VERSION}; "
                "use the version of ptne_env that made it, or train it again"
            )
        return metadata


def seal(model: onnx.ModelProto, metadata: Metadata) -> bytes:
    """Return the content of a policy file: a network from observations (R, size) to actions, and its description.

    The content holds its own SHA-256, so that :func:`open_policy` detects damage.
    """
    from onnx import helper

    helper.set_model_props(model, {_METADATA: metadata.to_json(), _DIGEST: _UNKNOWN})
    content: bytes = model.SerializeToString()
    return content.replace(_UNKNOWN.encode(), sha256(content).hexdigest().encode())


def open_policy(path: Path, content: bytes) -> NetworkPolicy:
    """Check the content of an ``.onnx`` file, and return its policy, which has decided one block of rows.

    Raises:
        PolicyFileError: when the content is damaged, foreign or of another version, or its network is refused.
        ImportError: without onnx and onnxruntime, naming the extra to install.
    """
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise ImportError('learned policies need onnx and onnxruntime: pip install "ptne-env[bench]"') from error

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
    if reason := _why_refused(model):
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

    def decide(rows: Float32Array, memory: Any, *_: Any) -> tuple[Any, Any]:
        return session.run(None, {taken.name: rows})[0], memory

    made_for = {name: getattr(metadata, name) for name in ("interface", "action_dims", "slots")}
    return NetworkPolicy(decide, made_for | {"size": taken.shape[1]}, path.stem, metadata)


def _why_refused(model: onnx.ModelProto) -> str | None:
    """Return why a network is not run; ``None`` for one that takes little memory and reads no other file."""
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
