"""Who takes part in a comparison: a name, a policy and the interface it acts through."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ptne_env import laws, policies
from ptne_env.catalogue import CATALOGUE
from ptne_env.factory import FactorySpec
from ptne_env.observation import Interface, ObservationLayout
from ptne_env.policies import LearnedPolicy
from ptne_env.policy import Policy

_LAWS = "ptne_env.laws:"


@dataclass(frozen=True)
class PolicySpec:
    """A participant.

    Attributes:
        name: for tables and files.
        policy: a :class:`~ptne_env.factory.FactorySpec` or a callable that builds the policy from a layout (a law's class, for
            one), or a policy itself, such as a Stable-Baselines3 model.
        interface: through which it sees and acts; the policy's own attribute ``interface`` if left out, and
            ``physical`` if it has none.
        scenarios: names of the scenarios it enters; all if ``None``.
    """

    name: str
    policy: FactorySpec | Policy | Callable[[ObservationLayout], Policy]
    interface: Interface = None  # type: ignore[assignment]  # filled in below, so that readers never see None
    scenarios: frozenset[str] | None = None

    def __post_init__(self) -> None:
        if self.interface is None:
            target = self.policy.resolve() if isinstance(self.policy, FactorySpec) else self.policy
            object.__setattr__(self, "interface", getattr(target, "interface", Interface()))

    @property
    def is_learned(self) -> bool:
        """Whether it is measured against the tuned laws: everything but the library's own laws and anchors."""
        target = self.policy.target if isinstance(self.policy, FactorySpec) else f"{_named(self.policy).__module__}:"
        return not target.startswith((_LAWS, "ptne_env.laws."))

    def enters(self, scenario: str) -> bool:
        """Whether it takes part in the scenario of this name."""
        return self.scenarios is None or scenario in self.scenarios

    def build(self, layout: ObservationLayout) -> Policy:
        """The policy for a layout.

        Raises:
            ValueError: when it cannot be built, was made for another layout, or what is built has no ``predict``.
        """
        built: Any = self.policy
        if isinstance(built, FactorySpec):
            built = built.build(layout=layout)
        elif isinstance(built, type) or not hasattr(built, "predict"):
            built = built(layout)
        if not hasattr(built, "predict"):
            raise ValueError(f"policy {self.name!r}: {type(built).__name__} has no predict(observation, state, ...)")
        if isinstance(built, LearnedPolicy):
            built.require(layout)
        policy: Policy = built
        return policy

    def to_dict(self) -> dict[str, Any]:
        """A JSON object that says which policy this is, with its parameters."""
        if isinstance(self.policy, FactorySpec):
            policy: Any = self.policy.to_dict()
        else:
            named = _named(self.policy)
            policy = {"target": f"{named.__module__}:{named.__qualname__}"}
        return {"name": self.name, "policy": policy, "interface": asdict(self.interface)}


def _named(policy: Any) -> type:
    return policy if isinstance(policy, type) else type(policy)


ENTRIES: Mapping[str, PolicySpec] = {
    entry.name: entry
    for entry in [
        PolicySpec("static", FactorySpec.of(f"{_LAWS}Static", kappa=2.0)),
        PolicySpec("adaptive", FactorySpec.of(f"{_LAWS}Adaptive", gamma=0.01, initial_gain=0.5)),
        PolicySpec("corollary-one", FactorySpec.of(f"{_LAWS}CorollaryOne", kappa=10.0)),
        PolicySpec("gadjov-pavel", FactorySpec.of(f"{_LAWS}CorollaryOne", kappa=1.0)),
        PolicySpec("grounded", FactorySpec.of(f"{_LAWS}Grounded", kappa=2.0)),
        PolicySpec("null", FactorySpec.of(f"{_LAWS}ZeroInput")),
        PolicySpec("random", FactorySpec.of(f"{_LAWS}RandomPolicy", seed=0)),
        PolicySpec("oracle", FactorySpec.of(f"{_LAWS}CentralisedOracle", gradient_gain=1.0)),
        # The other laws of the field, which enter suites.
        PolicySpec("static-tuned", FactorySpec.of(f"{_LAWS}Static", kappa=3.0, gradient_gain=3.5)),
        PolicySpec("fixed-gain", FactorySpec.of(f"{_LAWS}FixedGain", kappa=5.0)),
        PolicySpec("averaging-integral", FactorySpec.of(f"{_LAWS}AveragingIntegral", gamma=0.003)),
        PolicySpec("adaptive-grounded", FactorySpec.of(f"{_LAWS}AdaptiveGrounded", gamma=0.0001, initial_gain=3.0)),
        PolicySpec("projected-gradient", FactorySpec.of(f"{_LAWS}ProjectedGradient", step=0.5, mixing=0.45)),
        PolicySpec("aggregate-tracking", FactorySpec.of(f"{_LAWS}AggregateTracking", step=0.5, power=0.6, mixing=0.3)),
        PolicySpec("extremum-seeking", FactorySpec.of(f"{_LAWS}ExtremumSeeking", amplitude=1.0, gain=0.2)),
        PolicySpec("locally-implicit", FactorySpec.of(f"{_LAWS}LocallyImplicit", kappa=2.0, curvature=5.0)),
        PolicySpec("capped-gain", FactorySpec.of(f"{_LAWS}CappedGain", kappa=2.0, largest_gain=200.0)),
        PolicySpec("best-response-oracle", FactorySpec.of(f"{_LAWS}BestResponseOracle", relaxation=1.0)),
        PolicySpec("fixed-time-oracle", FactorySpec.of(f"{_LAWS}FixedTimeOracle", gain=1.0, largest_step=0.3)),
        PolicySpec(
            "node-adaptive-oracle", FactorySpec.of(f"{_LAWS}NodeAdaptiveOracle", gamma=0.0001, initial_gain=1.0)
        ),
    ]
}
"""The laws and anchors by name, in the order in which tables list them."""

