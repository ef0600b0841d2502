"""``ptne certify``: predictions before anything runs."""

from __future__ import annotations

from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from ptne_env import theory
from ptne_env.bench import report
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, console, json_text, say, write_json
from ptne_env.evaluation.policy_specs import foreign_code, law_factory, law_names
from ptne_env.evaluation.suite import find_scenario, foreign_suites


@app.command()
def certify(
    scenario: options.World,
    *,
    law: Annotated[
        str,
        typer.Option(
            help="A law by name (static, adaptive, corollary-one, gadjov-pavel, grounded), by its class in "
            "ptne_env.laws (FixedGain, Grounded, …), or as 'module:object', which is called with the layout and "
            "runs its own code.",
            autocompletion=law_names,
        ),
    ] = "static",
    kappa: Annotated[
        float | None, typer.Option(help="Consensus gain κ of the law; the law's own if left out (static: 2).")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Standard deviation σ of additive noise on every message, to be predicted.",
            show_default="the channel's",
        ),
    ] = None,
    delay: Annotated[
        int | None,
        typer.Option(min=0, help="Steps that every message is late, to be predicted.", show_default="the channel's"),
    ] = None,
    hold_steps: Annotated[int, typer.Option(min=0, help="Steps after the deadline, for the digits there.")] = 50,
    json: options.Json = None,
    trust: options.Trust = False,
) -> None:
    """Predict the result of a law on a scenario before anything runs.

    Prints the assumptions of the paper with the number that decides each, the gain condition, rates, the digits
    predicted at the deadline, the largest stable step, and the effect of noise and late messages. docs/theory.md
    explains which of them are exact and which are bounds.
    """
    check_writable(json)
    options.trusted([*foreign_suites(scenario), *foreign_code(law)], trust=trust)
    chosen = find_scenario(scenario)
    if hold_steps and chosen.gain > 0:
        chosen = chosen.replace(hold_steps=hold_steps)
    with threadpool_limits(1):  # on matrices of this size several BLAS threads wait for each other
        certificate = theory.certify(chosen, law=law_factory(law, kappa), noise_std=noise, delay_steps=delay)
    write_json(json, json_text(certificate.to_dict()))
    console().print(report.certificate_tables(certificate))
    if json is not None:
        say(f"Certificate written to {json}")
