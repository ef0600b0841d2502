"""A policy of a comparison: its name, a policy per training seed, and the interface that it acts through."""

from __future__ import annotations

import glob
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from inspect import signature
from pathlib import Path
from typing import Any, TypeAlias

from ptne_env.evaluation.named_policies import NO_LAWS, TABLE
from ptne_env.evaluation.provenance import content_hash, file_hash
from ptne_env.learn.policy_files import FORMATS, TRACK, files_by_track, find_file, format_of
from ptne_env.learn.sb3_archive import as_trained, require_one_observation
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError, describe
from ptne_env.shared.arrays import require_flag, require_printable
from ptne_env.shared.files import require_file
from ptne_env.shared.names import require_name, unknown_name
from ptne_env.shared.parts import FactorySpec, foreign_targets, read_call, resolve

MARKS = {
    "*": "an oracle: it uses information that players lack, and has no rank",
    "‡": "its players send code, so messages are not their estimates; ranked apart",
}
"""The marks of policies that are no rivals of others, and what they mean."""

PolicySource: TypeAlias = FactorySpec | Policy | Callable[[ObservationLayout], Policy]
"""A factory spec or a callable that builds the policy from a layout, or the policy itself."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy of a comparison.

    Attributes:
        name: the name in tables and files.
        policy: a :class:`~ptne_env.shared.parts.FactorySpec` or a callable that builds the policy from a layout (such
            as the class of a law), or a policy itself, such as a Stable-Baselines3 model; or a tuple of these, one per
            training seed.
        interface: the interface, or its kind, that makes the observations and decodes the actions. A policy that has
            an attribute ``interface`` takes no other; one that has none gets ``scaled`` if this is left out.
        description: a sentence for lists, which does not count in comparisons of specs.

    Raises:
        ValueError: when there is no training seed, or one is none of these, training seeds have different interfaces,
            the policy declares another interface, or its factory spec cannot be imported.
    """

    name: str
    policy: PolicySource | tuple[PolicySource, ...]
    interface: Interface = None  # type: ignore[assignment]  # filled in below, so that readers never see None
    description: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        require_printable("the name of a policy", self.name)
        if not self.training_seeds:
            raise ValueError(f"policy {self.name!r} has no training seed")
        if isinstance(self.policy, tuple) and len(self.policy) == 1:
            object.__setattr__(self, "policy", self.policy[0])
        for source in self.training_seeds:
            if not (isinstance(source, FactorySpec) or callable(source) or hasattr(source, "predict")):
                raise ValueError(
                    f"policy {self.name!r} is {source!r}: give a FactorySpec, a class or function that is called with "
                    "the layout, or an object with predict; get_policy_spec('static') is the policy of a name"
                )
        interfaces = {_as_interface(_declared(source, "interface")) for source in self.training_seeds}
        if len(interfaces) > 1:
            raise ValueError(
                f"the training seeds of policy {self.name!r} have different interfaces: they are no one policy"
            )
        (declared,), asked = interfaces, _as_interface(self.interface)
        if None not in (declared, asked) and declared != asked:
            raise ValueError(f"policy {self.name!r} declares the interface {declared}: it cannot act through {asked}")
        object.__setattr__(self, "interface", declared or asked or Interface())

    @property
    def training_seeds(self) -> tuple[PolicySource, ...]:
        """The policy of each training seed; one where nothing was trained."""
        return self.policy if isinstance(self.policy, tuple) else (self.policy,)

    @property
    def is_oracle(self) -> bool:
        """Whether the policy uses information that players lack."""
        return self.interface.is_privileged

    @cached_property
    def mark(self) -> str:
        """The mark of :data:`MARKS` that the policy has in tables; empty for most."""
        coded = any(_declared(source, "sends_code") for source in self.training_seeds)
        return "*" if self.is_oracle else "‡" if coded else ""

    @property
    def label(self) -> str:
        """The name with the mark."""
        return f"{self.name} {self.mark}".rstrip()

    @property
    def is_ranked(self) -> bool:
        """Whether the policy is a rival of others: it is no oracle, and its messages are its estimates."""
        return not self.mark

    @property
    def is_law(self) -> bool:
        """Whether the policy is a law of :data:`POLICIES` that seeks the equilibrium, and is ranked."""
        return self.name in TABLE and self.is_ranked and not (self.files or self.name in NO_LAWS)

    @property
    def is_repeatable(self) -> bool:
        """Whether every training seed is a factory spec, so that another process can make it again."""
        return all(isinstance(source, FactorySpec) for source in self.training_seeds)

    @property
    def is_own(self) -> bool:
        """Whether a part of the policy is the user's: an object, foreign code, or a file that does not ship."""
        foreign = not self.is_repeatable or any(map(foreign_targets, self.training_seeds))
        return foreign or any(Path(path).suffix for path in self.files)  # shipped files go by their names

    @property
    def files(self) -> list[str]:
        """The path or shipped name of the file of every training seed that is loaded from one."""
        return [path for path in map(_file_of, self.training_seeds) if path is not None]

    @property
    def libraries(self) -> tuple[str, ...]:
        """The libraries that the policy computes with, beside those that every result depends on."""
        file_format = format_of(self.training_seeds[0])
        return file_format.libraries if file_format else ()

    def on_scenario(self, name: str) -> PolicySpec:
        """Return the policy that plays a scenario: that of its file if there is one file per track, or itself."""
        by_track = [_files_by_track(source) for source in self.training_seeds]
        if not any(by_track):
            return self
        sources = zip(by_track, self.training_seeds, strict=True)
        return replace(self, policy=tuple(files.get(name, source) for files, source in sources))

    def build(self, layout: ObservationLayout, training_seed: int = 0) -> Policy:
        """Build the policy of a training seed for a layout.

        Raises:
            LayoutError: when the policy was made for another layout, or has one file per track, and none for this one.
            PolicyError: when building it raises any other error, what was built has no ``predict`` or acts through
                another interface, or it sends code and the source does not say so.
        """
        source = self.training_seeds[training_seed]
        if by_track := _files_by_track(source):
            names = ", ".join(by_track)
            raise LayoutError(f"it has one file per track, for {names}, and none for this one: choose one of those")
        built: Any = source
        try:
            if isinstance(source, FactorySpec):
                built = source.build(layout=layout)
            elif isinstance(source, type) or not hasattr(source, "predict"):
                built = source(layout)
            _require_observations_of(layout, built)
            if hasattr(built, "with_layout"):  # one object plays many worlds
                built = built.with_layout(layout)
        except LayoutError:
            raise
        except (Exception, SystemExit) as error:
            called = "; it is called with the layout" * isinstance(error, TypeError)
            raise PolicyError(f"it cannot be built: {describe(error)}{called}") from error
        if not hasattr(built, "predict"):
            made = "it is" if built is source else "called with the layout, it returned"
            raise PolicyError(f"{made} a {type(built).__name__} without predict(observation, state, ...)")
        theirs = _as_interface(getattr(built, "interface", None))
        if theirs not in (None, self.interface):
            raise PolicyError(
                f"called with the layout, it returned a {type(built).__name__}, which acts through {theirs} and not "
                f"through {self.interface}: give it by name, as 'static(kappa=4)', or as a class or "
                "functools.partial(class, ...), or set the attribute interface of the function"
            )
        if getattr(built, "sends_code", False) and not _declared(source, "sends_code"):
            raise PolicyError(
                f"called with the layout, it returned a {type(built).__name__}, whose messages are no estimates: so "
                "that tables mark it, what is called needs the attribute sends_code = True, too"
            )
        return as_trained(built)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object with the parameters of every training seed, and the SHA-256 of its file."""
        return {
            "name": self.name,
            "interface": self.interface.to_dict(),
            "training_seeds": [_source_to_dict(source) for source in self.training_seeds],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PolicySpec:
        """Make a spec from what :meth:`to_dict` of a repeatable policy returned; ``ValueError`` for anything else."""
        try:
            seeds = data["training_seeds"]
            if any("arguments" not in seed for seed in seeds):
                raise ValueError(f"policy {data['name']!r} was an object, no factory spec: nothing can make it again")
            sources = tuple(
                FactorySpec.from_dict({key: seed[key] for key in ("target", "arguments")}) for seed in seeds
            )
            interface = Interface.from_dict(data["interface"])
            return cls(data["name"], sources, interface)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a policy: {type(error).__name__}: {error}") from None


def _require_observations_of(layout: ObservationLayout, model: Any) -> None:
    """Refuse a model of Stable-Baselines3 that was trained on other observations than a layout's."""
    expected = getattr(getattr(model, "observation_space", None), "shape", None)
    if expected not in (None, (layout.size,)):
        require_one_observation(layout, model.observation_space, getattr(model, "action_space", None))
        raise LayoutError(
            f"it was trained on observations of shape {expected}, and this track with "
            f"{layout.interface} has {(layout.size,)}; if it was trained with another interface, give that "
            "one: PolicySpec(name, model, ptne_env.Interface('physical'))"
        )


