"""The output of commands: console, progress, JSON and files."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from json import dumps
from pathlib import Path

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Column
from rich.text import Text

from ptne_env.shared.files import require_writable, write_atomically

STDOUT = "-"
"""The value of ``--json`` for stdout."""


@dataclass
class Output:
    """Settings of the whole run; ``stdout`` is the descriptor of the real one while it is kept for JSON."""

    quiet: bool = False
    debug: bool = False
    stdout: int | None = None


output = Output()


class _PrintableConsole(Console):
    """A console that spells out escape sequences, so that no name, path or error can steer the terminal."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(_printable(segment.text), segment.style)


def _printable(text: str) -> str:
    """Return a text in which all characters but printable ones, blanks and ends of lines are written as in Python."""
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() or char in "\n\N{NO-BREAK SPACE}" else char.encode("unicode_escape").decode("ascii")
        for char in text
    )


def accept_all_characters() -> None:
    r"""Let stdout and stderr write a character that their encoding lacks as its code, such as ``\u03ba``."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def console(*, stderr: bool = False) -> Console:
    """Return a console on stdout or stderr."""
    stream = sys.stderr if stderr else sys.stdout
    return _PrintableConsole(
        stderr=stderr,
        width=None if stream.isatty() or "COLUMNS" in os.environ else 172,  # rich would cut tables to 80 columns
        quiet=not stderr and (output.quiet or output.stdout is not None),
        color_system=None if os.environ.get("NO_COLOR") else "auto",  # rich alone would still write bold and dim
    )


@contextmanager
def progress(description: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar with the remaining time on stderr, and yield what takes a description, the work done and all work."""
    with Progress(
        TextColumn("{task.description}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")),
        BarColumn(bar_width=20),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console(stderr=True),
        transient=True,
        expand=True,
        disable=output.quiet or not sys.stderr.isatty(),
        speed_estimate_period=600,  # with fewer than two steps in this time it shows no remaining time
    ) as bar:
        task = bar.add_task(description, total=None)
        yield lambda description, done, total: bar.update(task, description=description, completed=done, total=total)


def keep_stdout(context: typer.Context, value: str | None) -> str | None:
    """Send all other output to stderr for ``--json -``, including that of other code and processes."""
    if value == STDOUT and not context.resilient_parsing:
        output.stdout = os.dup(1)
        os.dup2(2, 1)
    return value


def write_json(target: str | None, content: object) -> None:
    """Write content, or a JSON text, to the value of ``--json``; NaN and Infinity are errors."""
    text = content if isinstance(content, str) else dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
    if target == STDOUT and output.stdout is not None:
        with os.fdopen(output.stdout, "w", encoding="utf-8", closefd=False) as stdout:
            stdout.write(text + "\n")
    elif target is not None:
        write_atomically(Path(target), text + "\n")


def check_writable(*targets: str | Path | None) -> None:
    """Raise an error before long work if a file cannot be written."""
    for target in targets:
        if target not in (None, STDOUT):
            require_writable(Path(target))


def this_command() -> str:
    """Return the command as it was given, which repeats what a page shows."""
    return shlex.join(["ptne", *sys.argv[1:]])


def say(text: str) -> None:
    """Print a line without wrapping it."""
    console().print(Text(text), soft_wrap=True)
