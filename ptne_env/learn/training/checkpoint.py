"""Checkpoints of a training run: arrays and a JSON text, which execute no code when they are read."""

from __future__ import annotations

import io
import json
import reprlib
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
import torch
from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt
from pydantic.dataclasses import dataclass

from ptne_env.learn.training.arguments import STRICT, readable
from ptne_env.shared.files import read_json, write_atomically

if TYPE_CHECKING:
    from collections.abc import Iterator

    from _typeshed import DataclassInstance
    from stable_baselines3.common.policies import BasePolicy

CHECKPOINT = "checkpoint.npz"
"""The file of a checkpoint in the folder of a run."""

_RECORD = "record"
_POLICY, _SUMMARY = "policy.onnx", "summary.json"
_ANOTHER_FOLDER = "choose another folder, or remove this one to start afresh"
_MOST = 3
"""The most arguments that a message shows."""

_MOMENTS = ("exp_avg", "exp_avg_sq")
"""The arrays that Adam keeps of each parameter, beside the number of its steps."""


@readable
@dataclass(frozen=True, config=STRICT)
class Record:
    """The numbers of a run beside its network.

    Attributes:
        arguments: of the run, as a JSON object.
        agent_steps: done so far.
        seconds: of training so far, in all parts; the time from the last checkpoint of a part to its interruption is
            not known.
        parts: times that the run was started: 1, and 1 more for each time that it was resumed.
    """

    arguments: dict[str, Any]
    agent_steps: NonNegativeInt
    seconds: NonNegativeFloat
    parts: PositiveInt


@readable
@dataclass(frozen=True, config=STRICT)
class Summary(Record):
    """The record of a finished run.

    Attributes:
        validation_digits: mean digits of the exported policy on the validation episodes.
    """

    validation_digits: float


_Record = TypeVar("_Record", bound=Record)


class Learner(Protocol):
    """Anything with a policy of Stable-Baselines3, which holds network and optimiser."""

    @property
    def policy(self) -> BasePolicy:
        """Network and optimiser."""


def plain(arguments: DataclassInstance) -> dict[str, Any]:
    """The arguments of a run as they are read from a JSON file."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(arguments)))
    return values


def require_same(arguments: DataclassInstance, theirs: dict[str, Any], out: Path) -> None:
    """Check that the run in a folder has these arguments.

    Raises:
        ValueError: when it has others, naming them.
    """
    mine = plain(arguments)
    different = sorted(name for name in mine.keys() | theirs.keys() if theirs.get(name) != mine.get(name))
    if different:
        names = [f"{name} is {_shown(theirs, name)} there and {_shown(mine, name)} here" for name in different[:_MOST]]
        more = f", and {len(different) - _MOST} more differ" if len(different) > _MOST else ""
        raise ValueError(f"{out} holds another run: {', '.join(names)}{more}; {_ANOTHER_FOLDER}")


def _shown(values: dict[str, Any], name: str) -> str:
    return reprlib.repr(values[name]) if name in values else "missing"


def finished(arguments: DataclassInstance, out: Path) -> Summary | None:
    """The summary of the finished run in a folder; ``None`` while there is no summary or no policy.

    Raises:
        ValueError: when it was a run with other arguments, or the summary is damaged.
    """
    path = out / _SUMMARY
    if not path.exists() or not (out / _POLICY).exists():
        return None
    values = read_json(path, "the summary of a training run")
    try:
        summary = Summary(**values)
    except ValueError as error:
        raise ValueError(f"{path} is not the summary of a training run: {error}") from error
    require_same(arguments, summary.arguments, out)
    return summary


def finish(out: Path, policy: bytes, record: Record, digits: float) -> Summary:
    """Write the exported policy and the summary of a run, and remove its checkpoint.

    Args:
        out: folder of the run.
        policy: content of its file.
        record: of the run.
        digits: of the policy on validation.
    """
    write_atomically(out / _POLICY, policy)
    values = {each.name: getattr(record, each.name) for each in fields(Record)}
    summary = Summary(**values, validation_digits=digits)
    write_atomically(out / _SUMMARY, json.dumps(asdict(summary), indent=2) + "\n")
    (out / CHECKPOINT).unlink(missing_ok=True)
    return summary


def save(path: Path, model: Learner, record: Record) -> None:
    """Write the network, the state of its optimiser and the record.

    Raises:
        OSError: when the file cannot be written; the old one is untouched then.
    """
    arrays: dict[str, Any] = {name: tensor.numpy() for name, tensor in _tensors(model)}
    arrays[_RECORD] = np.array(json.dumps(asdict(record)))
    content = io.BytesIO()
    np.savez(content, **arrays)
    write_atomically(path, content.getvalue())


def read(path: Path, kind: type[_Record] = Record) -> tuple[_Record, dict[str, np.ndarray]]:  # type: ignore[assignment]
    """The record of a checkpoint, which is of this class, and its arrays for :func:`restore`.

    Raises:
        OSError: when the file cannot be read.
        ValueError: naming ``path``, when it is damaged or something else, or of a run of another kind.
    """
    content = path.read_bytes()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = dict(file)
        record: dict[str, Any] = json.loads(str(arrays.pop(_RECORD)))
        is_of_this_kind = record.keys() == {each.name for each in fields(kind)}
        if is_of_this_kind or not {each.name for each in fields(Record)} <= record.keys():
            return kind(**record), arrays
    except Exception as error:  # zip files raise many classes
        raise ValueError(f"{path} is damaged, or no checkpoint: remove it to train afresh ({error!r})") from error
    raise ValueError(
        f"{path} is of a run that trains another kind of policy, or of another version of the library; "
        f"{_ANOTHER_FOLDER}"
    )


def restore(model: Learner, arrays: dict[str, np.ndarray]) -> None:
    """Write the arrays of a checkpoint into the network and the state of its optimiser.

    Raises:
        ValueError: when names, shapes or types of the arrays differ from those of the model; nothing is written then.
    """
    tensors = dict(_tensors(model))
    expected = {name: (tuple(tensor.shape), tensor.numpy().dtype) for name, tensor in tensors.items()}
    if {name: (array.shape, array.dtype) for name, array in arrays.items()} != expected:
        raise ValueError("the checkpoint does not fit the network: remove it to train afresh")
    for name, tensor in tensors.items():
        tensor.copy_(torch.from_numpy(arrays[name]))


def _tensors(model: Learner) -> Iterator[tuple[str, torch.Tensor]]:
    """The tensors by name: every parameter, and the state that Adam keeps of it, zero before the first step."""
    state = model.policy.optimizer.state
    for name, parameter in model.policy.named_parameters():
        value = parameter.detach()
        if not state[parameter]:
            state[parameter] = {"step": torch.zeros(()), **{moment: torch.zeros_like(value) for moment in _MOMENTS}}
        yield f"value/{name}", value
        yield from ((f"{moment}/{name}", tensor) for moment, tensor in state[parameter].items())
