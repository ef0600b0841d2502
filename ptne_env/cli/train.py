"""``ptne train``: training a policy with PPO."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, json_text, progress, say, write_json
from ptne_env.evaluation.entries import foreign_names
from ptne_env.learn import training

if TYPE_CHECKING:
    from ptne_env.learn.training.arguments import Arguments
    from ptne_env.learn.training.checkpoint import Summary
    from ptne_env.learn.training.curve import LearningCurve


@app.command()
def train(
    configuration: Annotated[
        str,
        typer.Argument(
            help="A shipped configuration by name (such as random-energy), or a .toml file; or a scenario or track "
            "(such as robots or ptne-v1/noise) for the default settings.",
            autocompletion=training.configurations,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(help="Folder for the policy, the learning curve, logs and checkpoints; made if missing."),
    ],
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of network, sampling and training games; the configuration's own if left out."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Train this many seeds, one after the other: --seed and the next ones, each in its folder "
            "DIR/seed-SEED.",
        ),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps; the configuration's own if left out.")] = None,
    json: options.Json = None,
    *,
    trust: options.Trust = False,
) -> None:
    """Train a policy with PPO, and export it as policy.onnx.

    Draws the learning curve, learning-curve.png, and prints the commands that compare the policy and show the logs.

    An interrupted run goes on from its last checkpoint when the same command is given again, and ends with the same
    policy as an undisturbed one.
    """
    try:
        from ptne_env.learn.training.arguments import Arguments
        from ptne_env.learn.training.checkpoint import finished
        from ptne_env.learn.training.curve import LearningCurve, Run, draw
    except ImportError as error:
        raise ImportError('training needs an extra: pip install "ptne-env[sb3]"') from error

    given = {"seed": seed, "steps": steps}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    arguments = Arguments.from_toml(configuration, **changes)
    options.trusted(foreign_names(*arguments.scenarios), trust=trust)
    runs = {out: arguments}
    if seeds is not None:
        series = [replace(arguments, seed=arguments.seed + index) for index in range(seeds)]
        runs = {out / f"seed-{each.seed}": each for each in series}
    picture = out / "learning-curve.png"
    check_writable(json, picture, *(folder / "policy.onnx" for folder in runs))
    ended = [folder for folder, each in runs.items() if finished(each, folder) is not None]
    curves = {folder: LearningCurve(folder) for folder in runs}
    summaries = _train(runs, curves)
    found = [asdict(summary) for summary in summaries.values()]
    write_json(json, json_text(found[0] if seeds is None else found))
    for folder, summary in summaries.items():
        _say_result(folder, summary, was_finished=folder in ended)
    reached = [summary.validation_digits for summary in summaries.values()]
    if seeds is not None:
        mean = sum(reached) / len(reached)
        say(f"Mean of {seeds} seeds: {mean:.2f} digits, from {min(reached):.2f} to {max(reached):.2f}")
    drawn = {
        f"seed {each.seed}": Run(curve.points, digits)
        for each, curve, digits in zip(runs.values(), curves.values(), reached, strict=True)
        if curve.points
    }
    if drawn and (len(ended) < len(runs) or not picture.exists()):
        draw(drawn, picture, title=f"Training of {configuration.removesuffix('.toml')}", unit="agent-steps")
        say(f"Learning curve written to {picture}")
    for line in next_commands(arguments.scenarios, out, runs, has_seeds=seeds is not None):
        say(line)


def _train(runs: Mapping[Path, Arguments], curves: Mapping[Path, LearningCurve]) -> dict[Path, Summary]:
    """Train one run after the other, with a progress bar for all of them; their summaries."""
    from ptne_env.learn.training import ppo

    summaries: dict[Path, Summary] = {}
    with progress("training") as advance:
        for folder, arguments in runs.items():
            place = "" if len(runs) == 1 else f"seed {arguments.seed}, "
            curve = curves[folder]

            def show(
                done: int,
                total: int,
                digits: float,
                place: str = place,
                curve: LearningCurve = curve,
            ) -> None:
                curve.add(done, digits)
                now = f"{place}training, {digits:.2f} digits"
                advance(len(summaries) * total + min(done, total), len(runs) * total, now)

            summaries[folder] = ppo.train(arguments, folder, show)
    return summaries


def _say_result(folder: Path, summary: Summary, *, was_finished: bool) -> None:
    digits = f"{summary.validation_digits:.2f} digits on the validation episodes"
    if was_finished:
        say(f"This run has ended before, with {digits}; policy.onnx is in {folder}")
    else:
        parts = "" if summary.parts == 1 else f", in {summary.parts} parts"
        say(f"{digits}, after {summary.seconds:.0f} s{parts}; policy.onnx written to {folder}")


def next_commands(scenarios: Sequence[str], out: Path, folders: Iterable[Path], *, has_seeds: bool) -> list[str]:
    """The commands that compare the policy with the paper's law where it was trained, and that show the logs."""
    match sorted({name.rpartition("/")[0] for name in scenarios}):
        case [_]:
            where = " ".join(scenarios)
        case ["", suite]:
            where = f"--suite {suite}"
        case _:  # trained in random worlds, or on tracks of several suites
            where = "--suite ptne-v1"
    trained = f"trained={out}/seed-*/policy.onnx" if has_seeds else str(out / "policy.onnx")
    lines = [f"To compare:  ptne compare {where} --policy {shlex.quote(f'static,{trained}')}"]
    if any((folder / "tensorboard").is_dir() for folder in folders):
        lines.append(f"To see the logs:  tensorboard --logdir {shlex.quote(str(out))}")
    return lines
