"""``ptne train``: train a policy with PPO on JAX, with PPO or SAC of Stable-Baselines3, or through the world."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from ptne_env import training
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, progress, say, write_json
from ptne_env.evaluation.comparison import LAW
from ptne_env.evaluation.tracks import find_track
from ptne_env.shared.names import require_name

if TYPE_CHECKING:
    from ptne_env.training.configuration import Configuration, RunSummary
    from ptne_env.training.through_world import Settings

    Run: TypeAlias = Configuration | Settings


@app.command()
def train(
    scenario: options.ScenarioArgument,
    algorithm: Annotated[
        str,
        typer.Option(
            help="ippo (independent PPO), ippo-rnn (with a recurrent unit), mappo-rnn (its critic sees the state), "
            "sb3-ppo and sb3-sac (PPO and SAC of Stable-Baselines3), or through-world (by gradients through the "
            "world).",
            autocompletion=lambda: list(training.TRAINERS),
        ),
    ] = "ippo",
    out: Annotated[Path, typer.Option(help="Folder for the policy, the learning curve and checkpoints.")] = Path(
        "trained"
    ),
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="SETTING=VALUE",
            help="Change a setting, such as learning_rate=0.001 or hidden=[128,128]; repeat for several. "
            "docs/learning.md says where they are explained.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the network, sampling and training games.")] = 0,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Train with this many seeds, --seed and the next ones, one after the other, each in its own folder "
            "DIR/seed-SEED.",
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of agent-steps, rounded up to whole rollouts, or of updates of the weights through the world.",
            show_default="20 million agent-steps, 2 million with sb3-sac, or 800 updates",
        ),
    ] = None,
    json: options.JsonOption = None,
    *,
    trust: options.TrustOption = False,
) -> None:
    """Train a policy and export it as policy.npz.

    Says how many digits the last fifth of the training gained, draws the learning curve, learning-curve.png, beside the
    digits of the paper's law and of the best law, and prints the command that compares the policy.

    The same command resumes an interrupted run from its last checkpoint. With Stable-Baselines3 and through the world,
    its policy differs from that of an uninterrupted run.
    """
    from ptne_env.training.configuration import POLICY, Configuration, read_finished_run
    from ptne_env.training.curve import draw, evaluate_laws

    trainer = training.TRAINERS[require_name("algorithm", algorithm, training.TRAINERS)]
    kind = trainer.load().Settings if algorithm == "through-world" else partial(Configuration, algorithm=algorithm)
    values = {**trainer.defaults, **options.read_changes(changes)}
    settings = [name for name in signature(kind).parameters if name not in ("scenario", "algorithm", "seed")]
    for name in values:
        require_name("setting", name, settings, "say --seed, --algorithm or SCENARIO for those")
    if steps is not None:
        values["steps" if trainer.unit == "agent-steps" else "updates"] = steps
    first: Run = kind(scenario, seed=seed, **values)
    options.require_trust(options.foreign_names(first.scenario), trust=trust)
    track, runs = find_track(first.scenario), {out: first}
    if seeds is not None:
        for folder in out.glob("seed-*"):  # also those that are not trained now: they are compared together
            if (number := folder.name.removeprefix("seed-")).isdigit():
                read_finished_run(replace(first, seed=int(number)), folder)
        series = [replace(first, seed=first.seed + index) for index in range(seeds)]
        runs = {out / f"seed-{run.seed}": run for run in series}
    picture = out / "learning-curve.png"
    check_writable(json, picture, *(folder / POLICY for folder in runs))
    ended = [folder for folder, run in runs.items() if read_finished_run(run, folder)]
    summaries = _train(runs, trainer)
    objects = [asdict(summary) for summary in summaries.values()]
    write_json(json, objects[0] if seeds is None else objects)
    for folder, summary in summaries.items():
        _say_result(folder / POLICY, summary, trainer, was_finished=folder in ended)
    digits = [summary.digits for summary in summaries.values()]
    if seeds is not None:
        say(f"Mean of {seeds} seeds: {sum(digits) / seeds:.2f} digits, from {min(digits):.2f} to {max(digits):.2f}")
    laws = evaluate_laws(track)
    law = laws.summary(laws.tracks[0].name, LAW, "digits")
    if law is not None and law.mean is not None and max(digits) < law.mean:
        say(f"The paper's law, {LAW}, has {law.mean:.2f} digits on validation episodes: more --steps may beat it")
    draw(
        {f"seed {run.seed}": folder for folder, run in runs.items()},
        picture,
        title=f"Training of {scenario}",
        steps=max(summary.agent_steps for summary in summaries.values()),
        laws=laws,
    )
    say(f"Learning curve written to {picture}")
    trained = f"trained={out}/seed-*/{POLICY}" if seeds is not None else str(out / POLICY)
    say(f"To compare:  ptne compare {first.scenario} --policy {shlex.quote(f'static,{trained}')}")


def _train(runs: Mapping[Path, Run], trainer: training.Trainer) -> dict[Path, RunSummary]:
    """Train one run after the other, with a progress bar for all of them, and return their summaries."""
    summaries: dict[Path, RunSummary] = {}
    train_one = trainer.load().train
    with progress("training") as advance:
        for folder, configuration in runs.items():

            def show(done: int, total: int, digits: float, seed: int = configuration.seed) -> None:
                place = "training" if len(runs) == 1 else f"training seed {seed}"
                now = f"{place}, {digits:.2f} digits" if digits > float("-inf") else place
                advance(now, len(summaries) * total + min(done, total), len(runs) * total)

            summaries[folder] = train_one(configuration, folder, show)
    return summaries


def _say_result(policy: Path, summary: RunSummary, trainer: training.Trainer, *, was_finished: bool) -> None:
    digits = f"{summary.digits:.2f} digits on {trainer.episodes}"
    if was_finished:
        say(f"This run has ended before, with {digits}; {policy.name} is in {policy.parent}")
        return
    from ptne_env.training.curve import FLAT, last_gain

    gained = last_gain(policy.parent)
    say(f"{digits}, after {summary.seconds:.0f} s; {policy.name} written to {policy.parent}")
    if gained <= -FLAT:
        say(f"The last fifth of the training lost {-gained:.2f} digits: try another --seed or a smaller learning_rate")
    else:
        hint = "" if gained < FLAT else ": more --steps gain more"
        say(f"The last fifth of the training gained {gained:.2f} digits{hint}")
    if summary.resumed_at and not trainer.resumes_exactly:
        say(
            f"The run was resumed at {summary.resumed_at} {trainer.unit}: the policy is not that of an uninterrupted "
            "run, which can be repeated"
        )
