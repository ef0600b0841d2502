"""Policy specs: a name, a policy per training seed, the interface it acts through, the scenarios it is meant for."""

from __future__ import annotations

import glob
import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from ptne_env import laws
from ptne_env import learn as policies
from ptne_env.evaluation.provenance import file_hashes
from ptne_env.evaluation.sources import is_file
from ptne_env.learn.archive import recognised_interface
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError, describe
from ptne_env.shared.arrays import require_printable
from ptne_env.shared.files import require_file
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import LOADER, FactorySpec, is_part
from ptne_env.world.catalogue import CATALOGUE

_LAWS = "ptne_env.laws:"
_AVERAGING = {"patience": 30.0, "forgetting": 2.0}
DIVISIONS = ("honest", "oracle")
"""The kinds of entries, in the order of tables: oracles use information that players lack."""

ARCHIVE = "ptne_env.learn.archive:load_archive"
"""Target of the policies whose making executes code that is stored in a file."""

PolicySource: TypeAlias = FactorySpec | Policy | Callable[[ObservationLayout], Policy]
"""A factory spec or a callable that builds the policy from a layout, or the policy itself."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy of a comparison.

    Attributes:
        name: for tables and files.
        policy: a :class:`~ptne_env.shared.parts.FactorySpec` or a callable that builds the policy from a layout (such as
            the class of a law), or a policy itself, such as a Stable-Baselines3 model; or a tuple of these, one per
            training seed.
        interface: makes its observations and decodes its actions; the policy's own attribute ``interface`` if left
            out, or the one that the spaces of a Stable-Baselines3 model belong to; ``physical`` if it has neither.
        scenarios: names of the scenarios it is run on, "n/a" elsewhere; all if ``None``.
        description: one sentence, for lists; no part of the policy.
    """

    name: str
    policy: PolicySource | tuple[PolicySource, ...]
    interface: Interface = None  # type: ignore[assignment]  # filled in below, so that readers never see None
    scenarios: frozenset[str] | None = None
    description: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        require_printable("the name of a policy", self.name)
        if not self.training_seeds:
            raise ValueError(f"policy {self.name!r} has no training seed")
        if self.interface is None:
            first = self.training_seeds[0]
            if (file := learned_file(first)) is not None:
                interface = policies.load(file).interface
            else:
                target = first.resolve() if isinstance(first, FactorySpec) else first
                interface = getattr(target, "interface", None) or recognised_interface(target) or Interface()
            object.__setattr__(self, "interface", interface)

    @property
    def training_seeds(self) -> tuple[PolicySource, ...]:
        """The policy of each training seed; one where nothing was trained."""
        return self.policy if isinstance(self.policy, tuple) else (self.policy,)

    @property
    def is_learned(self) -> bool:
        """Whether it is compared with the tuned laws: everything but the library's own laws and reference policies."""
        first = self.training_seeds[0]
        target = first.target if isinstance(first, FactorySpec) else f"{_named(first).__module__}:"
        return not target.startswith(("law:", "ptne_env.laws", "ptne_env.field.laws"))

    @property
    def foreign_code(self) -> list[str]:
        """What is not of this library in its factory specs: targets, nested ones too, and archives by their path.

        Nothing foreign is imported. Policies that were given as objects are not in it.
        """
        specs = (source for source in self.training_seeds if isinstance(source, FactorySpec))
        return [
            str(dict(part.arguments).get("path", part.target)) if part.target == ARCHIVE else part.target
            for spec in specs
            for part in spec.nested()
            if not is_part(part.target)
        ]

    @property
    def is_foreign(self) -> bool:
        """Whether making it runs code that is not of this library."""
        return bool(self.foreign_code)

    @property
    def ships(self) -> bool:
        """Whether code and files of every training seed are of this library, whose tests audit their decisions."""
        return (
            all(isinstance(source, FactorySpec) and not _is_own_file(source) for source in self.training_seeds)
            and not self.is_foreign
        )

    @property
    def is_oracle(self) -> bool:
        """Whether it uses information that players lack."""
        return self.interface.kind == "full"

    @property
    def division(self) -> str:
        """One of :data:`DIVISIONS`."""
        return DIVISIONS[self.is_oracle]

    @property
    def is_repeatable(self) -> bool:
        """Whether every training seed is a factory spec, so that another process can make it again."""
        return all(isinstance(policy, FactorySpec) for policy in self.training_seeds)

    def build(self, layout: ObservationLayout, training_seed: int = 0) -> Policy:
        """The policy of a training seed for a layout, in this process.

        Raises:
            LayoutError: when it was made for another layout.
            PolicyError: when it cannot be built, or the result has no ``predict``.
        """
        return build(self.training_seeds[training_seed], layout)

    @contextmanager
    def deciding(self, layout: ObservationLayout, training_seed: int = 0) -> Iterator[Policy]:
        """The same, ready to decide.

        Raises:
            LayoutError, PolicyError: as :meth:`build`.
        """
        yield self.build(layout, training_seed)

    def to_dict(self) -> dict[str, Any]:
        """A JSON object with the parameters, and the hashes of the files, of every training seed."""
        return {
            "name": self.name,
            "interface": asdict(self.interface),
            "scenarios": None if self.scenarios is None else sorted(self.scenarios),
            "training_seeds": [_source_to_dict(policy) for policy in self.training_seeds],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PolicySpec:
        """The inverse of :meth:`to_dict` for a repeatable policy; nothing is imported.

        Raises:
            ValueError: when a policy was an object of another process, or the data are no policy.
        """
        try:
            if any("arguments" not in policy for policy in data["training_seeds"]):
                raise ValueError(
                    f"policy {data['name']!r} was an object, not a factory spec: nothing can make it again"
                )
            seeds = tuple(
                FactorySpec.from_dict({key: policy[key] for key in ("target", "arguments")})
                for policy in data["training_seeds"]
            )
            scenarios = None if data["scenarios"] is None else frozenset(data["scenarios"])
            name, interface = str(data["name"]), Interface(**data["interface"])
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a policy: {type(error).__name__}: {error}") from None
        return cls(name, seeds if len(seeds) != 1 else seeds[0], interface, scenarios)


def build(source: PolicySource, layout: ObservationLayout) -> Policy:
    """Build a policy.

    Args:
        source: of the policy.
        layout: of its observations.

    Raises:
        LayoutError: when it was made for another layout.
        PolicyError: when building it raises anything else, or the result has no ``predict``.
    """
    built: Any = source
    try:
        if isinstance(source, FactorySpec):
            built = source.build(layout=layout)
        elif isinstance(source, type) or not hasattr(source, "predict"):
            built = source(layout)
        if hasattr(built, "require"):
            built.require(layout)
    except (LayoutError, MemoryError):
        raise
    except Exception as error:
        called = "; it is called with the layout" * isinstance(error, TypeError)
        raise PolicyError(f"it cannot be built: {describe(error)}{called}") from error
    expected = getattr(getattr(built, "observation_space", None), "shape", None)  # of a Stable-Baselines3 model
    if expected not in (None, (layout.size,)):
        raise LayoutError(
            f"it was trained on observations of shape {expected}, and this track with the interface "
            f"{layout.interface.kind!r} has {(layout.size,)}; if it was trained with another interface, give that one: "
            "PolicySpec(name, model, ptne_env.Interface('scaled'))"
        )
    if not hasattr(built, "predict"):
        raise PolicyError(f"it is a {type(built).__name__} without predict(observation, state, ...)")
    policy: Policy = built
    return policy


def _source_to_dict(policy: PolicySource) -> dict[str, Any]:
    if isinstance(policy, FactorySpec):
        return {**policy.to_dict(), "files": file_hashes(policy)}
    named = _named(policy)
    return {"target": f"{named.__module__}:{named.__qualname__}"}


def learned_file(source: PolicySource) -> str | None:
    """The path or the shipped name of the ``.onnx`` file that a policy is loaded from; ``None`` for another policy."""
    if not isinstance(source, FactorySpec) or source.target != LOADER:
        return None
    return str(dict(source.arguments).get("path_or_name"))


def _is_own_file(source: FactorySpec) -> bool:
    """Whether a factory spec loads an ``.onnx`` file that is not shipped."""
    file = learned_file(source)
    return file is not None and policies.shipped_path(file) is None


def _named(policy: Any) -> type:
    return policy if isinstance(policy, type) else type(policy)


def _law(name: str, kind: str, description: str, **arguments: Any) -> PolicySpec:
    module = "ptne_env.laws:" if hasattr(laws, kind) else "ptne_env.field.laws:"
    return PolicySpec(name, FactorySpec.of(f"{module}{kind}", **arguments), description=description)


POLICIES: Mapping[str, PolicySpec] = {
    policy.name: policy
    for policy in [
        _law(
            "static",
            "Static",
            "The paper's static law: down the slope of the own cost, and towards the neighbours with the gain κ.",
            kappa=2.0,
        ),
        _law(
            "adaptive",
            "Adaptive",
            "The paper's adaptive law: the gain of a link grows as long as its two players disagree.",
            gamma=0.01,
            initial_gain=0.5,
        ),
        _law(
            "corollary-one",
            "CorollaryOne",
            "The static law without the time gain, with a κ as large as its corollary needs.",
            kappa=10.0,
        ),
        _law(
            "gadjov-pavel",
            "CorollaryOne",
            "Gadjov and Pavel's law: the static law without the time gain, with κ = 1.",
            kappa=1.0,
        ),
        _law(
            "grounded",
            "Grounded",
            "Ye and Hu's law: estimates follow the neighbours, and the own strategy follows the own cost alone.",
            kappa=2.0,
        ),
        _law("zero-input", "ZeroInput", "Does nothing: strategies stay at the start."),
        _law("random", "RandomPolicy", "Random inputs.", seed=0),
        _law(
            "oracle",
            "CentralisedOracle",
            "Gradient play with the true strategies of all players, which players do not have.",
            gradient_gain=1.0,
        ),
        # The other laws of the field, which are run on suites.
        _law(
            "static-tuned",
            "Static",
            "The static law with tuned weights of the own cost and of the neighbours.",
            kappa=3.0,
            gradient_gain=3.5,
        ),
        _law(
            "fixed-gain",
            "FixedGain",
            "The static law with the κ that Bianchi and Grammatico's weaker condition asks for.",
            kappa=5.0,
        ),
        _law(
            "adaptive-grounded",
            "AdaptiveGrounded",
            "Ye and Hu's adaptive law: the grounded law, with gains that every player tunes by itself.",
            gamma=0.0001,
            initial_gain=3.0,
        ),
        _law(
            "projected-gradient",
            "ProjectedGradient",
            "Bianchi and Grammatico's discrete law: average with the neighbours, then take a gradient step.",
            step=0.5,
            mixing=0.45,
        ),
        _law(
            "routed-unknown",
            "RoutedUnknown",
            "Copies news of each player from the neighbours that have them first, and takes gradient steps.",
            step=0.3,
        ),
        _law(
            "contact-relay",
            "ContactRelay",
            "Copies news as routed-unknown, and takes best responses by an identified model of the own gradient.",
            **_AVERAGING,
        ),
        _law(
            "observer-relay",
            "ObserverRelay",
            "The contact relay with filters against noise, rounding, pushes and reactions of others.",
        ),
        _law(
            "multi-rate",
            "MultiRate",
            "Gradient play with prices for a shared constraint, on copies as those of routed-unknown.",
            step=0.2,
            price_step=0.2,
            lead=2.0,
        ),
        _law(
            "proximal-best-response",
            "ProximalBestResponse",
            "Bianchi, Belgioioso and Grammatico's law: proximal best responses, and averages with neighbours.",
            step=4.0,
            mixing=0.45,
        ),
    ]
}
"""The laws and reference policies by name, in the order in which tables list them."""

COMPARED = (*tuple(POLICIES)[:8], "routed-unknown", "observer-relay")
"""The default policies of a comparison, by name: the paper's laws, references, and the strongest laws of own links."""


def learned_policy(path_or_name: str) -> PolicySpec:
    """The spec of a learned policy, for the scenarios that it was trained on.

    Raises:
        ValueError, FileNotFoundError, PolicyFileError, ImportError: as :func:`ptne_env.learn.load`.
    """
    policy = policies.load(path_or_name)
    source = FactorySpec.of(LOADER, path_or_name=path_or_name)
    trained = policy.metadata.scenarios
    places = trained[0] if len(trained) == 1 else f"{len(trained)} scenarios and tracks"
    return PolicySpec(
        policy.name,
        source,
        policy.interface,
        frozenset(trained),
        description=f"A network, trained on {places}; {policy.metadata.digits:.3g} digits on its validation episodes.",
    )


def default_policies() -> list[PolicySpec]:
    """The default policies of a comparison: :data:`COMPARED`, and the policies trained on a scenario of the catalogue.

    A learned policy is run on the scenarios that it was trained on.
    """
    learned = map(learned_policy, policies.shipped())
    return [
        *(POLICIES[name] for name in COMPARED),
        *(policy for policy in learned if policy.scenarios and not policy.scenarios.isdisjoint(CATALOGUE)),
    ]


def suite_policies() -> list[PolicySpec]:
    """The default policies of a suite: all laws, reference policies and shipped policies, on every track they fit."""
    return [*POLICIES.values(), *map(get_policy_spec, policies.shipped())]


def get_policy_spec(policy: str | PolicySpec, *, trust: bool = False) -> PolicySpec:
    """A policy by name, file, ``"module:object"`` or ``"name=pattern"``, or as it is.

    A string of the caller is code of the caller: a ``"module:object"`` is imported without a question. The command
    line, whose strings may be copied from elsewhere, asks for all that :func:`foreign_code` finds.

    Args:
        policy: a name of :data:`POLICIES` or of a shipped policy, an ``.onnx`` file, a Stable-Baselines3 ``.zip``, a
            ``"module:object"`` that is called with the layout, or ``"name=pattern"`` (such as
            ``"mine=runs/seed-*/policy.onnx"``), whose files are the training seeds of one policy. A string with ``=``
            that is the path of a file, or has a folder before ``=``, is no pattern.
        trust: whether code that is stored in a ``.zip`` may be executed, also in one that a pattern finds.

    Raises:
        ValueError: for an unknown name, an object that is no string and no spec, an object that cannot be imported, a
            pattern with files of another kind, training seeds with different interfaces, or a ``.zip`` that is not
            trusted.
        FileNotFoundError: also for a pattern without files.
        PolicyFileError, ImportError: as :func:`ptne_env.learn.load`.
    """
    if isinstance(policy, PolicySpec):
        return policy
    if not isinstance(policy, str):
        raise ValueError(
            f"a policy is a string or a PolicySpec, got {policy!r}: wrap a class, function or model as "
            "PolicySpec(name, policy)"
        )
    if (pattern := _pattern(policy)) is not None:
        return _training_seeds(*pattern, trust=trust)
    if policy in POLICIES:
        return POLICIES[policy]
    if policy in policies.shipped() or Path(policy).suffix == ".onnx":
        return replace(learned_policy(policy), scenarios=None)  # named, it is run wherever it fits
    if stores_code(policy):
        require_file(policy)
        if not trust:
            raise ValueError(
                f"loading {policy!r} executes code that is stored in it; if you trust it: "
                f"ptne_env.evaluation.get_policy_spec({policy!r}, trust=True)"
            )
        return PolicySpec(Path(policy).stem, FactorySpec.of(ARCHIVE, path=policy))
    if ":" in policy:
        return PolicySpec(policy, FactorySpec.of(policy))
    if policy in CATALOGUE:
        raise ValueError(f"{policy!r} is a scenario, no policy")
    raise ValueError(
        unknown_name("policy", policy, [*POLICIES, *policies.shipped()], "an .onnx file or a 'module:object'")
    )


def foreign_code(policy: str) -> list[str]:
    """The archives, and the ``"module:object"`` that is no part of the library, that a string names as a policy.

    Nothing is imported or loaded.

    Args:
        policy: as for :func:`get_policy_spec`; patterns are expanded.

    Raises:
        ValueError: for a pattern with files of another kind.
        FileNotFoundError: for a pattern without files.
    """
    pattern = _pattern(policy)
    if pattern is not None:
        return list(filter(stores_code, pattern[1]))
    is_target = ":" in policy and Path(policy).suffix != ".onnx" and not is_part(policy)
    return [policy] if is_target or stores_code(policy) else []


def stores_code(policy: str) -> bool:
    """Whether loading the policy that a string names executes code that is stored in a file."""
    return policy.endswith(".zip")


def _pattern(policy: str) -> tuple[str, list[str]] | None:
    """The name and the files of ``"name=pattern"``; ``None`` for a string of another kind."""
    name, separator, pattern = policy.partition("=")
    if not separator or Path(name).name != name or is_file(policy):
        return None
    found = sorted(glob.glob(pattern))  # noqa: PTH207 - it may be absolute
    if not name:
        raise ValueError(f"'={pattern}' has no name: write 'name=pattern'")
    if not found:
        raise FileNotFoundError(f"there is no file {pattern!r}, which '{name}={pattern}' asks for")
    if others := [path for path in found if not path.endswith((".onnx", ".zip"))]:
        raise ValueError(f"'{name}={pattern}' matches {others[0]!r}: policy files end in .onnx or .zip")
    return name, found


def _training_seeds(name: str, paths: list[str], *, trust: bool) -> PolicySpec:
    found = [get_policy_spec(path, trust=trust) for path in paths]
    if len({policy.interface for policy in found}) > 1:
        raise ValueError(f"the files of policy {name!r} have different interfaces: they are not one policy")
    return PolicySpec(name, tuple(policy.training_seeds[0] for policy in found), found[0].interface)


def law_names() -> list[str]:
    """The names that :func:`law_factory` knows: of :data:`POLICIES`, and of classes in ``ptne_env.laws``."""
    members = vars(laws).items()
    classes = [name for name, value in members if isinstance(value, type) and issubclass(value, laws.Law)]
    return [*POLICIES, *(name for name in classes if name != "Law")]


def law_factory(law: str, kappa: float | None = None) -> FactorySpec:
    """The factory spec of a law: by name, class in ``ptne_env.laws``, or ``"module:object"``.

    Args:
        law: its name, class or address.
        kappa: κ in place of the law's own.

    Raises:
        ValueError: for an unknown name, a policy that is no law, or κ for a law that has none.
    """
    if law in POLICIES or ":" in law:
        factory = get_policy_spec(law).policy
    else:
        if law not in law_names():
            raise ValueError(unknown_name("law", law, law_names(), "a 'module:object'"))
        factory = FactorySpec.of(f"{_LAWS}{law}")
    if not isinstance(factory, FactorySpec):
        raise ValueError(f"{law!r} is no law; name one of {', '.join(POLICIES)}, or a 'module:object'")
    if kappa is None:
        return factory
    if "kappa" not in inspect.signature(factory.resolve()).parameters:
        raise ValueError(f"the law {law!r} has no kappa")
    return FactorySpec.of(factory.target, **{**dict(factory.arguments), "kappa": kappa})
