"""The signature of every policy, analytic or learned."""

from __future__ import annotations

from inspect import signature
from pathlib import Path
from traceback import extract_tb
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from ptne_env.shared.arrays import BoolArray, Float32Array

_LONGEST_DESCRIPTION = 500


class PolicyError(RuntimeError):
    """A policy failed: it raised an error, answered in another form, or broke a rule of the protocol."""


def describe(error: BaseException) -> str:
    """Class, message and place of an error of foreign code, in printable characters."""
    text = _printable(f"{type(error).__name__}: {error}")
    if frames := extract_tb(error.__traceback__):
        text += _printable(f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})")
    return text


def _printable(text: str) -> str:
    """The beginning of a text of foreign code, with blanks for all characters that are not printable."""
    beginning = text[:_LONGEST_DESCRIPTION]
    return "".join(character if character.isprintable() else " " for character in beginning)


def decision(policy: Policy, observation: Float32Array, state: Any, episode_start: BoolArray) -> tuple[Any, Any]:
    """The deterministic answer of a policy: actions, and the memory for the next call; arguments as of ``predict``.

    Raises:
        PolicyError: when the answer is no pair.
    """
    try:
        answer = policy.predict(observation, state, episode_start, deterministic=True)
    except TypeError:
        try:
            signature(policy.predict).bind(observation, state, episode_start, deterministic=True)
        except TypeError as error:
            raise PolicyError(f"expected predict(observation, state, episode_start, deterministic): {error}") from error
        raise
    return pair(answer, "predict returns (actions, state)")


def pair(answer: Any, expected: str) -> tuple[Any, Any]:
    """An answer of a user's code that must be a pair.

    Raises:
        PolicyError: when it is something else; the error says what is ``expected``.
    """
    if not (isinstance(answer, tuple | list) and len(answer) == 2):
        found = f"{len(answer)} values" if isinstance(answer, tuple | list) else f"a {type(answer).__name__} alone"
        raise PolicyError(f"{expected}, got {found}")
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
        """Actions for observations, batched over the leading axis.

        Args:
            observation: of R players (in any number of environments), shape (R, size), or of one player, shape (size,).
            state: the memory that the previous call returned; ``None`` at first. Opaque to callers.
            episode_start: where True, that row's memory starts afresh; shape (R,).
            deterministic: whether a stochastic policy takes its mode.

        Returns:
            Actions of shape (R, action size), float32, and the memory for the next call.
        """
        ...
