"""``ptne train``: training a policy for one interface, one without sizes, or one for a track from such a one."""

from __future__ import annotations

from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import Annotated, Any

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
            help="A shipped configuration by name (such as random-energy), or a .toml file; with --from a scenario, "
            "or a track such as ptne-v1/noise.",
            autocompletion=training.all_configurations,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the policy, logs and checkpoints; made if missing.")],
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of network, sampling and training games; the configuration's own if left out."),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps; the configuration's own if left out.")] = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--from", help="Policy without sizes, by file or name, that is fine-tuned on the scenario or track."
        ),
    ] = None,
    json: options.Json = None,
    *,
    trust: options.Trust = False,
) -> None:
    """Train a policy and export it as policy.onnx: with PPO, or without sizes, or from such a policy (--from).

    An interrupted run goes on from its last checkpoint when the same command is given again, and ends with the same
    policy as an undisturbed one.
    """
    try:
        from ptne_env.training import generalist, ppo
        from ptne_env.training.arguments import Arguments, from_toml, values_of
        from ptne_env.training.checkpoint import finished
    except ImportError as error:
        raise ImportError('training needs an extra: pip install "ptne-env[sb3]"') from error

    check_writable(json, out / "policy.onnx")
    given = {"seed": seed, "steps": steps}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    arguments: Arguments | generalist.Generalist
    if start is not None:
        changes |= {"scenarios": (configuration,), "start": start}
        arguments = from_toml(generalist.Generalist, "specialist", **changes)
    elif "stages" in values_of(configuration)[1]:
        arguments = from_toml(generalist.Generalist, configuration, **changes)
    else:
        arguments = from_toml(Arguments, configuration, **changes)
    options.trusted(foreign_suites(*arguments.scenarios), trust=trust)
    was_finished = finished(arguments, out) is not None
    with progress("training") as advance:

        def show(done: int, total: int, digits: float, stage: str = "training") -> None:
            advance(done, total, stage if isnan(digits) else f"{stage}, {digits:.2f} digits")

        if isinstance(arguments, Arguments):
            summary = ppo.train(arguments, out, show)
        else:
            summary = generalist.train(arguments, out, show)
    write_json(json, json_text(asdict(summary)))
    digits = f"{summary.validation_digits:.2f} digits on the validation episodes"
    if was_finished:
        say(f"This run has ended before, with {digits}; policy.onnx is in {out}")
    else:
        parts = "" if summary.parts == 1 else f", in {summary.parts} parts"
        say(f"{digits}, after {summary.seconds:.0f} s{parts}; policy.onnx written to {out}")
