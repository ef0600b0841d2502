"""The description of a policy inside its file, and the errors of files that cannot act."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.shared.arrays import require_count, require_finite, require_printable
from ptne_env.shared.files import DamagedFileError

LAYOUT_VERSION = 1
"""Version of the meaning of observations and actions; files of another version are refused."""


class PolicyFileError(DamagedFileError):
    """A file is not a policy of this library, is damaged, or was made for other observations."""


class PolicyLayoutError(PolicyFileError, LayoutError):
    """A policy file was made for another layout."""


@dataclass(frozen=True, kw_only=True)
class Metadata:
    """The description of a policy that maps flat observations of one layout to actions.

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

    Raises:
        ValueError, TypeError: for a value of a wrong type or out of range.
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
        """The description as a JSON text."""
        return json.dumps(
            dataclasses.asdict(self) | {"interface": self.interface.kind}, allow_nan=False, sort_keys=True
        )

    @classmethod
    def from_json(cls, text: str) -> Metadata:
        """The inverse of :meth:`to_json`.

        Raises:
            PolicyFileError: when the text is damaged or of another layout version.
        """
        try:
            data: dict[str, Any] = json.loads(text)
            data["interface"] = Interface(data["interface"])
            arguments: dict[str, Any] = {
                name: tuple(value) if isinstance(value, list) else value for name, value in data.items()
            }
            metadata = cls(**arguments)
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise PolicyFileError(f"the policy's metadata is damaged or of a later version: {error!r}") from error
        metadata.require_version()
        return metadata

    def __post_init__(self) -> None:
        for name in ("slots", "steps", "seed", "layout_version"):
            require_count(name, getattr(self, name), 0)
        for dim in self.action_dims:
            require_count("action_dims", dim, 1)
        require_finite("digits", self.digits)
        for name, version in self.versions.items():
            require_printable("a library's name", name)
            require_printable("a library's version", version)
        for scenario in self.scenarios:
            require_printable("a scenario's name", scenario)

    def require_version(self) -> None:
        """Check that this version of the library can let the policy decide.

        Raises:
            PolicyFileError: naming the differences.
        """
        if self.layout_version != LAYOUT_VERSION:
            raise PolicyFileError(
                f"the policy was made for layout version {self.layout_version}, this library has {LAYOUT_VERSION}; "
                "use the version of ptne_env that made it, or train it again"
            )

    def _needs(self, layout: ObservationLayout) -> dict[str, tuple[Any, Any]]:
        """What policy and environment must have in common: its name, that of the policy, and that of the layout."""
        return {
            "interface": (self.interface.kind, layout.interface.kind),
            "action_dims": (self.action_dims, layout.action_dims),
            "neighbour slots": (self.slots, layout.slots),
        }

    def require(self, layout: ObservationLayout) -> None:
        """Check that the policy can act in an environment of this layout.

        Raises:
            PolicyLayoutError: naming the differences.
        """
        differences = [
            f"{name}: policy {mine}, environment {theirs}"
            for name, (mine, theirs) in self._needs(layout).items()
            if mine != theirs
        ]
        if differences:
            raise PolicyLayoutError(f"the policy was made for another layout; {'; '.join(differences)}")

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return sum(self.action_dims)
