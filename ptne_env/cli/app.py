"""The application: options of every command, errors and exit codes."""

from __future__ import annotations

import os
import sys
from enum import IntEnum
from typing import Annotated

import typer
from rich.text import Text

from ptne_env._version import __version__
from ptne_env.cli.console import accept_all_characters, console, output
from ptne_env.shared.files import DamagedFileError


class ExitCode(IntEnum):
    """The exit code for each kind of fault."""

    FAILED = 1
    """A policy or a worker failed."""
    ERROR = 2
    """An unknown command, option or name, a value out of range (typer uses it too), or any error without a code."""
    FILE = 3
    """A file is missing or damaged, or cannot be read or written."""
    LIBRARY = 4
    """A library is missing."""
    INTERRUPTED = 130
    """Ctrl-C."""


app = typer.Typer(
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # so that the paragraphs of docstrings fill the width of the terminal
    help="Prescribed-time Nash-equilibrium seeking: compare policies with the analytical laws of Feng and Hu's paper, "
    "and certify scenarios beforehand.",
)


def _version(value: bool) -> None:  # noqa: FBT001 - typer's callback signature
    if value:
        typer.echo(f"ptne_env {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[  # noqa: ARG001, FBT002 - handled by its callback
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Annotated[  # noqa: FBT002 - a flag
        bool, typer.Option("--quiet", "-q", help="Print only errors, and the JSON of '--json -'.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,  # noqa: FBT002 - a flag
) -> None:
    """Options of every command."""
    output.quiet, output.debug = quiet, debug


def main() -> None:
    """Run the command line; docs/usage.md explains the exit codes."""
    accept_all_characters()
    os.environ["PYTHONSAFEPATH"] = "1"  # processes that it starts do not import modules of the current folder either
    try:
        app(prog_name="ptne")
    except SystemExit as ended:
        if ended.code == ExitCode.INTERRUPTED:
            console(stderr=True).print("Interrupted: all files are complete, and the same command goes on from them")
            sys.stdout.flush()
            os._exit(ended.code)  # the usual end would destroy the client of XLA while its threads still compile for it
        raise
    except (ConnectionError, ChildProcessError) as error:
        _fail(str(error), ExitCode.FAILED)
    except OSError as error:  # its own message has the number of an error of the operating system
        _fail(str(error) if error.filename is None else f"{str(error.filename)!r}: {error.strerror}", ExitCode.FILE)
    except DamagedFileError as error:
        _fail(str(error), ExitCode.FILE)
    except ValueError as error:
        _fail(str(error), ExitCode.ERROR)
    except ImportError as error:
        _fail(str(error), ExitCode.LIBRARY)
    except Exception as error:  # noqa: BLE001 - the traceback of any error is shown on request only
        message = "\n".join([f"{type(error).__name__}: {error}", *getattr(error, "__notes__", ())])
        hint = "" if output.debug else "\n'ptne --debug' before the command shows where it comes from"
        _fail(message + hint, ExitCode.ERROR)


def _fail(message: str, code: ExitCode) -> None:
    screen = console(stderr=True)
    if output.debug:
        screen.print_exception()
    text = Text("Error: ", style="bold red").append(message, style="not bold default")
    screen.print(text, soft_wrap=not screen.is_terminal)
    raise SystemExit(code)
