"""Entries of comparisons: a name, a policy per training seed, and the interface that it acts through."""

from __future__ import annotations

import glob
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

from ptne_env.evaluation.provenance import file_hash
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError, describe
from ptne_env.shared.arrays import require_flag, require_printable
from ptne_env.shared.files import require_file
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import LOADER, FactorySpec, foreign_targets, resolve

PolicySource: TypeAlias = FactorySpec | Policy | Callable[[ObservationLayout], Policy]
"""A factory spec or a callable that builds the policy from a layout, or the policy itself."""

ARCHIVE = "ptne_env.learn.archive:load_archive"
"""Target of the policies in Stable-Baselines3 archives. It is no part: loading one executes code in the file."""

NO_LAWS = ("zero-input", "random")
"""Policies that seek nothing."""

_ENDINGS = (".onnx", ".npz")
"""Endings of files that are data."""

_LIBRARIES = {LOADER: ("onnxruntime",), ARCHIVE: ("stable_baselines3", "torch")}
"""The libraries that the policies in files compute with."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy of a comparison.

    Attributes:
        name: for tables and files.
        policy: a :class:`~ptne_env.shared.parts.FactorySpec` or a callable that builds the policy from a layout (such
            as the class of a law), or a policy itself, such as a Stable-Baselines3 model; or a tuple of these, one per
            training seed.
        interface: makes its observations and decodes its actions; its kind will do. What the policy declares as its
            attribute ``interface`` cannot be overridden; if it declares nothing and this is left out, it is ``scaled``.
        description: one sentence, for lists; no part of the policy.

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
        for source in self.training_seeds:
            if not (isinstance(source, FactorySpec) or callable(source) or hasattr(source, "predict")):
                raise ValueError(
                    f"policy {self.name!r} is {source!r}: give a FactorySpec, a class or function that is called with "
                    "the layout, or an object with predict; get_policy_spec('static') is the policy of a name"
                )
        given: Any = self.interface
        if not isinstance(given, Interface | None):
            object.__setattr__(self, "interface", Interface(given))  # which checks it
        declared = {_declared_interface(source) for source in self.training_seeds}
        if len(declared) > 1:
            raise ValueError(
                f"the training seeds of policy {self.name!r} have different interfaces: they are no one policy"
            )
        (own,), given = declared, self.interface
        if own is not None and given not in (None, own):
            raise ValueError(f"policy {self.name!r} declares the interface {own}: it cannot act through {given}")
        object.__setattr__(self, "interface", next(each for each in (own, given, Interface()) if each is not None))

    @property
    def training_seeds(self) -> tuple[PolicySource, ...]:
        """The policy of each training seed; one where nothing was trained."""
        return self.policy if isinstance(self.policy, tuple) else (self.policy,)

    @property
    def is_oracle(self) -> bool:
        """Whether it uses information that players lack."""
        return self.interface.kind == "full"

    @property
    def is_law(self) -> bool:
        """Whether it is a law of :data:`POLICIES`: no network, no oracle, and none that seeks nothing."""
        return self.name in POLICIES and not (self.files or self.is_oracle or self.name in NO_LAWS)

    @property
    def is_repeatable(self) -> bool:
        """Whether every training seed is a factory spec, so that another process can make it again."""
        return all(isinstance(source, FactorySpec) for source in self.training_seeds)

    @property
    def is_own(self) -> bool:
        """Whether any of it is the user's: an object, code from outside the library, or a file that does not ship."""
        foreign = not self.is_repeatable or any(map(foreign_targets, self.training_seeds))
        return foreign or any(Path(path).suffix for path in self.files)  # shipped files go by their names

    @property
    def files(self) -> list[str]:
        """The paths, or the names of shipped files, that policies are loaded from, one per training seed in a file."""
        return [path for path in map(_file_of, self.training_seeds) if path is not None]

    @property
    def libraries(self) -> tuple[str, ...]:
        """The libraries that it computes with, beside those that every result depends on."""
        return _LIBRARIES.get(getattr(self.training_seeds[0], "target", ""), ())

    def build(self, layout: ObservationLayout, training_seed: int = 0) -> Policy:
        """The policy of a training seed for a layout.

        Raises:
            LayoutError: when it was made for another layout.
            PolicyError: when building it raises anything else, or the result has no ``predict``.
        """
        source = self.training_seeds[training_seed]
        built: Any = source
        try:
            if isinstance(source, FactorySpec):
                built = source.build(layout=layout)
            elif isinstance(source, type) or not hasattr(source, "predict"):
                built = source(layout)
            _require_observations_of(layout, built)
            if hasattr(built, "with_layout"):  # one object plays many worlds
                built = built.with_layout(layout)
        except (LayoutError, MemoryError):
            raise
        except Exception as error:
            called = "; it is called with the layout" * isinstance(error, TypeError)
            raise PolicyError(f"it cannot be built: {describe(error)}{called}") from error
        if not hasattr(built, "predict"):
            made = "it is" if built is source else "called with the layout, it returned"
            raise PolicyError(f"{made} a {type(built).__name__} without predict(observation, state, ...)")
        policy: Policy = built
        return policy

    def to_dict(self) -> dict[str, Any]:
        """A JSON object with the parameters of every training seed, and the SHA-256 of its file."""
        return {
            "name": self.name,
            "interface": asdict(self.interface),
            "training_seeds": [_source_to_dict(source) for source in self.training_seeds],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PolicySpec:
        """The inverse of :meth:`to_dict` for a repeatable policy.

        Raises:
            ValueError: when a policy was an object of another process, or the data are no policy.
        """
        try:
            seeds = data["training_seeds"]
            if any("arguments" not in seed for seed in seeds):
                raise ValueError(f"policy {data['name']!r} was an object, no factory spec: nothing can make it again")
            sources = tuple(
                FactorySpec.from_dict({key: seed[key] for key in ("target", "arguments")}) for seed in seeds
            )
            interface = Interface(**data["interface"])
            return cls(data["name"], sources if len(sources) != 1 else sources[0], interface)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a policy: {type(error).__name__}: {error}") from None


def _require_observations_of(layout: ObservationLayout, model: Any) -> None:
    """Refuse a model of Stable-Baselines3 that was trained on other observations than a layout's."""
    expected = getattr(getattr(model, "observation_space", None), "shape", None)
    acts_for_all = (layout.num_players * layout.action_size,)  # in JointEnv, whatever the interface
    if expected != (layout.size,) and getattr(getattr(model, "action_space", None), "shape", None) == acts_for_all:
        raise LayoutError(
            "it was trained on the joint observation of all players, which no player has; train one policy for "
            "every player, on ptne_env.envs.sb3.PlayerVecEnv"
        )
    if expected not in (None, (layout.size,)):
        raise LayoutError(
            f"it was trained on observations of shape {expected}, and this track with the interface "
            f"{layout.interface.kind!r} has {(layout.size,)}; if it was trained with another interface, give that "
            "one: PolicySpec(name, model, ptne_env.Interface('physical'))"
        )


def _declared_interface(source: PolicySource) -> Interface | None:
    """The interface that a policy declares, as a class, as an object or in its file."""
    found: Any = source
    if isinstance(source, FactorySpec):
        found = source.build() if source.target in _LIBRARIES else resolve(source.target)
    declared: Any = getattr(found, "interface", None)
    is_kind = isinstance(declared, str)
    return Interface(declared) if is_kind else declared


def _file_of(source: PolicySource) -> str | None:
    """The path, or the name of a shipped file, that a policy is loaded from."""
    if not isinstance(source, FactorySpec) or source.target not in _LIBRARIES:
        return None
    return str(dict(source.arguments)["path" if source.target == ARCHIVE else "path_or_name"])


def _source_to_dict(source: PolicySource) -> dict[str, Any]:
    if isinstance(source, FactorySpec):
        path = _file_of(source)
        return {**source.to_dict(), "sha256": path and file_hash(_shipped_file(path))}
    named = source if isinstance(source, type) else type(source)
    return {"object": f"{named.__module__}:{named.__qualname__}"}


def _shipped_file(path_or_name: str) -> Path:
    """The path of a policy's file: of a shipped one by its name."""
    shipped = (Path(__file__).parents[1] / "learn" / f"{path_or_name}{ending}" for ending in _ENDINGS)
    return next((path for path in shipped if path.is_file()), Path(path_or_name))


def _entry(target: str, description: str, **arguments: Any) -> tuple[str, str, dict[str, Any]]:
    return target, description, arguments


def _network(scenario: str) -> tuple[str, str, dict[str, Any]]:
    return _entry(LOADER, f"A network that PPO trained on {scenario}.", path_or_name=f"ppo-{scenario}")


def _recurrent(name: str, where: str) -> tuple[str, str, dict[str, Any]]:
    sentence = f"A network with memory that was trained through the world, {where}."
    return _entry(LOADER, sentence, path_or_name=f"recurrent-{name}")


_COMPARED = {
    "static": _entry("law:static", "The paper's static law: down the own cost, and towards the neighbours.", kappa=2.0),
    "adaptive": _entry(
        "law:adaptive",
        "The paper's adaptive law: the gain of a link grows as long as its two players disagree.",
        gamma=0.01,
        initial_gain=0.5,
    ),
    "corollary-one": _entry("law:corollary-one", "The static law without the time gain, with a large κ.", kappa=10.0),
    "gadjov-pavel": _entry("law:corollary-one", "Gadjov and Pavel's law: Corollary 1 with κ = 1.", kappa=1.0),
    "grounded": _entry(
        "law:grounded",
        "Ye and Hu's law: estimates follow the neighbours, and the own strategy follows the own cost alone.",
        kappa=2.0,
    ),
    "zero-input": _entry("law:zero-input", "Does nothing: strategies stay at the start."),
    "random": _entry("law:random", "Random inputs.", seed=0),
    "oracle": _entry("law:oracle", "Moves all estimates to the equilibrium, which players do not know, at once."),
    "routed-unknown": _entry(
        "law:routed-unknown",
        "Copies news of each player from the neighbours that have them first, and takes gradient steps.",
        step=0.3,
    ),
    "observer-relay": _entry(
        "law:observer-relay",
        "The contact relay that filters noise and rounding, weighs neighbours by their errors, and expects reactions.",
    ),
    "ppo-random-energy": _network("random-energy"),
}
_OTHERS = {
    "ppo-ptne-v1": _network("ptne-v1"),
    "recurrent-random-worlds": _recurrent("random-worlds", "in 38 worlds outside of the suites"),
    "static-tuned": _entry("law:static", "The static law with tuned weights.", kappa=2.2, gradient_gain=2.94),
    "adaptive-grounded": _entry(
        "law:adaptive-grounded",
        "Ye and Hu's adaptive law: the grounded law, with gains that every player tunes by itself.",
        gamma=0.0001,
        initial_gain=3.0,
    ),
    "projected-gradient": _entry(
        "law:projected-gradient",
        "Bianchi and Grammatico's discrete law: average with the neighbours, then take a gradient step.",
        step=0.47,
        mixing=0.357,
    ),
    "contact-relay": _entry(
        "law:contact-relay",
        "Copies news as routed-unknown, and takes best responses by an identified model of the own gradient.",
        patience=12.6,
        forgetting=5.89,
    ),
    "residual-coder": _entry(
        "law:residual-coder",
        "The observer relay among players who tell each other small digits in code, where all of them understand it.",
    ),
    "proximal-best-response": _entry(
        "law:proximal-best-response",
        "Bianchi, Belgioioso and Grammatico's law: proximal best responses, and averages with neighbours.",
        step=4.0,
        mixing=0.45,
    ),
}
_SPECIALISTS = {
    f"recurrent-{name}": _recurrent(name, "in games of this scenario")
    for name in ("random-energy-switching", "random-energy-switching-transformed")
}
_TABLE = _COMPARED | _OTHERS | _SPECIALISTS
"""By name: the part, a sentence, and the arguments."""

COMPARED = tuple(_COMPARED)
"""The default policies on scenarios: laws of the paper, references, the strongest laws, learned policies."""

ENTERED = (*_COMPARED, *_OTHERS)
"""The default policies on a suite: all but networks that were trained in one scenario, which are slow elsewhere."""


class _Policies(Mapping[str, PolicySpec]):
    """The named policies. Each is made when it is asked for: nothing of the field or of learning is imported before."""

    def __getitem__(self, name: str) -> PolicySpec:
        return _named_policy(name)

    def __iter__(self) -> Iterator[str]:
        return iter(_TABLE)

    def __len__(self) -> int:
        return len(_TABLE)

    def __contains__(self, name: object) -> bool:
        return name in _TABLE


@cache
def _named_policy(name: str) -> PolicySpec:
    target, description, arguments = _TABLE[name]
    return PolicySpec(name, FactorySpec.of(target, **arguments), description=description)


POLICIES: Mapping[str, PolicySpec] = _Policies()
"""The laws, reference policies and learned policies by name, in the order in which tables list them."""


def get_policy_spec(policy: Any, *, trust: bool = False) -> PolicySpec:
    """A policy by name, file, part, ``"module:object"`` or ``"name=pattern"``, or as it is.

    A string of the caller is code of the caller: a ``"module:object"`` is imported without a question. The command
    line, whose strings may be copied from elsewhere, asks first.

    Args:
        policy: a name of :data:`POLICIES`, an ``.onnx`` or ``.npz`` file, a Stable-Baselines3 ``.zip``, the id of a
            law (``"law:grounded"``) or a ``"module:object"`` that is called with the layout, or ``"name=pattern"``
            (such as ``"mine=runs/seed-*/policy.onnx"``), whose files are the training seeds of one policy; or an object
            or class with ``predict``, whose class gives the name.
        trust: whether code that is stored in a ``.zip`` may be executed.

    Raises:
        ValueError: for an unknown name, an object that is no string and no spec, an object that cannot be imported, a
            file of another kind, or a ``.zip`` that is not trusted.
        FileNotFoundError: also for a pattern without files.
        PolicyFileError, ImportError: as :func:`ptne_env.learn.load`.
    """
    if isinstance(policy, PolicySpec):
        return policy
    if hasattr(policy, "predict"):
        return PolicySpec((policy if isinstance(policy, type) else type(policy)).__name__, policy)
    if not isinstance(policy, str):
        raise ValueError(
            f"a policy is a string, an object with predict, or a PolicySpec, got {policy!r}: wrap a function that is "
            "called with the layout as PolicySpec(name, function)"
        )
    if policy in POLICIES:
        return POLICIES[policy]
    name, separator, pattern = policy.partition("=")
    if separator and name and Path(name).name == name and not Path(policy).is_file():
        found = sorted(glob.glob(pattern))  # noqa: PTH207 - it may be absolute
        if not found:
            raise FileNotFoundError(f"there is no file {pattern!r}, which '{policy}' asks for")
        return PolicySpec(name, tuple(_file(path, trust=trust) for path in found))
    if Path(policy).suffix in (*_ENDINGS, ".zip"):
        return PolicySpec(Path(policy).stem, _file(policy, trust=trust))
    if ":" in policy:
        return PolicySpec(policy, FactorySpec.of(policy))
    raise ValueError(unknown_name("policy", policy, POLICIES, "an .onnx or .npz file or a 'module:object'"))


def _file(path: str, *, trust: bool) -> FactorySpec:
    """The spec of the policy in a file."""
    require_file(path)
    if path.endswith(_ENDINGS):
        return FactorySpec.of(LOADER, path_or_name=path)
    if not path.endswith(".zip"):
        raise ValueError(f"{path!r} is no policy: policy files end in .onnx, .npz or .zip")
    if not require_flag("trust", trust):
        raise ValueError(
            f"loading {path!r} executes code that is stored in it; if you trust it: "
            f"ptne_env.evaluation.get_policy_spec({path!r}, trust=True)"
        )
    return FactorySpec.of(ARCHIVE, path=path)
