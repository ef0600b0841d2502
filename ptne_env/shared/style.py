"""Colours of pages and pictures, and the style of everything that matplotlib draws."""

from __future__ import annotations

import io
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#c46a9b", "#b58900", "#2f93cf", "#8c6bb1", "#7f7f7f", "#a0522d", "#e7298a",
)  # fmt: skip
"""Colours of players and policies in turn, distinct for colour-blind readers, with contrast 3:1 on white and black."""

LIGHT: Mapping[str, str] = MappingProxyType({
    "ground": "#ffffff", "panel": "#f6f7f9", "ink": "#1a1d21", "faint": "#5b6470", "line": "#d5dae1",
    "grid": "#e4e8ed", "accent": "#0b5cad",
})  # fmt: skip
"""Colours of a page by role; letters have contrast 4.5:1 on ``ground`` and ``panel``. Pictures use them too."""

DARK: Mapping[str, str] = MappingProxyType({
    "ground": "#14171b", "panel": "#1d2126", "ink": "#e8eaed", "faint": "#a3adb9", "line": "#3a424c",
    "grid": "#2b3138", "accent": "#7db8f2",
})  # fmt: skip
"""Colours of a dark page by role."""

INK, FAINT, GRID = (LIGHT[role] for role in ("ink", "faint", "grid"))

_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": "medium",
    "axes.labelsize": "medium",
    "axes.edgecolor": FAINT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": "small",
    "lines.linewidth": 1.3,
    "mathtext.fontset": "dejavusans",
    "svg.hashsalt": "ptne_env",  # the same picture gives the same file
    "pdf.fonttype": 42,  # journals refuse matplotlib's own kind of font
}

PRINT: Mapping[Any, Any] = MappingProxyType({"font.size": 8, "lines.linewidth": 1.2, "savefig.dpi": 300})
"""The style of a figure in one column of a paper."""


@contextmanager
def drawing(purpose: str, changes: Mapping[Any, Any] = MappingProxyType({})) -> Iterator[None]:
    """Let matplotlib draw in the style of this library in a ``with`` block.

    Ctrl-C waits for the end of the block, because matplotlib turns a ``KeyboardInterrupt`` into a ``ValueError`` where
    it draws a path, and loses it where it forgets an artist.

    Without matplotlib it is an ``ImportError`` that names the extra, and the ``purpose``, such as ``"figures"``. The
    ``changes`` are rcParams that differ, such as ``{"font.size": 11}``.
    """
    try:
        from matplotlib import rc_context
    except ImportError as error:
        raise ImportError(f'{purpose} need matplotlib: pip install "ptne-env[bench]"') from error
    with _delay_ctrl_c(), rc_context({**_STYLE, **changes}):
        yield


def printed_axes(rows: int, height: float) -> Any:
    """Return the axes of a new figure, one column of a paper wide and ``height`` inches high, with a shared x-axis."""
    from matplotlib.figure import Figure  # without pyplot, which would keep the figure

    figure = Figure(figsize=(3.5, height), layout="constrained")
    return figure.subplots(rows, sharex=True, height_ratios=[3, 2][:rows])


def encode(figure: Any, kind: str, **options: Any) -> bytes:
    """Return a figure as the content of a file of a kind, such as ``"pdf"``; the same figure gives the same bytes.

    Options are those of ``Figure.savefig``.
    """
    buffer = io.BytesIO()
    when = {"pdf": "CreationDate", "svg": "Date", "png": "Software"}[kind]
    with drawing("figures", PRINT):
        figure.savefig(buffer, format=kind, metadata={when: None}, **options)
    return buffer.getvalue()


@contextmanager
def _delay_ctrl_c() -> Iterator[None]:
    """Delay Ctrl-C to the end of a ``with`` block, because Python may lose it where it forgets matplotlib's artists."""
    if threading.current_thread() is not threading.main_thread():  # others never see Ctrl-C
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)