COMPARED = tuple(ENTRIES)[:8]
"""Names of those that enter comparisons on the catalogue when nobody is named: the paper's laws and the anchors."""


def learned_entry(path_or_name: str) -> PolicySpec:
    """A learned policy as a participant that enters the scenarios it was trained on.

    Raises:
        FileNotFoundError, PolicyFileError, ImportError: as :func:`ptne_env.policies.load`.
    """
    policy = policies.load(path_or_name)
    part = FactorySpec.of("ptne_env.policies:load", path_or_name=path_or_name)
    return PolicySpec(policy.name, part, policy.interface, frozenset(policy.metadata.scenarios))


def default_entries() -> list[PolicySpec]:
    """Who enters a comparison on the catalogue: :data:`COMPARED`, and shipped policies trained on some of it."""
    learned = map(learned_entry, policies.shipped())
    return [*(ENTRIES[name] for name in COMPARED), *(entry for entry in learned if any(map(entry.enters, CATALOGUE)))]


def suite_entries() -> list[PolicySpec]:
    """Who enters a suite: all laws, anchors and the shipped learned policies."""
    return [*ENTRIES.values(), *map(learned_entry, policies.shipped())]


def get_policy_spec(entry: str | PolicySpec) -> PolicySpec:
    """A participant by name, by an ``.onnx`` file, by ``"module:object"`` (called with a layout), or as it is.

    Raises:
        ValueError: for an unknown name, or an object that cannot be imported.
        FileNotFoundError, PolicyFileError, ImportError: as :func:`ptne_env.policies.load`.
    """
    if isinstance(entry, PolicySpec):
        return entry
    if entry in ENTRIES:
        return ENTRIES[entry]
    if entry in policies.shipped() or Path(entry).suffix == ".onnx":
        learned = learned_entry(entry)
        return PolicySpec(learned.name, learned.policy, learned.interface)  # asked for by name, it enters everywhere
    if ":" in entry:
        return PolicySpec(entry, FactorySpec.of(entry))
    known = ", ".join([*ENTRIES, *policies.shipped()])
    raise ValueError(f"unknown policy {entry!r}; choose from {known}, or name an .onnx file or a 'module:object'")


def law_names() -> list[str]:
    """By which names :func:`law_part` knows the laws: of entries, and of classes in ``ptne_env.laws``."""
    members = vars(laws).items()
    classes = [name for name, value in members if isinstance(value, type) and issubclass(value, laws.Law)]
    return [*ENTRIES, *(name for name in classes if name != "Law")]


def law_part(law: str, kappa: float | None = None) -> FactorySpec:
    """The part that builds a law: by name, by its class in ``ptne_env.laws``, or by ``"module:object"``.

    Args:
        law: which.
        kappa: κ in place of the law's own.

    Raises:
        ValueError: for an unknown name, a policy that is no law, or κ for a law that has none.
    """
    if law in ENTRIES or ":" in law:
        part = get_policy_spec(law).policy
    else:
        if law not in law_names():
            raise ValueError(f"unknown law {law!r}; name one of {', '.join(law_names())}, or a 'module:object'")
        part = FactorySpec.of(f"{_LAWS}{law}")
    if not isinstance(part, FactorySpec):
        raise ValueError(f"{law!r} is no law; name one of {', '.join(ENTRIES)}, or a 'module:object'")
    if kappa is None:
        return part
    if "kappa" not in inspect.signature(part.resolve()).parameters:
        raise ValueError(f"the law {law!r} has no kappa")
    return FactorySpec.of(part.target, **{**dict(part.arguments), "kappa": kappa})
