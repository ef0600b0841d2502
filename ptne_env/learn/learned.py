"""Learned policies in ONNX files, which are read as data: no file executes code, and no file is large.

onnxruntime runs the networks, without torch.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptne_env.learn.blocks import in_blocks
from ptne_env.learn.metadata import Metadata, PolicyFileError
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.shared.files import require_file
from ptne_env.shared.names import unknown_name

if TYPE_CHECKING:
    import onnx

_FOLDER = Path(__file__).parent
_METADATA, _DIGEST, _UNKNOWN = "ptne_env", "sha256", "0" * 64

LARGEST_FILE = 16 << 20
"""Bytes of the largest file that is read; the shipped ones have 0.1 MB."""

LARGEST_VALUE = 1 << 20
"""Numbers in the largest array that a network may compute for a row."""

MOST_NODES = 1000
"""Operations in the largest network."""

OPERATORS = frozenset(
    "Abs Add Cast Clip Concat Constant Div Elu Exp Flatten Gather Gemm Identity LayerNormalization LeakyRelu MatMul Max "
    "Mean Min Mul Neg Pow ReduceMax ReduceMean ReduceSum Relu Reshape Selu Sigmoid Slice Softmax Softplus Split Sqrt "
    "Squeeze Sub Sum Tanh Transpose Unsqueeze".split()
)
"""The operations of a network: arithmetic, without loops, branches, other files, and arrays out of nothing."""


class LearnedPolicy:
    """A feed-forward policy, acting by its mean action; see :class:`ptne_env.perception.policy.Policy`.

    :func:`load` makes one.

    Attributes:
        name: of the file, without its ending.
        metadata: description in the file.
        interface: of the policy.
        observation_size: length of an observation.
    """

    def __init__(self, name: str, session: Any, metadata: Metadata) -> None:
        self.name = name
        self.metadata = metadata
        self.interface = metadata.interface
        self._session = session
        self._input, (_, self.observation_size) = session.get_inputs()[0].name, session.get_inputs()[0].shape

    def require(self, layout: ObservationLayout) -> None:
        """Check that the policy can act in an environment of this layout; see :meth:`Metadata.require`."""
        self.metadata.require(layout)

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,  # noqa: ARG002 - Stable-Baselines3's signature
        deterministic: bool = False,  # noqa: ARG002, FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[Float32Array, Any]:
        """The mean actions, clipped to the action box; see :meth:`ptne_env.perception.policy.Policy.predict`.

        Raises:
            PolicyFileError: when observations have another length than the policy was made for.
        """
        rows = np.atleast_2d(np.asarray(observation, dtype=np.float32))
        size = self.observation_size
        if rows.ndim != 2 or rows.shape[1] != size:
            raise PolicyFileError(f"policy {self.name!r} takes observations of length {size}, got {rows.shape}")
        actions = self._session.run(None, {self._input: in_blocks(rows)})[0]
        return (actions[0] if np.ndim(observation) == 1 else actions[: len(rows)]), state


def shipped() -> list[str]:
    """The names of the policies in the library."""
    return sorted(path.stem for path in _FOLDER.glob("*.onnx"))


def shipped_path(name: str) -> Path | None:
    """The file of a policy in the library; ``None`` for another name."""
    return _FOLDER / f"{name}.onnx" if name in shipped() else None


def sealed(model: onnx.ModelProto, metadata: Metadata) -> bytes:
    """The content of a policy file: a network from observations (R, size) to actions, float32, and its description.

    The SHA-256 of the content is in it, so that :func:`load` detects damage.
    """
    from onnx import helper

    helper.set_model_props(model, {_METADATA: metadata.to_json(), _DIGEST: _UNKNOWN})
    content: bytes = model.SerializeToString()
    return content.replace(_UNKNOWN.encode(), hashlib.sha256(content).hexdigest().encode())


def load(path_or_name: str | Path, layout: ObservationLayout | None = None) -> LearnedPolicy:
    """A learned policy from an ``.onnx`` file, or a shipped policy by name.

    Args:
        path_or_name: the file or name.
        layout: of the environment in which the policy must be able to act; not checked if left out.

    Raises:
        ValueError: for an unknown name.
        FileNotFoundError: when there is no such file.
        PolicyFileError: when the file is damaged, foreign, too large or of another version, refers to other files, has
            other operations than :data:`OPERATORS`, or was made for another layout.
        ImportError: without onnx and onnxruntime, naming the extra to install.
    """
    if not all(map(importlib.util.find_spec, ("onnx", "onnxruntime"))):
        raise ImportError('learned policies need onnx and onnxruntime: pip install "ptne-env[bench]"')
    path = Path(path_or_name)
    if path.suffix != ".onnx":
        path = _FOLDER / f"{path_or_name}.onnx"
        if not path.is_file():
            raise ValueError(unknown_name("learned policy", str(path_or_name), shipped(), "an .onnx file"))
    require_file(path)
    policy = _read(path)
    if layout is not None:
        policy.require(layout)
    return policy


def _read(path: Path) -> LearnedPolicy:
    """The policy in a file, after a trial with one row."""
    import onnx

    if path.stat().st_size > LARGEST_FILE:
        raise PolicyFileError(f"{path} has more than {LARGEST_FILE >> 20} MiB")
    content = path.read_bytes()
    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # of protobuf
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else") from error
    properties = {each.key: each.value for each in model.metadata_props}
    if not {_METADATA, _DIGEST} <= properties.keys():
        raise PolicyFileError(f"{path} is damaged, or an ONNX file without the metadata of a ptne_env policy")
    digest = properties[_DIGEST].encode()
    if hashlib.sha256(content.replace(digest, _UNKNOWN.encode())).hexdigest().encode() != digest:
        raise PolicyFileError(f"{path} is damaged: its content has another SHA-256 than it says")
    metadata = Metadata.from_json(properties[_METADATA])
    if reason := _refusal(model):
        raise PolicyFileError(f"{path} {reason}")
    try:
        policy = LearnedPolicy(path.stem, _open(content), metadata)
        actions, _ = policy.predict(np.zeros((1, policy.observation_size), dtype=np.float32))
    except Exception as error:  # onnxruntime raises its own classes, which are not public
        raise PolicyFileError(f"{path} cannot decide a batch of any number of rows of observations: {error}") from error
    if getattr(actions, "dtype", None) != np.float32 or actions.shape != (1, metadata.action_size):
        raise PolicyFileError(f"{path} does not answer with actions of {metadata.action_size} float32 numbers")
    return policy


def _refusal(model: onnx.ModelProto) -> str | None:
    """Why a network is not run; ``None`` for one that takes little memory, and reads no other file."""
    import onnx

    graph = model.graph
    tensors = [*graph.initializer, *(each.t for node in graph.node for each in node.attribute)]
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in tensors):
        return "refers to other files"
    if others := {f"{node.domain}.{node.op_type}".strip(".") for node in graph.node} - OPERATORS:
        return f"has operations that are not allowed: {', '.join(sorted(others))}"
    if len(graph.node) > MOST_NODES or model.functions or graph.sparse_initializer:
        return f"has more than {MOST_NODES} operations, functions or sparse arrays"
    try:
        graph = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True).graph
    except Exception as error:  # noqa: BLE001 - of onnx
        return f"is no valid network: {error}"
    shapes = {each.name: each.type.tensor_type.shape.dim for each in (*graph.input, *graph.value_info, *graph.output)}
    for name in [each.name for each in graph.input] + [name for node in graph.node for name in node.output]:
        if name not in shapes or math.prod(max(dim.dim_value, 1) for dim in shapes[name]) > LARGEST_VALUE:
            return f"computes an array of unknown size, or of more than {LARGEST_VALUE} numbers, {name!r}"
    return None


def _open(content: bytes) -> Any:
    """The ``onnxruntime.InferenceSession`` of a file's content, on one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # the networks are small, and one thread gives the same bits in every run
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)
