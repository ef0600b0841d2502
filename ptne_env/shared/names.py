"""Names that do not exist: one message for all of them, with the names that were probably meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

_LIKE = 0.6
"""Likeness, between 0 and 1, from which on a name was probably meant."""

_SUGGESTIONS = 3


def unknown_name(kind: str, name: str, known: Iterable[str], otherwise: str = "") -> str:
    """The message that a name does not exist, with similar names, or all where none is similar.

    Args:
        kind: of the name, such as "scenario".
        name: as in :func:`suggestion`.
        known: likewise.
        otherwise: likewise.
    """
    return f"unknown {kind} {name!r}; {suggestion(name, known, otherwise)}"


def suggestion(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """The second half of the message: similar names, or all where none is similar.

    Capitals do not count, ``_`` is ``-``, and a name may be the beginning or, after ``/``, the end of the meant one.

    Args:
        name: that was asked for.
        known: all names of that kind.
        otherwise: another way to say it, such as "a .toml file".
    """
    if name == "seed":
        return "a seed is an argument of reset, evaluate and training, such as reset(seed=3)"
    choices = list(known)
    likeness = {choice: _likeness(_plain(name), _plain(choice)) for choice in choices}
    near = sorted((choice for choice in choices if likeness[choice] >= _LIKE), key=lambda choice: -likeness[choice])
    if near:
        return f"did you mean {_alternatives(map(repr, near[:_SUGGESTIONS]))}?"
    return f"choose from {', '.join(choices)}" + f", or {otherwise}" * bool(otherwise)


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")


def _likeness(name: str, choice: str) -> float:
    """From 0, nothing in common, to 1, the same."""
    whole, end = (SequenceMatcher(None, name, text).ratio() for text in (choice, choice.rpartition("/")[2]))
    return max(whole, end, _LIKE if name and choice.startswith(name) else 0.0)


def _alternatives(texts: Iterable[str]) -> str:
    """Texts as in "a, b or c"."""
    *first, last = texts
    return f"{', '.join(first)} or {last}" if first else last
