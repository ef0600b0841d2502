"""The description of a policy inside its file, and the errors of files that cannot act."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.shared.arrays import require_count, require_finite, require_printable
from ptne_env.shared.files import DamagedFileError

LAYOUT_VERSION = 1
"""Version of the meaning of observations and actions; files of another version are refused."""

GATES: tuple[str, ...] = (*CellGates._fields, *SlotGates._fields)
"""Names of the gates that the network of a policy without sizes answers: of a cell, then of a message."""


class PolicyFileError(DamagedFileError):
    """A file is not a policy of this library, is damaged, or was made for other observations."""


class PolicyLayoutError(PolicyFileError, LayoutError):
    """A policy file was made for another layout."""


@dataclass(frozen=True, kw_only=True)
class Description:
    """The description of a policy of any kind; :class:`Metadata` and :class:`SizeFreeMetadata` add what it decides on.

    Attributes:
        interface: of the policy.
        scenarios: names of the scenarios, families of games or tracks (``"ptne-v1/delay"``) it was trained on.
        steps: agent-steps of training.
        seed: of training.
        digits: mean digits on the validation episodes after training.
        versions: of the libraries that wrote it.
        layout_version: version of the meaning of observations and actions.

    Raises:
        ValueError, TypeError: for a value of a wrong type or out of range.
    """

    kind: ClassVar[str] = ""

    interface: Interface
    scenarios: tuple[str, ...]
    steps: int
    seed: int
    digits: float
    versions: Mapping[str, str]
    layout_version: int = LAYOUT_VERSION

    def to_json(self) -> str:
        """The description as a JSON text."""
        data = dataclasses.asdict(self) | ({"kind": self.kind} if self.kind else {})
        return json.dumps(data, allow_nan=False, sort_keys=True)

    @staticmethod
    def from_json(text: str) -> Metadata | SizeFreeMetadata:
        """The inverse of :meth:`to_json`, for a policy of any kind.

        Raises:
            PolicyFileError: when the text is damaged, of another layout version, or names other features.
        """
        try:
            data: dict[str, Any] = json.loads(text)
            made = {kind.kind: kind for kind in (Metadata, SizeFreeMetadata)}[data.pop("kind", "")]
            data["interface"] = Interface(**data["interface"])
            arguments: dict[str, Any] = {
                name: tuple(value) if isinstance(value, list) else value for name, value in data.items()
            }
            metadata = made(**arguments)
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise PolicyFileError(f"the policy's metadata is damaged or of a later version: {error!r}") from error
        metadata.require_version()
        return metadata

    def __post_init__(self) -> None:
        for name in ("steps", "seed", "layout_version"):
            require_count(name, getattr(self, name), 0)
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
        names = [field.name for field in dataclasses.fields(Interface)]
        different = [name for name in names if getattr(self.interface, name) != getattr(layout.interface, name)]
        mine, theirs = (
            ", ".join(f"{name}={getattr(interface, name)!r}" for name in different)
            for interface in (self.interface, layout.interface)
        )
        return {"interface": (mine, theirs)}

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


@dataclass(frozen=True, kw_only=True)
class Metadata(Description):
    """The description of a policy that maps flat observations of one layout to actions.

    Attributes:
        action_dims: n_i of each player it was trained with.
        slots: D, neighbour slots per player.
    """

    action_dims: tuple[int, ...]
    slots: int

    def __post_init__(self) -> None:
        super().__post_init__()
        for dim in self.action_dims:
            require_count("action_dims", dim, 1)
        require_count("slots", self.slots, 0)

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return sum(self.action_dims)

    def _needs(self, layout: ObservationLayout) -> dict[str, tuple[Any, Any]]:
        return super()._needs(layout) | {
            "action_dims": (self.action_dims, layout.action_dims),
            "neighbour slots": (self.slots, layout.slots),
        }


@dataclass(frozen=True, kw_only=True)
class SizeFreeMetadata(Description):
    """The description of a policy that decides in worlds of every size; see :mod:`ptne_env.learn.size_free`.

    Attributes:
        cell_features: names of the features of a component that its network reads, in order.
        slot_features: names of the features of a message that its network reads, in order.
        gates: names of the gates that its network answers, in order.
    """

    kind: ClassVar[str] = "size-free"

    cell_features: tuple[str, ...]
    slot_features: tuple[str, ...]
    gates: tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (*self.cell_features, *self.slot_features, *self.gates):
            require_printable("the name of a feature or gate", name)

    def require_version(self) -> None:
        """As for every policy; the features and gates are those of this version, too."""
        super().require_version()
        differences = [
            f"{what}: {difference}"
            for what, mine, theirs in (
                ("features of components", self.cell_features, CELL_FEATURES),
                ("features of messages", self.slot_features, SLOT_FEATURES),
                ("gates", self.gates, GATES),
            )
            if (difference := _difference(mine, theirs))
        ]
        if differences:
            raise PolicyFileError(
                f"the policy was made by ptne_env {self.versions.get('ptne_env', 'of another version')} with other "
                f"features or gates than this library's; {'; '.join(differences)}; use the version of ptne_env that "
                "made it, or train it again"
            )


def _difference(mine: Sequence[str], theirs: Sequence[str]) -> str:
    """The difference between the names in a file and those of this library, in words; empty where there is none."""
    parts = {"only in the file": set(mine) - set(theirs), "only in this library": set(theirs) - set(mine)}
    texts = [f"{where} {', '.join(sorted(names))}" for where, names in parts.items() if names]
    if not texts and tuple(mine) != tuple(theirs):
        texts = ["in another order or number"]
    return ", ".join(texts)
