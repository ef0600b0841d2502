"""Loading a learned policy. An ONNX file is data: loading one cannot execute code."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, Float32Array, require_count, require_finite, require_printable
from ptne_env.observation import Interface, LayoutError, ObservationLayout
from ptne_env.policies import probe
from ptne_env.policies.blocks import BLOCK, in_blocks

LAYOUT_VERSION = 1
"""Version of the meaning of observations and actions; :func:`load` refuses files of another version."""

_METADATA_KEY = "ptne_env"
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
            metadata._check()
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise PolicyFileError(f"the policy's metadata is damaged or of a later version: {error!r}") from error
        if metadata.layout_version != LAYOUT_VERSION:
            raise PolicyFileError(
                f"the policy was made for layout version {metadata.layout_version}, this library has {LAYOUT_VERSION}; "
                "use the version of ptne_env that made it, or train it again"
            )
        return metadata

    def _check(self) -> None:
        """Raise ``ValueError`` or ``TypeError`` for a value of a wrong type or out of range."""
        seen = self.interface
        if not all(isinstance(flag, bool) for flag in (seen.own_payoff, seen.neighbour_errors, seen.best_response)):
            raise TypeError(f"the flags of an interface are true or false, got {seen}")
        for dim in self.action_dims:
            require_count("action_dims", dim, 1)
        for name in ("slots", "steps", "seed", "layout_version"):
            require_count(name, getattr(self, name), 0)
        require_finite("digits", self.digits)
        for name, version in self.versions.items():
            require_printable("a library's name", name)
            require_printable("a library's version", version)
        for scenario in self.scenarios:
            require_printable("a scenario's name", scenario)

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return sum(self.action_dims) if self.interface.action_mode == "input" else 2

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
        """The mean actions, clipped to the action box; see :meth:`ptne_env.policy.Policy.predict`.

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


def load(path_or_name: str | Path, layout: ObservationLayout | None = None) -> LearnedPolicy:
    """A learned policy from an ``.onnx`` file, or a shipped policy by name.

    The first time, a file that is not shipped is loaded in a process with limited time and memory
    (:mod:`ptne_env.policies.probe`), and in this process only if that worked.

    Args:
        path_or_name: the file or name.
        layout: of the environment in which the policy must be able to act; not checked if left out.

    Raises:
        FileNotFoundError: when there is no such file, naming the shipped policies.
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
        names = ", ".join(shipped()) or "none"
        raise FileNotFoundError(f"no policy {str(path_or_name)!r}: name an .onnx file or a shipped policy ({names})")
    policy = _read(path)
    if layout is not None:
        policy.require(layout)
    return policy


def _read(path: Path) -> LearnedPolicy:
    """The policy in a file; see :func:`load`."""
    content = path.read_bytes()
    reason = None if path.parent == _FOLDER else probe.refusal(content, BLOCK)
    if reason is not None:
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else ({reason})")
    try:
        session = probe.open_session(content)
        text = session.get_modelmeta().custom_metadata_map.get(_METADATA_KEY)
        inputs, outputs = session.get_inputs(), session.get_outputs()
    except Exception as error:  # onnxruntime raises its own classes, which are not public
        raise PolicyFileError(f"{path} is not a readable ONNX file: it is damaged or something else") from error
    if text is None:
        raise PolicyFileError(f"{path} is an ONNX file without the metadata of a ptne_env policy")
    metadata = Metadata.from_json(text)
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
