"""Loading a learned policy. An ONNX file is data: loading one cannot execute code."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any, ClassVar, overload

import numpy as np
import numpy.typing as npt

from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn import probe
from ptne_env.learn.blocks import BLOCK, in_blocks
from ptne_env.learn.metadata import Description, Metadata, PolicyFileError, SizeFreeMetadata
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES, SizeFreePolicy
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.shared.files import require_file
from ptne_env.shared.names import unknown_name

_METADATA_KEY = "ptne_env"
_FOLDER = Path(__file__).parent

SIZE_FREE_INPUTS = ("cell", "slot")
"""Names of the inputs of the network of a policy without sizes: features of components, and of messages."""


class LearnedPolicy:
    """A feed-forward policy, acting by its mean action; see :class:`ptne_env.perception.policy.Policy`.

    :func:`load` makes one.

    Attributes:
        name: of the file, without its ending.
        metadata: description in the file.
        interface: of the policy.
        observation_size: length of an observation.
    """

    has_memory: ClassVar[bool] = False

    def __init__(self, name: str, session: Any, metadata: Metadata) -> None:
        self.name = name
        self.metadata = metadata
        self.interface = metadata.interface
        self._session = session
        self._input, (_, self.observation_size) = session.get_inputs()[0].name, session.get_inputs()[0].shape

    def require(self, layout: ObservationLayout) -> None:
        """Check that the policy can act in an environment of this layout; see :meth:`Description.require`."""
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


class SizeFreeFile:
    """A policy without sizes in a file: called with a layout, it gives the policy for it.

    :func:`load` makes one.

    Attributes:
        name: of the file, without its ending.
        metadata: description in the file.
        interface: of the policy.
        guarded: whether its players have a safeguard, see :class:`~ptne_env.learn.size_free.SizeFreePolicy`.
    """

    has_memory: ClassVar[bool] = True

    def __init__(self, name: str, session: Any, metadata: SizeFreeMetadata, *, guarded: bool = False) -> None:
        self.name = name
        self.metadata = metadata
        self.interface = metadata.interface
        self.guarded = guarded
        self._session = session

    def __call__(self, layout: ObservationLayout) -> SizeFreePolicy:
        """The policy for a layout.

        Raises:
            PolicyLayoutError: when the interface of the layout is not that of the policy.
        """
        self.metadata.require(layout)
        return SizeFreePolicy(layout, self.network, guarded=self.guarded)

    def network(self, cell: Float32Array, slot: Float32Array) -> tuple[Float32Array, Float32Array]:
        """The gates; see :data:`ptne_env.learn.size_free.Network`."""
        mine, theirs = self._session.run(None, dict(zip(SIZE_FREE_INPUTS, (cell, slot), strict=True)))
        return mine, theirs


def shipped() -> list[str]:
    """The names of the policies in the library."""
    return sorted(path.stem for path in _FOLDER.glob("*.onnx"))


def shipped_path(name: str) -> Path | None:
    """The file of a policy in the library; ``None`` for another name."""
    return _FOLDER / f"{name}.onnx" if name in shipped() else None


@overload
def load(path_or_name: str | Path, layout: None = None, *, guarded: bool = False) -> LearnedPolicy | SizeFreeFile: ...


@overload
def load(
    path_or_name: str | Path, layout: ObservationLayout, *, guarded: bool = False
) -> LearnedPolicy | SizeFreePolicy: ...


def load(
    path_or_name: str | Path, layout: ObservationLayout | None = None, *, guarded: bool = False
) -> LearnedPolicy | SizeFreeFile | SizeFreePolicy:
    """A learned policy from an ``.onnx`` file, or a shipped policy by name.

    The first time, a file that is not shipped is loaded in a process with limited time and memory
    (:mod:`ptne_env.learn.probe`), and in this process only if that worked.

    Args:
        path_or_name: the file or name.
        layout: of the environment in which the policy must be able to act; not checked if left out.
        guarded: whether the players of a policy without sizes hand over to ``observer-relay`` where it leads them
            astray, see :mod:`ptne_env.learn.safeguard`.

    Returns:
        The policy. A policy without sizes needs a layout: where that is left out, it is built when the result is called
        with one.

    Raises:
        ValueError: for an unknown name, and when a policy with sizes is to be guarded.
        FileNotFoundError: when there is no such file.
        PolicyFileError: when the file is damaged, foreign or of another version, refers to other files, takes too much
            time or memory, or was made for another layout.
        ImportError: without onnxruntime, naming the extra to install.
    """
    if importlib.util.find_spec("onnxruntime") is None:
        raise ImportError('learned policies need onnxruntime: pip install "ptne-env[bench]"')
    path = Path(path_or_name)
    if path.suffix != ".onnx":
        path = _FOLDER / f"{path_or_name}.onnx"
        if not path.is_file():
            raise ValueError(unknown_name("learned policy", str(path_or_name), shipped(), "an .onnx file"))
    require_file(path)
    policy = _read(path)
    if guarded:
        if not isinstance(policy, SizeFreeFile):
            raise ValueError(f"policy {str(path_or_name)!r} has sizes: only policies without sizes have a safeguard")
        policy.guarded = True
    if layout is None:
        return policy
    if isinstance(policy, SizeFreeFile):
        return policy(layout)
    policy.require(layout)
    return policy


def _read(path: Path) -> LearnedPolicy | SizeFreeFile:
    """The policy in a file; see :func:`load`."""
    content = path.read_bytes()
    reason = None if path.parent == _FOLDER else probe.refusal(content, BLOCK)
    if reason is not None:
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else ({reason})")
    try:
        session = probe.open_session(content)
        text = session.get_modelmeta().custom_metadata_map.get(_METADATA_KEY)
    except Exception as error:  # onnxruntime raises its own classes, which are not public
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else") from error
    if text is None:
        raise PolicyFileError(f"{path} is an ONNX file without the metadata of a ptne_env policy")
    metadata = Description.from_json(text)
    if isinstance(metadata, Metadata):
        return _flat(path, session, metadata)
    return _size_free(path, session, metadata)


def _flat(path: Path, session: Any, metadata: Metadata) -> LearnedPolicy:
    """A policy that maps observations to actions, after a trial with one row."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1 or len(outputs) != 1 or len(inputs[0].shape) != 2:
        raise PolicyFileError(f"{path} does not map one batch of observations to one batch of actions")
    policy = LearnedPolicy(path.stem, session, metadata)
    try:
        actions, _ = policy.predict(np.zeros((1, inputs[0].shape[1]), dtype=np.float32))
    except Exception as error:
        raise PolicyFileError(f"{path} cannot decide a batch of any number of rows of observations") from error
    if getattr(actions, "dtype", None) != np.float32 or actions.shape != (1, metadata.action_size):
        raise PolicyFileError(f"{path} does not answer with actions of {metadata.action_size} float32 numbers")
    return policy


def _size_free(path: Path, session: Any, metadata: SizeFreeMetadata) -> SizeFreeFile:
    """A policy without sizes, after trials with two numbers of cells and slots."""
    policy = SizeFreeFile(path.stem, session, metadata)
    for cells, slots in ((BLOCK, 1), (2 * BLOCK, 3)):
        shapes = ((cells, len(CELL_FEATURES)), (cells, slots, len(SLOT_FEATURES)))
        try:
            answers = policy.network(*(np.zeros(shape, dtype=np.float32) for shape in shapes))
        except Exception as error:
            raise PolicyFileError(
                f"{path} cannot decide from features {' and '.join(SIZE_FREE_INPUTS)} of shapes {shapes}: {error}"
            ) from error
        expected = ((cells, len(CellGates._fields)), (cells, slots, len(SlotGates._fields)))
        found = tuple((getattr(answer, "dtype", None), np.shape(answer)) for answer in answers)
        if found != tuple((np.float32, shape) for shape in expected):
            raise PolicyFileError(f"{path} answers with gates {found}, expected float32 arrays of shapes {expected}")
    return policy
