"""Checkpoints of a training run: arrays and a JSON text, which execute no code when they are read."""

from __future__ import annotations

import io
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt
from pydantic.dataclasses import dataclass

from ptne_env.files import write_atomically
from ptne_env.training.arguments import STRICT, readable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from stable_baselines3 import PPO

_RECORD = "record"
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


def save(path: Path, model: PPO, record: Record) -> None:
    """Write the network, the state of its optimiser and the record.

    Raises:
        OSError: when the file cannot be written; the old one is untouched then.
    """
    arrays: dict[str, Any] = {name: tensor.numpy() for name, tensor in _tensors(model)}
    arrays[_RECORD] = np.array(json.dumps(asdict(record)))
    content = io.BytesIO()
    np.savez(content, **arrays)
    write_atomically(path, content.getvalue())


def read(path: Path) -> tuple[Record, dict[str, np.ndarray]]:
    """The record of a checkpoint, and its arrays for :func:`restore`.

    Raises:
        OSError: when the file cannot be read.
        ValueError: naming ``path``, when it is damaged or something else.
    """
    content = path.read_bytes()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = dict(file)
        return Record(**json.loads(str(arrays.pop(_RECORD)))), arrays
    except Exception as error:  # zip files raise many classes
        raise ValueError(f"{path} is damaged, or no checkpoint: remove it to train afresh ({error!r})") from error


def restore(model: PPO, arrays: dict[str, np.ndarray]) -> None:
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


def _tensors(model: PPO) -> Iterator[tuple[str, torch.Tensor]]:
    """The tensors by name: every parameter, and the state that Adam keeps of it, zero before the first step."""
    state = model.policy.optimizer.state
    for name, parameter in model.policy.named_parameters():
        value = parameter.detach()
        if not state[parameter]:
            state[parameter] = {"step": torch.zeros(()), **{moment: torch.zeros_like(value) for moment in _MOMENTS}}
        yield f"value/{name}", value
        yield from ((f"{moment}/{name}", tensor) for moment, tensor in state[parameter].items())