def _as_interface(interface: Any) -> Interface | None:
    """Return an interface that may be given by its kind, which is checked."""
    return interface if isinstance(interface, Interface | None) else Interface(interface)


def _declared(source: PolicySource, attribute: str) -> Any:
    """Return an attribute that a policy declares, as a class, as an object or in its file; ``None`` if it does not."""
    policy: Any = source
    if isinstance(source, FactorySpec):
        source = next(iter(_files_by_track(source).values()), source)
        policy = source.build() if format_of(source) else resolve(source.target)
    policy = policy.func if isinstance(policy, partial) else policy
    return getattr(policy, attribute, None)


def _file_of(source: PolicySource) -> str | None:
    """Return the path, or the name of a shipped file, that a policy, or one that it wraps, is loaded from."""
    if not isinstance(source, FactorySpec):
        return None
    arguments, file_format = dict(source.arguments), format_of(source)
    if file_format is not None:
        return str(arguments[file_format.argument])
    return next(filter(None, map(_file_of, arguments.values())), None)


def _files_by_track(source: PolicySource) -> dict[str, FactorySpec]:
    """Return the factory spec of each file by track; empty for a policy that does not have one file per track."""
    file_format, path = format_of(source), _file_of(source)
    if file_format is None or path is None or TRACK not in path:
        return {}
    return {track: file_format.spec(name) for track, name in files_by_track(path).items()}


