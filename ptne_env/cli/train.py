"""``ptne train``: training a policy for one interface, one without sizes, or one for a track from such a one."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, json_text, progress, say, write_json
from ptne_env.evaluation.suite import foreign_suites, world_names
from ptne_env.learn import training

if TYPE_CHECKING:
    from ptne_env.learn.training import generalist
    from ptne_env.learn.training.arguments import Arguments
    from ptne_env.learn.training.checkpoint import Summary
    from ptne_env.learn.training.curve import LearningCurve


@app.command()
def train(
    configuration: Annotated[
        str,
        typer.Argument(
            help="A shipped configuration by name (such as random-energy), or a .toml file; or a scenario or track "
            "(such as robots or ptne-v1/noise) for the default settings, and with --from.",
            autocompletion=training.all_configurations,
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
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Policy without sizes, by file or name, that is fine-tuned on the scenario or track; "
            f"{training.GENERALIST!r} is the shipped one, {training.SHIPPED!r}.",
        ),
    ] = None,
    json: options.Json = None,
    *,
    trust: options.Trust = False,
) -> None:
    """Train a policy and export it as policy.onnx: with PPO, or without sizes, or from such a policy (--from).

    Draws the learning curve, learning-curve.png, and prints the commands that compare the policy and show the logs.

    An interrupted run goes on from its last checkpoint when the same command is given again, and ends with the same
    policy as an undisturbed one.
    """
    try:
        from ptne_env.learn.training.checkpoint import finished
        from ptne_env.learn.training.curve import LearningCurve, Run, draw
    except ImportError as error:
        raise ImportError('training needs an extra: pip install "ptne-env[sb3]"') from error

    given = {"seed": seed, "steps": steps}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    arguments, unit = _arguments(configuration, start, changes)
    options.trusted(foreign_suites(*arguments.scenarios), trust=trust)
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
        draw(drawn, picture, title=f"Training of {configuration.removesuffix('.toml')}", unit=unit)
        say(f"Learning curve written to {picture}")
    for line in next_commands(
        arguments.scenarios, out, runs, has_seeds=seeds is not None, start=getattr(arguments, "start", "")
    ):
        say(line)


def _arguments(
    configuration: str, start: str | None, changes: dict[str, Any]
) -> tuple[Arguments | generalist.Generalist, str]:
    """The arguments of a run, and the unit of its progress."""
    from ptne_env.learn.training import arguments, generalist

    if start is None and configuration == training.SPECIALIST:
        raise ValueError(f"a specialist starts from a policy: ptne train TRACK --from {training.SHIPPED} --out DIR")
    if start is not None:
        is_configuration = Path(configuration).suffix == ".toml" or configuration in training.all_configurations()
        if is_configuration and configuration not in world_names():
            raise ValueError(
                f"--from fine-tunes on a scenario or track, such as ptne-v1/noise, and {configuration!r} is a "
                "configuration; a .toml file of your own may say start = 'POLICY'"
            )
        changes |= {"scenarios": (configuration,), "start": training.SHIPPED if start == training.GENERALIST else start}
        configuration = training.SPECIALIST
    elif "stages" not in arguments.values_of(configuration)[1]:
        return arguments.from_toml(arguments.Arguments, configuration, **changes), "agent-steps"
    if "steps" in changes:
        raise ValueError(
            "--steps counts agent-steps of PPO; a policy without sizes trains for rounds, segments and generations, "
            "which a .toml file of your own may change"
        )
    return arguments.from_toml(generalist.Generalist, configuration, **changes), "segments of training"


def _train(
    runs: Mapping[Path, Arguments | generalist.Generalist], curves: Mapping[Path, LearningCurve]
) -> dict[Path, Summary]:
    """Train one run after the other, with a progress bar for all of them; their summaries."""
    from ptne_env.learn.training import generalist, ppo

    summaries: dict[Path, Summary] = {}
    with progress("training") as advance:
        for folder, arguments in runs.items():
            place = "" if len(runs) == 1 else f"seed {arguments.seed}, "
            curve = curves[folder]

            def show(
                done: int,
                total: int,
                digits: float,
                stage: str = "training",
                place: str = place,
                curve: LearningCurve = curve,
            ) -> None:
                curve.add(done, digits)
                now = stage if isnan(digits) else f"{stage}, {digits:.2f} digits"
                advance(len(summaries) * total + min(done, total), len(runs) * total, place + now)

            if isinstance(arguments, generalist.Generalist):
                summaries[folder] = generalist.train(arguments, folder, show)
            else:
                summaries[folder] = ppo.train(arguments, folder, show)
    return summaries


def _say_result(folder: Path, summary: Summary, *, was_finished: bool) -> None:
    digits = f"{summary.validation_digits:.2f} digits on the validation episodes"
    if summary.stage_digits:
        digits += f" ({summary.stage_digits[0]:.2f} before training)"
    if was_finished:
        say(f"This run has ended before, with {digits}; policy.onnx is in {folder}")
    else:
        parts = "" if summary.parts == 1 else f", in {summary.parts} parts"
        say(f"{digits}, after {summary.seconds:.0f} s{parts}; policy.onnx written to {folder}")


def next_commands(
    scenarios: Sequence[str], out: Path, folders: Iterable[Path], *, has_seeds: bool, start: str = ""
) -> list[str]:
    """The commands that compare the policy where it was trained, and that show the logs.

    It is compared with the policy with which training started, or with the paper's law.
    """
    match sorted({name.rpartition("/")[0] for name in scenarios}):
        case [_]:
            where = " ".join(scenarios)
        case ["", suite]:
            where = f"--suite {suite}"
        case _:  # trained in random worlds, or on tracks of several suites
            where = "--suite ptne-v1"
    trained = f"trained={out}/seed-*/policy.onnx" if has_seeds else str(out / "policy.onnx")
    other = f"start={start}" if start.endswith(".onnx") else start or "static"
    lines = [f"To compare:  ptne compare {where} --policy {shlex.quote(f'{other},{trained}')}"]
    if any((folder / "tensorboard").is_dir() for folder in folders):
        lines.append(f"To see the logs:  tensorboard --logdir {shlex.quote(str(out))}")
    return lines
