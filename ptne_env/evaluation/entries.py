"""Who takes part in a comparison: a name, a policy and the interface it acts through."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ptne_env.interface import Interface, Layout
from ptne_env.parts import Part
from ptne_env.policy import Policy


@dataclass(frozen=True)
class Entry:
    """A participant.

    Attributes:
        name: for tables and files.
        policy: a :class:`~ptne_env.parts.Part` or a callable that builds the policy from a layout (a law's class, for
            one), or a policy itself, such as a Stable-Baselines3 model.
        interface: through which it sees and acts.
    """

    name: str
    policy: Part | Policy | Callable[[Layout], Policy]
    interface: Interface = field(default_factory=Interface)

    def build(self, layout: Layout) -> Policy:
        """The policy for a layout.

        Raises:
            ValueError: when it cannot be built, or what is built has no ``predict``.
        """
        built: Any = self.policy
        if isinstance(built, Part):
            built = built.build(layout=layout)
        elif isinstance(built, type) or not hasattr(built, "predict"):
            built = built(layout)
        if not hasattr(built, "predict"):
            raise ValueError(f"policy {self.name!r}: {type(built).__name__} has no predict(observation, state, ...)")
        policy: Policy = built
        return policy

    def to_dict(self) -> dict[str, Any]:
        """A JSON object that says which policy this is, with its parameters."""
        if isinstance(self.policy, Part):
            policy: Any = self.policy.to_dict()
        else:
            named = self.policy if isinstance(self.policy, type) else type(self.policy)
            policy = {"target": f"{named.__module__}:{named.__qualname__}"}
        return {"name": self.name, "policy": policy, "interface": asdict(self.interface)}


def _law(name: str, target: str, kind: str = "physical", **arguments: Any) -> Entry:
    return Entry(name, Part.of(f"ptne_env.laws:{target}", **arguments), Interface(kind))  # type: ignore[arg-type]  # checked by Interface


ENTRIES: Mapping[str, Entry] = {
    entry.name: entry
    for entry in [
        _law("static", "Static", kappa=2.0),
        _law("adaptive", "Adaptive", gamma=0.01, initial_gain=0.5),
        _law("corollary-one", "CorollaryOne", kappa=10.0),
        _law("gadjov-pavel", "CorollaryOne", kappa=1.0),
        _law("grounded", "Grounded", kappa=2.0),
        _law("null", "Null"),
        _law("random", "RandomPolicy", seed=0),
        _law("oracle", "CentralisedOracle", "full", gradient_gain=1.0),
    ]
}
"""The named participants, in the order in which tables list them."""


def get_entry(entry: str | Entry) -> Entry:
    """A participant by name, by ``"module:object"`` (called with a layout), or as it is.

    An object's attribute ``interface``, if it has one, says through which interface it acts.

    Raises:
        ValueError: for an unknown name, or an object that cannot be imported.
    """
    if isinstance(entry, Entry):
        return entry
    if entry in ENTRIES:
        return ENTRIES[entry]
    if ":" in entry:
        part = Part.of(entry)
        return Entry(entry, part, getattr(part.resolve(), "interface", Interface()))
    raise ValueError(f"unknown policy {entry!r}; choose from {', '.join(ENTRIES)} or name one as 'module:object'")
