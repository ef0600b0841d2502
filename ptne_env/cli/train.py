"""``ptne train``: training a policy with PPO."""

from __future__ import annotations

from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import Annotated

import typer

from ptne_env import training
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, json_text, progress, say, write_json
from ptne_env.experiments.suite import foreign_suites


@app.command()
def train(
    configuration: Annotated[
        str,
        typer.Argument(
            help="A shipped configuration by name (such as random-energy), or a .toml file.",
            autocompletion=training.configurations,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the policy, logs and checkpoints; made if missing.")],
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of network, sampling and training games; the configuration's own if left out."),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps; the configuration's own if left out.")] = None,
    json: options.Json = None,
    *,
    trust: options.Trust = False,
) -> None:
    """Train a policy with PPO and export it as policy.onnx.

    An interrupted run goes on from its last checkpoint when the same command is given again, and ends with the same
    policy as an undisturbed one.
    """
    try:
        from ptne_env.training import ppo
        from ptne_env.training.arguments import Arguments
    except ImportError as error:
        raise ImportError('training needs an extra: pip install "ptne-env[sb3]"') from error

    check_writable(json, out / "policy.onnx")
    given = {"seed": seed, "steps": steps}
    changes = {name: value for name, value in given.items() if value is not None}
    arguments = Arguments.from_toml(configuration, **changes)
    options.trusted(foreign_suites(*arguments.scenarios), trust=trust)
    finished = ppo.finished(arguments, out) is not None
    with progress("training", arguments.steps) as advance:

        def show(done: int, total: int, digits: float) -> None:
            advance(done, total, "training" if isnan(digits) else f"training, {digits:.2f} digits gained")

        summary = ppo.train(arguments, out, show)
    write_json(json, json_text(asdict(summary)))
    digits = f"{summary.validation_digits:.2f} digits on the validation episodes"
    if finished:
        say(f"This run has ended before, with {digits}; policy.onnx is in {out}")
    else:
        parts = "" if summary.parts == 1 else f", in {summary.parts} parts"
        say(f"{digits}, after {summary.seconds:.0f} s{parts}; policy.onnx written to {out}")
