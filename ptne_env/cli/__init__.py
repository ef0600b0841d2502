"""The command line ``ptne``: it calls the library and prints. One file per group of commands."""

try:
    import rich as _rich  # noqa: F401
    import typer as _typer  # noqa: F401
except ImportError as error:  # pragma: no cover - exercised in an environment without the extra
    raise SystemExit('the command line needs an extra: pip install "ptne-env[bench]"') from error

from ptne_env.cli import certify, compare, listing, render, reproduce, sweep, train  # noqa: F401 - they add commands
from ptne_env.cli.app import app as app
from ptne_env.cli.app import main as main
