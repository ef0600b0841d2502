"""Names that do not exist: one message for all of them, with the names that were probably meant."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches

_SYMBOLS = {"T": "deadline", "c": "gain", "K": "steps", "N": "players"}
"""Arguments by their symbols in the paper."""


def require_name(kind: str, name: str, known: Collection[str], otherwise: str = "") -> str:
    """Return a name of a ``kind`` that is known, or raise ``ValueError`` with the message of :func:`unknown_name`."""
    if name not in known:
        raise ValueError(unknown_name(kind, name, known, otherwise))
    return name


def unknown_name(kind: str, name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the message that a name of a ``kind``, such as "scenario", does not exist; see :func:`suggestion`."""
    return f"unknown {kind} {name!r}; {suggestion(name, known, otherwise)}"


def suggestion(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the second half of the message: up to three similar names, or the first thirty where none is.

    Capitals do not count, ``_`` is ``-``, and a name may be the beginning or, after ``/``, the end of the meant one.
    There may be another way to say it ``otherwise``, such as "an .npz file".
    """
    if name == "seed":
        return "a seed is an argument of reset, evaluate and training, such as reset(seed=3)"
    choices, asked = list(known), _plain(name)
    if (meant := _SYMBOLS.get(name)) in choices:
        return f"did you mean {meant!r}?"
    parts = {part: choice for choice in choices for part in (_plain(choice), _plain(choice).rpartition("/")[2])}
    similar = [*get_close_matches(asked, parts), *(part for part in parts if name and part.startswith(asked))]
    near = list(dict.fromkeys(repr(parts[part]) for part in similar))[:3]
    if near:
        return f"did you mean {' or '.join(filter(None, (', '.join(near[:-1]), near[-1])))}?"
    listed = ", ".join(choices[:30]) + ", …" * (len(choices) > 30)
    return f"choose from {listed}" + f", or {otherwise}" * bool(otherwise)


def _plain(name: object) -> str:
    return str(name).lower().replace("_", "-")