def _source_to_dict(source: PolicySource) -> dict[str, Any]:
    if isinstance(source, FactorySpec):
        path, by_track = _file_of(source), _files_by_track(source)
        hashes = [file_hash(find_file(name)) for name in map(_file_of, by_track.values()) if name]
        return {**source.to_dict(), "sha256": content_hash(hashes) if hashes else path and file_hash(find_file(path))}
    named = source if isinstance(source, type) else type(source)
    return {"object": f"{named.__module__}:{named.__qualname__}"}


POLICIES: Mapping[str, PolicySpec] = {
    name: PolicySpec(name, spec, description=description) for name, (description, spec) in TABLE.items()
}
"""The laws, reference policies and learned policies by name, in the order in which tables list them."""


def get_policy_spec(policy: Any, *, trust: bool = False) -> PolicySpec:
    """Return the spec of a policy, which may be given as a string, a path, an object, or as a spec already.

    A ``"module:object"`` is imported without a question, because the caller could import it, too. The command line,
    whose arguments may be copied from elsewhere, asks first.

    Args:
        policy: a name of :data:`POLICIES`, an ``.npz`` file, a Stable-Baselines3 ``.zip``, the id of a
            law (``"law:grounded"``) or a ``"module:object"`` that is called with the layout, or ``"name=pattern"``
            (such as ``"mine=runs/seed-*/policy.npz"``; in a dictionary also without the name), whose files are the
            training seeds of one policy, or one file per track where ``{track}`` stands for the name of its scenario;
            or a factory spec, or an object or class with ``predict``, whose class gives the name. Arguments of what is
            no file may follow in parentheses, as in ``"static(kappa=4)"``.
        trust: whether code that is stored in a ``.zip`` may be executed.

    Raises:
        ValueError: for an unknown name or argument, an object that is none of these, a ``"module:object"`` that cannot
            be imported, a file of another format, or a ``.zip`` that is not trusted.
        FileNotFoundError: when there is no such file, or a pattern matches none.
        PolicyFileError, ImportError: as :func:`ptne_env.learn.load` raises them.
    """
    if isinstance(policy, PolicySpec | FactorySpec):
        return policy if isinstance(policy, PolicySpec) else PolicySpec(str(policy), policy)
    if hasattr(policy, "predict"):
        return PolicySpec((policy if isinstance(policy, type) else type(policy)).__name__, policy)
    policy = str(policy) if isinstance(policy, Path) else policy
    if not isinstance(policy, str):
        raise ValueError(
            f"a policy is a string, an object with predict, or a PolicySpec, got {policy!r}: wrap a function that is "
            "called with the layout as PolicySpec(name, function)"
        )
    if policy in POLICIES:
        return POLICIES[policy]
    call, (name, separator, pattern) = read_call(policy), policy.partition("=")
    is_named = call is None and bool(separator and name) and "(" not in name and Path(name).name == name
    if is_named and not Path(policy).is_file():
        return PolicySpec(name, _specs_of_files(pattern, policy, trust=trust))
    if any(policy.endswith(each.endings) for each in FORMATS):
        specs = _specs_of_files(policy, policy, trust=trust)
        return PolicySpec(Path(policy).stem, specs if len(specs) > 1 else specs[0])
    if call is not None or ":" in policy:
        return PolicySpec(policy, FactorySpec.of(policy) if call is None else _with_arguments(*call))
    raise ValueError(unknown_name("policy", policy, POLICIES, "an .npz file or a 'module:object'"))


