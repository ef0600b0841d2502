"""``ptne certify``: predict the result of a law before anything runs."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.text import Text
from threadpoolctl import threadpool_limits

from ptne_env import theory
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, console, say, write_json
from ptne_env.evaluation import POLICIES


@app.command()
def certify(
    scenario: options.ScenarioArgument,
    *,
    law: Annotated[
        str,
        typer.Option(
            "--law",
            "--policy",
            help="A law by name, such as static or static(kappa=4), or a 'module:object', which runs its own code and "
            "is called with the layout.",
            autocompletion=lambda: list(POLICIES),
        ),
    ] = "static",
    changes: options.SetOption = None,
    json: options.JsonOption = None,
    trust: options.TrustOption = False,
) -> None:
    """Predict the result of a law on a scenario before anything runs.

    Prints the assumptions of the paper with the number that decides each, the law's own condition, the rate, the digits
    predicted at the deadline, and the largest stable step. docs/theory.md explains which of them are exact.
    """
    check_writable(json)
    trust = options.require_trust(options.foreign_names(scenario, law), trust=trust)
    world = options.read_scenario(scenario, changes, trust=trust)
    with threadpool_limits(1):  # on matrices of this size several BLAS threads wait for each other
        certificate = theory.certify(world, law=law)
    write_json(json, certificate.to_dict())
    table = Text(str(certificate))
    table.highlight_regex(r"(?P<green>\bholds\b)|(?P<red>\bfails\b)")
    console().print(table, soft_wrap=True)
    if json is not None:
        say(f"Certificate written to {json}")
