"""Loading a learned policy. An ONNX file is data: loading one cannot execute code."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, Float32Array
from ptne_env.observation import Interface, LayoutError, ObservationLayout
from ptne_env.policies.blocks import in_blocks

LAYOUT_VERSION = 1
"""Version of the meaning of observations and actions; :func:`load` refuses files of another version."""

_METADATA_KEY = "ptne_env"
_ELSEWHERE = b"location"
"""The only key by which an ONNX file names other files that hold its weights."""

_FOLDER = Path(__file__).parent


class PolicyFileError(ValueError):
    """A file is not a policy of this library, is damaged, or was made for other observations."""


class PolicyLayoutError(PolicyFileError, LayoutError):
    """A policy file was made for another layout."""


@dataclass(frozen=True)
class Metadata:
    """The description of a policy inside its file.

    Attributes:
        interface: of the policy.
        action_dims: n_i of each player it was trained with.
        slots: D, neighbour slots per player.
        scenarios: names of the scenarios, families of games or tracks (``"ptne-v1/delay"``) it was trained on.
        steps: agent-steps of training.
        seed: of training.
        digits: mean digits on the validation episodes after training.
        versions: of the libraries that wrote it.
        layout_version: version of the meaning of observations and actions.
    """

    interface: Interface
    action_dims: tuple[int, ...]
    slots: int
    scenarios: tuple[str, ...]
    steps: int
    seed: int
    digits: float
    versions: Mapping[str, str]
    layout_version: int = LAYOUT_VERSION

    def to_json(self) -> str:
        """The metadata as a JSON text."""
        return json.dumps(dataclasses.asdict(self), allow_nan=False, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Metadata:
        """The inverse of :meth:`to_json`.

        Raises:
            PolicyFileError: when the text is damaged or of another layout version.
        """
        try:
            data = json.loads(text)
            interface = Interface(**data.pop("interface"))
            action_dims, scenarios = tuple(data.pop("action_dims")), tuple(data.pop("scenarios"))
            metadata = cls(interface=interface, action_dims=action_dims, scenarios=scenarios, **data)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise PolicyFileError(f"the policy's metadata is damaged or of a later version: {error!r}") from error
        if metadata.layout_version != LAYOUT_VERSION:
            raise PolicyFileError(
                f"the policy was made for layout version {metadata.layout_version}, this library has {LAYOUT_VERSION}; "
                "use the version of ptne_env that made it, or train it again"
            )
        return metadata

    def require(self, layout: ObservationLayout) -> None:
        """Check that the policy can act in an environment of this layout.

        Raises:
            PolicyLayoutError: naming the differences.
        """
        mine = {"interface": self.interface, "action_dims": self.action_dims, "neighbour slots": self.slots}
        theirs = {
            "interface": layout.interface,
            "action_dims": layout.action_dims,
            "neighbour slots": layout.slots,
        }
        differences = [
            f"{name}: policy {mine[name]}, environment {theirs[name]}" for name in mine if mine[name] != theirs[name]
        ]
        if differences:
            raise PolicyLayoutError(f"the policy was made for another layout; {'; '.join(differences)}")


class LearnedPolicy:
    """A feed-forward policy, acting by its mean action; see :class:`ptne_env.policy.Policy`.

    :func:`load` makes one.

    Attributes:
        name: of the file, without its ending.
        metadata: description in the file.
        interface: of the policy.
    """

    def __init__(self, name: str, session: Any, metadata: Metadata) -> None:
        self.name = name
        self.metadata = metadata
        self.interface = metadata.interface
        self._session = session
        self._input = session.get_inputs()[0].name

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
        """The mean actions, clipped to the action box; see :meth:`ptne_env.policy.Policy.predict`.

        Raises:
            PolicyFileError: when observations have another length than the policy was made for.
        """
        rows = np.atleast_2d(np.asarray(observation, dtype=np.float32))
        expected = self._session.get_inputs()[0].shape[1]
        if rows.ndim != 2 or rows.shape[1] != expected:
            raise PolicyFileError(f"policy {self.name!r} takes observations of length {expected}, got {rows.shape}")
        (actions,) = self._session.run(None, {self._input: in_blocks(rows)})
        return (actions[0] if np.ndim(observation) == 1 else actions[: len(rows)]), state


def shipped() -> list[str]:
    """The names of the policies in the library."""
    return sorted(path.stem for path in _FOLDER.glob("*.onnx"))


def shipped_path(name: str) -> Path | None:
    """The file of a policy in the library; ``None`` for another name."""
    return _FOLDER / f"{name}.onnx" if name in shipped() else None


def load(path_or_name: str | Path, layout: ObservationLayout | None = None) -> LearnedPolicy:
    """A learned policy from an ``.onnx`` file, or a shipped policy by name.

    Args:
        path_or_name: the file or name.
        layout: of the environment in which the policy must be able to act; not checked if left out.

    Raises:
        FileNotFoundError: when there is no such file, naming the shipped policies.
        PolicyFileError: when the file is damaged, foreign or of another version, refers to other files, or was made for
            another layout.
        ImportError: without onnxruntime, naming the extra to install.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ImportError('learned policies need onnxruntime: pip install "ptne-env[bench]"') from error
    path = Path(path_or_name)
    if path.suffix != ".onnx":
        path = _FOLDER / f"{path_or_name}.onnx"
    if not path.is_file():
        names = ", ".join(shipped()) or "none"
        raise FileNotFoundError(f"no policy {str(path_or_name)!r}: name an .onnx file or a shipped policy ({names})")
    content = path.read_bytes()
    if _ELSEWHERE in content:
        raise PolicyFileError(f"{path} keeps weights in another file, which a policy of this library never does")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # the networks are small, and one thread gives the same bits everywhere
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises its own classes, which are not public
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else") from error
    text = session.get_modelmeta().custom_metadata_map.get(_METADATA_KEY)
    if text is None:
        raise PolicyFileError(f"{path} is an ONNX file without the metadata of a ptne_env policy")
    metadata = Metadata.from_json(text)
    if len(session.get_inputs()) != 1 or len(session.get_outputs()) != 1 or len(session.get_inputs()[0].shape) != 2:
        raise PolicyFileError(f"{path} does not map one batch of observations to one batch of actions")
    if layout is not None:
        metadata.require(layout)
    return LearnedPolicy(path.stem, session, metadata)