def _with_arguments(name: str, arguments: Mapping[str, Any]) -> FactorySpec:
    """Return the factory spec of a named policy with other arguments; ``ValueError`` for an unknown one."""
    source = get_policy_spec(name).training_seeds[0]
    if not isinstance(source, FactorySpec) or format_of(source):
        raise ValueError(f"policy {name!r} is a file and takes no arguments")
    known = [parameter for parameter in signature(resolve(source.target)).parameters if parameter != "layout"]
    for argument in arguments:
        require_name(f"argument of {name}", argument, known)
    return FactorySpec.of(source.target, **{**dict(source.arguments), **arguments})


def _specs_of_files(pattern: str, policy: str, *, trust: bool) -> tuple[FactorySpec, ...]:
    """Return the factory spec of each file that the pattern in a ``policy`` matches; one for one file per track."""
    is_one = TRACK in pattern or Path(pattern).is_file()
    paths = [pattern] if is_one else sorted(glob.glob(pattern))  # noqa: PTH207 - it may be absolute
    if not paths:
        raise FileNotFoundError(f"there is no file {pattern!r}" + f", which '{policy}' asks for" * (pattern != policy))
    return tuple(_spec_of_file(path, trust=trust) for path in paths)


def _spec_of_file(path: str, *, trust: bool) -> FactorySpec:
    """Return the factory spec of the policy in a file, or in one file per track."""
    for name in files_by_track(path).values() if TRACK in path else [path]:
        require_file(name)
    formats = [each for each in FORMATS if path.endswith(each.endings)]
    if not formats:
        raise ValueError(f"{path!r} is no policy: policy files end in .npz or .zip")
    if formats[0].executes_code and not require_flag("trust", trust):
        raise ValueError(
            f"loading {path!r} executes code that is stored in it; if you trust it, say trust=True (--trust on the "
            "command line)"
        )
    return formats[0].spec(path)
