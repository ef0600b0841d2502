"""The definition of a training run, and the records that a run leaves in its folder."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.evaluation.provenance import content_hash
from ptne_env.evaluation.tracks import find_track
from ptne_env.shared.arrays import require_count, require_positive, require_printable, require_probability
from ptne_env.shared.files import DamagedFileError, read_file, read_json, write_atomically
from ptne_env.shared.names import require_name
from ptne_env.training import TRAINERS

ALGORITHMS = tuple(name for name, trainer in TRAINERS.items() if trainer.unit == "agent-steps")
"""The algorithms of a configuration, which counts agent-steps."""

POLICY = "policy.npz"
"""The name of the file of a policy in the folder of its run."""


@dataclass(frozen=True)
class Configuration:
    """The definition of a training run. Agent-steps count every player of every environment.

    The defaults are those of PPO; :data:`~ptne_env.training.TRAINERS` has others of ``sb3-sac``, whose minibatches come
    from all that it remembers instead of from the last rollout.

    Attributes:
        scenario: the name of a scenario, of a track such as ``"ptne-v1/liar"``, or ``"module:object"``.
        algorithm: one of :data:`ALGORITHMS`.
        steps: the number of agent-steps.
        batch: the number of agent-steps between updates; as many environments are stepped together as make them.
        rollout: the number of steps of every environment between updates.
        minibatches: the number of minibatches per epoch.
        epochs: the number of passes over a rollout; of SAC, how often it learns from an agent-step on average.
        learning_rate: the learning rate at the start; it falls to 0 at the end, along a cosine, or with
            Stable-Baselines3 along a line.
        discount: γ, in [0, 1]. Digits are counted undiscounted, over the whole horizon.
        log_std: the initial logarithm of the actions' standard deviation, at most 0; of SAC, that of normal actions of
            the entropy at which it aims throughout.
        hidden: the number of units of each layer, of actor and critic alike; the last one has the memory, if any.
        seed: the seed of the network, the sampling and the training games.

    Raises:
        ValueError: naming the value that has a wrong type or is out of its range.
    """

    scenario: str
    algorithm: str = "ippo"
    steps: int = 20_000_000
    batch: int = 32_000
    rollout: int = 50
    minibatches: int = 32
    epochs: int = 1
    learning_rate: float = 3e-3
    discount: float = 0.7
    log_std: float = -1.5
    hidden: tuple[int, ...] = (64, 64)
    seed: int = 0

    def __post_init__(self) -> None:
        require_printable("scenario", self.scenario)
        require_name("algorithm", str(self.algorithm), ALGORITHMS)
        for name in ("steps", "batch", "rollout", "minibatches", "epochs"):
            require_count(name, getattr(self, name), 1)
        require_count("seed", self.seed, 0)
        require_positive("learning_rate", self.learning_rate)
        require_probability("discount", self.discount)
        log_std: Any = self.log_std
        if not (isinstance(log_std, int | float) and -20 <= log_std <= 0):
            raise ValueError(f"log_std must be from -20 to 0, got {log_std!r}")
        hidden: Any = self.hidden
        if not (isinstance(hidden, list | tuple) and hidden):
            raise ValueError(f"hidden must be a list of units, got {hidden!r}")
        object.__setattr__(self, "hidden", tuple(require_count("hidden", units, 1) for units in self.hidden))

    def environments(self, players: int) -> int:
        """Return the number of environments of so many players that learn, at least one."""
        return max(1, self.batch // (self.rollout * players))


def write_record(path: Path, record: Any) -> None:
    """Write a dataclass, such as the configuration or the summary of a run, as JSON."""
    write_atomically(path, json.dumps(_describe(record), indent=2) + "\n")


def _describe(record: Any) -> dict[str, Any]:
    """Return a dataclass as a JSON object; that of a run in a world of the user's module has the world, too."""
    described: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(record)))
    if ":" in described.get("scenario", ""):
        described["content of the scenario"] = content_hash(find_track(described["scenario"]).to_dict())
    return described


@dataclass(frozen=True)
class RunSummary:
    """The summary of a finished run.

    Attributes:
        agent_steps: the agent-steps of the whole run.
        resumed_at: the agent-steps (through the world: updates) after which the run was resumed last; 0 if it never
            was.
        seconds: the time of training since then.
        digits: the mean digits of the exported policy on the validation episodes; through the world, those of the
            training episodes that ended in the last tenth of the run.
    """

    agent_steps: int
    resumed_at: int
    seconds: float
    digits: float


def read_finished_run(configuration: Any, out: Path) -> RunSummary | None:
    """Read the summary of a finished run in a folder; ``None`` if it holds no run, or one that is unfinished.

    Raises:
        ValueError: when the folder holds a run of another ``configuration``, a dataclass.
    """
    path = out / "configuration.json"
    if not path.exists():
        return None
    theirs = read_json(path, "the configuration of a training run")
    mine = _describe(configuration)
    different = [name for name in sorted(mine.keys() | theirs.keys()) if mine.get(name) != theirs.get(name)]
    if different:
        differences = ", ".join(f"{name} is {theirs.get(name)} there and {mine.get(name)} here" for name in different)
        raise ValueError(f"{out} holds another run: {differences}; choose another folder, or remove this one")
    summary = out / "summary.json"
    if not (summary.exists() and (out / POLICY).exists()):
        return None
    return RunSummary(**read_json(summary, "the summary of a training run"))


def write_checkpoint(path: Path, arrays: Sequence[Any]) -> None:
    """Write all arrays of a run that goes on."""
    buffer = io.BytesIO()
    np.savez(buffer, *arrays)
    write_atomically(path, buffer.getvalue())


def read_checkpoint(path: Path, first: Sequence[Any]) -> Sequence[Any]:
    """Read the arrays of a checkpoint, or return those with which a run starts if there is none.

    Raises:
        DamagedFileError: when the file is damaged, or holds others; the lengths of arrays may differ.
    """
    if not path.exists():
        return first
    try:
        with np.load(io.BytesIO(read_file(path, largest=1 << 30))) as file:
            arrays = [file[name] for name in file.files]
    except Exception as error:  # zip files raise many classes
        raise DamagedFileError(f"{path} is damaged, or no checkpoint: remove it to start again ({error})") from error
    if [(each.shape[1:], each.dtype) for each in arrays] != [(each.shape[1:], each.dtype) for each in first]:
        raise DamagedFileError(f"{path} is the checkpoint of another run or version: remove it to start again")
    return arrays
