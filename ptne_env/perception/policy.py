"""The signature of every policy, and the base class of policies that decide row by row."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from traceback import extract_tb
from types import MappingProxyType
from typing import Any, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.shared.files import DamagedFileError


class PolicyError(RuntimeError):
    """A policy raised an error, answered in another form, or broke a rule of the protocol."""


class PolicyFileError(DamagedFileError):
    """A file holds no policy of this library, is damaged, or was made by another version."""


def describe(error: BaseException) -> str:
    """Return class, message and place of an error that foreign code raised, in printable characters."""
    text = f"{type(error).__name__}: {error}"[:500]
    if frames := extract_tb(error.__traceback__):
        text += f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"
    return "".join(character if character.isprintable() else " " for character in text)


class RunningPolicy:
    """A policy in a batch of episodes that start together. Its memory is passed back to it unread."""

    def __init__(self, policy: Policy) -> None:
        self._policy, self._is_first = policy, True
        self._memory: Any = None

    def decide(self, observations: Float32Array) -> Any:
        """Return deterministic actions for observations, shape (R, size).

        Raises:
            PolicyError: when ``predict`` takes other arguments, or does not return a pair.
        """
        arguments = observations, self._memory, np.full(len(observations), self._is_first)
        try:
            answer = self._policy.predict(*arguments, deterministic=True)
        except TypeError:
            try:
                signature(self._policy.predict).bind(*arguments, deterministic=True)
            except TypeError as error:
                raise PolicyError(
                    f"expected predict(observation, state, episode_start, deterministic): {error}"
                ) from error
            raise
        actions, self._memory = pair(answer, "predict returns (actions, state)")
        self._is_first = False
        return actions


def pair(answer: Any, expected: str) -> tuple[Any, Any]:
    """Return the answer of a user's code if it is a pair; else raise ``PolicyError`` with what was ``expected``."""
    if not (isinstance(answer, tuple | list) and len(answer) == 2):
        got = f"{len(answer)} values" if isinstance(answer, tuple | list) else f"a {type(answer).__name__} alone"
        raise PolicyError(f"{expected}, got {got}")
    return answer[0], answer[1]


@runtime_checkable
class Policy(Protocol):
    """Stable-Baselines3's ``predict``: SB3 models are policies, and SB3's tools accept laws as models."""

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Return actions for observations, batched over the leading axis.

        Args:
            observation: the observations of R players in any number of environments, shape (R, size), or that of one
                player, shape (size,).
            state: the memory that the previous call returned, opaque to callers; ``None`` at first.
            episode_start: where True, that row's memory starts afresh; shape (R,).
            deterministic: whether a stochastic policy takes its mode.

        Returns:
            Actions of shape (R, action size), float32, and the memory for the next call.
        """
        ...


class RowPolicy(ABC):
    """A policy that decides each row of observations from that row and its own memory alone.

    A subclass implements :meth:`decide`.
    """

    made_for: Mapping[str, Any] = MappingProxyType({})
    """The attributes, by name, that an :class:`ObservationLayout` must have for the policy to act."""

    def with_layout(self, layout: ObservationLayout) -> Self:
        """Return the policy itself; ``LayoutError`` where the layout differs from :attr:`made_for`, naming where."""
        pairs = [(name, own, getattr(layout, name)) for name, own in self.made_for.items()]
        if differences := [f"{name}: policy {own}, environment {other}" for name, own, other in pairs if own != other]:
            raise LayoutError(f"the policy was made for another layout; {'; '.join(differences)}")
        return self

    def select_rows(self, mask: BoolArray, fresh: Any, old: Any) -> Any:
        """Return the memory with the players of ``fresh`` in a mask, shape (R,), and those of ``old`` elsewhere.

        Memory is an array with a row per player, a tuple of memories, or ``None``; a subclass with other memory has its
        own method.
        """
        if isinstance(old, tuple):
            parts = [self.select_rows(mask, *pair) for pair in zip(fresh, old, strict=True)]
            return old._make(parts) if hasattr(old, "_make") else tuple(parts)
        return None if old is None else np.where(mask.reshape(-1, *(1,) * (np.ndim(old) - 1)), fresh, old)

    @abstractmethod
    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:
        """Return actions and memory as :meth:`Policy.predict`, for observations of R players, shape (R, size).

        ``starts`` is its ``episode_start``, shape (R,), here never ``None``.
        """

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[Float32Array, Any]:
        """Return the actions for observations, and the memory, as :meth:`Policy.predict`; ``ValueError`` for shapes."""
        array = np.asarray(observation, dtype=np.float32)
        rows = array[None] if array.ndim == 1 else array
        size = self.made_for.get("size", rows.shape[-1])
        if rows.ndim != 2 or rows.shape[1] != size:
            raise ValueError(
                f"this policy was built for observations of length {size} (one row, or one per player), got the shape "
                f"{array.shape}"
            )
        count = len(rows)
        starts = np.zeros(count, np.bool_) if episode_start is None else np.asarray(episode_start, np.bool_).reshape(-1)
        if len(starts) != count:
            raise ValueError(f"episode_start has the shape {starts.shape}, and the {count} rows need ({count},)")
        actions, state = self.decide(rows, state, starts, deterministic=deterministic)
        actions = np.asarray(actions, dtype=np.float32)
        return (actions[0] if array.ndim == 1 else actions), state


BLOCK = 32
"""Rows in a block: twice the smallest batch, 16, from which on torch's products have the same bits in every batch, and
a multiple of the numbers in a vector register, at most 16."""


Function: TypeAlias = Callable[[Float32Array, Any, BoolArray, bool], tuple[Any, Any]]
"""``function(rows, memory, starts, deterministic) -> (actions, memory)``, as :meth:`RowPolicy.decide`."""


class NetworkPolicy(RowPolicy):
    """A policy that decides by a function, such as a network, which gets whole blocks of rows, the last rows 0.

    So each row has the same result in every batch. Libraries of linear algebra take other code for small batches, and
    for the last numbers of an array that fill no vector register, which changes the last bits of a row's result.

    Args:
        function: decides for the rows.
        made_for: the attributes that a layout must have; an ``interface`` among them becomes that of the policy.
        name: the name of the network, such as that of its file without the ending.
    """

    def __init__(self, function: Function, made_for: Mapping[str, Any] = RowPolicy.made_for, name: str = "") -> None:
        self._function, self.made_for, self.name = function, made_for, name
        self.interface: Interface | None = made_for.get("interface")

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:
        """Return the actions and the memory, which has whole blocks of rows; see :meth:`RowPolicy.decide`."""
        count = len(rows)
        if missing := -count % BLOCK:
            rows = np.concatenate([rows, np.zeros((missing, rows.shape[1]), np.float32)])
            starts = np.concatenate([starts, np.zeros(missing, np.bool_)])
        actions, memory = self._function(rows, memory, starts, deterministic)
        return actions[:count], memory

    def select_rows(self, mask: BoolArray, fresh: Any, old: Any) -> Any:  # noqa: ARG002 - it can select no rows
        """Return ``None``, if there is no memory; ``ValueError`` if there is, whose form only the function knows."""
        if old is not None:
            raise ValueError("the memory of a network of another library cannot be kept for some players alone")
        return None
