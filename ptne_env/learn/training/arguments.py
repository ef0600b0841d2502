"""The definition of a training run, checked when it is made."""

from __future__ import annotations

import dataclasses
import functools
import reprlib
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, PositiveInt, ValidationError
from pydantic.dataclasses import dataclass

from ptne_env.bench.suite import world_names
from ptne_env.learn.training import CONFIGURATIONS, configurations
from ptne_env.perception.observation import InterfaceKind
from ptne_env.shared.files import DamagedFileError, require_file
from ptne_env.shared.names import unknown_name

STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
"""No value is converted to another type, no name is unknown, and numbers are finite."""

WORD = 2**32
"""Seeds of episodes hold the seed and the agent-steps of a run as words of 32 bits."""

_Class = TypeVar("_Class")


def readable(checked: type[_Class]) -> type[_Class]:
    """A class decorator: a pydantic dataclass raises a ``ValueError`` of one line, with the name and the value."""
    check = checked.__init__

    @functools.wraps(check)
    def init(self: _Class, *arguments: Any, **named: Any) -> None:
        try:
            check(self, *arguments, **named)
        except ValidationError as error:
            names = [field.name for field in dataclasses.fields(checked)]  # type: ignore[arg-type]
            raise ValueError(_message(error, names)) from None

    setattr(checked, "__init__", init)  # noqa: B010 - mypy forbids the assignment
    return checked


def _message(error: ValidationError, names: list[str]) -> str:
    """One clause for each wrong value and each unknown name."""
    unknown, clauses = [], []
    for detail in error.errors(include_url=False):
        first, *inner = detail["loc"]
        if isinstance(first, int) and first < len(names):  # given by position
            first = names[first]
        name = ".".join(map(str, [first, *inner]))
        if detail["type"].startswith("unexpected_"):
            unknown.append(name)
        elif detail["type"] == "missing":
            clauses.append(f"{name} is missing")
        elif detail["type"] == "too_short" and detail["input"]:
            continue  # pydantic counts valid items alone, and the others have clauses of their own
        else:  # the message is such as "Input should be greater than 0" or "Tuple should have at least 1 item"
            expected = detail["msg"].split(" ", 2)[-1].replace("valid tuple", "list")
            clauses.append(f"{name} must {expected}, got {reprlib.repr(detail['input'])}")
    clauses += [unknown_name("argument", name, sorted(names)) for name in sorted(unknown)]
    return "; ".join(clauses)


def as_tuple(value: Any) -> Any:
    """A tuple of a list, which files hold, and of a single name."""
    return (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


_Share = Annotated[float, Field(ge=0, le=1)]


@readable
@dataclass(frozen=True, config=STRICT)
class Arguments:
    """The definition of a training run. Agent-steps count every player of every environment.

    Attributes:
        scenarios: names of scenarios or families of games, or tracks such as ``"ptne-v1/delay"``. Several share the
            environments evenly; their layouts must agree.
        interface: ``"scaled"`` or ``"physical"``.
        steps: agent-steps of training, below 2^32.
        envs: environments stepped together, of all scenarios.
        rollout: steps of every environment between updates.
        minibatches: per epoch.
        epochs: passes over a rollout.
        learning_rate: at the start, in (0, 1]; it falls linearly to 0 at the end.
        discount: γ of PPO, in [0, 1]. Returns are reported undiscounted, over the whole horizon.
        trace: λ of generalised advantage estimation, in [0, 1].
        clip: of the probability ratio, in (0, 1].
        hidden: units of each tanh layer, of actor and critic alike.
        products: whether the networks also see :class:`~ptne_env.learn.training.features.Products`.
        log_std: initial logarithm of the actions' standard deviation, in [-20, 5].
        seed: of the network, the sampling and the training games, below 2^32.
        validation_episodes: held-out games on which the result is measured.
        checkpoint_rollouts: rollouts from one checkpoint to the next. The environments start new episodes at each, so
            rollout × checkpoint_rollouts should be a multiple of the length of an episode.

    Raises:
        ValueError: when an argument has another type or is out of its range, naming it and its value.
    """

    scenarios: Annotated[tuple[str, ...], Field(min_length=1), BeforeValidator(as_tuple)]
    interface: InterfaceKind = "scaled"
    steps: Annotated[int, Field(gt=0, lt=WORD)] = 6_000_000
    envs: PositiveInt = 128
    rollout: PositiveInt = 50
    minibatches: PositiveInt = 32
    epochs: PositiveInt = 5
    learning_rate: Annotated[float, Field(gt=0, le=1)] = 1e-3
    discount: _Share = 0.9
    trace: _Share = 0.9
    clip: Annotated[float, Field(gt=0, le=1)] = 0.2
    hidden: Annotated[tuple[PositiveInt, ...], BeforeValidator(as_tuple)] = (64, 64)
    products: bool = True
    log_std: Annotated[float, Field(ge=-20, le=5)] = -2.0
    seed: Annotated[int, Field(ge=0, lt=WORD)] = 0
    validation_episodes: PositiveInt = 200
    checkpoint_rollouts: PositiveInt = 24

    @classmethod
    def from_toml(cls, name_or_path: str | Path, **changes: Any) -> Arguments:
        """The arguments of a shipped configuration, or of a TOML file; see :func:`from_toml`."""
        return from_toml(cls, name_or_path, **changes)


def from_toml(kind: type[_Class], name_or_path: str | Path, **changes: Any) -> _Class:
    """The arguments of a shipped configuration, or of a TOML file, with some of them changed.

    Args:
        kind: the class of the arguments.
        name_or_path: of the configuration, or the name of a scenario or track, on which all arguments are the defaults.
        **changes: arguments by name.

    Raises:
        ValueError: for an unknown configuration, a file that is not TOML, or an argument that is unknown, of another
            type or out of its range.
        FileNotFoundError: when there is no such file.
    """
    path, values = values_of(name_or_path)
    try:
        return kind(**values | changes)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def values_of(name_or_path: str | Path) -> tuple[Path, dict[str, Any]]:
    """The file of a configuration, and its values, which are not checked; a scenario or track is the only value.

    Raises:
        ValueError: for an unknown configuration, or a file that is not TOML.
        FileNotFoundError: when there is no such file.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = CONFIGURATIONS / f"{name_or_path}.toml"
        if not path.is_file():
            if ":" in str(name_or_path) or str(name_or_path) in world_names():
                return path, {"scenarios": [str(name_or_path)]}
            raise ValueError(unknown_name("configuration", str(name_or_path), configurations(), "a .toml file"))
    require_file(path)
    try:
        return path, tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFileError(f"{path} is not a TOML file: {error}") from error
