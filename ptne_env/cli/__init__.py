"""The command line ``ptne``: it calls the library and prints. One file per group of commands."""

import sys

try:
    import rich as _rich  # noqa: F401
    import typer as _typer  # noqa: F401
except ImportError as error:  # pragma: no cover - exercised in an environment without the extra
    sys.stderr.write('Error: the command line needs an extra: pip install "ptne-env[bench]"\n')
    raise SystemExit(4) from error  # ExitCode.LIBRARY, which is out of reach

from ptne_env.cli import certify, compare, listing, render, train  # noqa: F401 - they add commands
from ptne_env.cli.app import app as app
from ptne_env.cli.app import main as main
