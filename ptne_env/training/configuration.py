"""The definition of a training run, checked when it is made."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ptne_env.shared.arrays import require_count, require_positive, require_printable, require_probability
from ptne_env.shared.files import DamagedFileError, read_json, require_file, write_atomically
from ptne_env.shared.names import unknown_name
from ptne_env.suites.suite import world_names
from ptne_env.training import CONFIGURATIONS, configurations


@dataclass(frozen=True)
class Configuration:
    """The definition of a training run. Agent-steps count every player of every environment.

    Attributes:
        scenario: name of a scenario or family of games, of a track such as ``"ptne-v1/liar"``, or ``"module:object"``.
        steps: agent-steps of training.
        envs: environments stepped together.
        rollout: steps of every environment between updates.
        minibatches: per epoch.
        epochs: passes over a rollout.
        learning_rate: at the start; it falls linearly to 0 at the end.
        discount: γ of PPO, in [0, 1]. Digits are counted undiscounted, over the whole horizon.
        log_std: initial logarithm of the actions' standard deviation, at most 0.
        hidden: units of each tanh layer, of actor and critic alike.
        seed: of the network, the sampling and the training games.

    Raises:
        ValueError: when a value has another type or is out of its range, naming it.
    """

    scenario: str
    steps: int = 2_000_000
    envs: int = 128
    rollout: int = 50
    minibatches: int = 32
    epochs: int = 1
    learning_rate: float = 1.5e-3
    discount: float = 0.7
    log_std: float = -2.0
    hidden: tuple[int, ...] = (64, 64)
    seed: int = 0

    def __post_init__(self) -> None:
        require_printable("scenario", self.scenario)
        for name in ("steps", "envs", "rollout", "minibatches", "epochs"):
            require_count(name, getattr(self, name), 1)
        require_count("seed", self.seed, 0)
        require_positive("learning_rate", self.learning_rate)
        require_probability("discount", self.discount)
        require_probability("-log_std / 20", -self.log_std / 20)
        if not isinstance(self.hidden, list | tuple):
            raise ValueError(f"hidden must be a list of units, got {self.hidden!r}")
        object.__setattr__(self, "hidden", tuple(require_count("hidden", units, 1) for units in self.hidden))

    @classmethod
    def from_toml(cls, name_or_path: str | Path, **changes: Any) -> Configuration:
        """A shipped configuration, or one of a TOML file, with some values changed.

        Args:
            name_or_path: of the configuration, or the name of a scenario or track, for which all others are the
                defaults.
            **changes: values by name.

        Raises:
            ValueError: for an unknown configuration, a file that is not TOML, or a value that is unknown, of another
                type or out of its range.
            FileNotFoundError: when there is no such file.
        """
        values = _values(str(name_or_path)) | changes
        names = [field.name for field in dataclasses.fields(cls)]
        for name in values:
            if name not in names:
                raise ValueError(f"{name_or_path}: {unknown_name('value', name, names)}")
        if "scenario" not in values:
            raise ValueError(f"{name_or_path}: scenario is missing")
        try:
            return cls(**values)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name_or_path}: {error}") from error


def _values(name: str) -> dict[str, Any]:
    """The values of a configuration, which are not checked."""
    path = Path(name)
    if path.suffix != ".toml":
        if name not in configurations():
            if ":" in name or name in world_names():
                return {"scenario": name}
            raise ValueError(unknown_name("configuration", name, [*configurations(), *world_names()], "a .toml file"))
        path = CONFIGURATIONS / f"{name}.toml"
    require_file(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFileError(f"{path} is not a TOML file: {error}") from error


SUMMARY, CONFIGURATION = "summary.json", "configuration.json"
"""Names of two files of a run."""


def write_record(path: Path, record: Any) -> None:
    """Write a dataclass, the configuration or the summary of a run, as JSON."""
    write_atomically(path, json.dumps(dataclasses.asdict(record), indent=2) + "\n")


@dataclass(frozen=True)
class Summary:
    """A finished run.

    Attributes:
        agent_steps: done.
        resumed_at: agent-steps, through the world updates, at which the run was resumed last; 0 for an uninterrupted
            one.
        seconds: of training since then.
        digits: mean digits of the exported policy on the validation episodes; through the world, of the training
            episodes that ended in the last tenth of the run.
    """

    agent_steps: int
    resumed_at: int
    seconds: float
    digits: float


def finished(configuration: Any, out: Path, policy: str) -> Summary | None:
    """The summary of the finished run of a configuration, a dataclass, with the file of its policy in a folder, if any.

    Raises:
        ValueError: when it holds a run of another configuration.
    """
    path = out / CONFIGURATION
    if not path.exists():
        return None
    theirs = read_json(path, "the configuration of a training run")
    mine: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(configuration)))
    different = [name for name in sorted(mine.keys() | theirs.keys()) if mine.get(name) != theirs.get(name)]
    if different:
        differences = ", ".join(f"{name} is {theirs.get(name)} there and {mine.get(name)} here" for name in different)
        raise ValueError(f"{out} holds another run: {differences}; choose another folder, or remove this one")
    if not ((out / SUMMARY).exists() and (out / policy).exists()):
        return None
    return Summary(**read_json(out / SUMMARY, "the summary of a training run"))
