"""Train the policy without sizes in several ways at one budget of processor time, and print what each way buys.

Run it as ``python baselines/three_ways.py``. Imitation comes first, as in the shipped configuration; the other ways
start with its policy, or with random weights. Each row has the mean digits on the validation worlds at the start, and
after equal shares of the budget.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Annotated

import torch
import typer
from common import Jobs, table
from rich.console import Console

from ptne_env.evaluation import Workers
from ptne_env.learn.training import generalist
from ptne_env.learn.training.arguments import from_toml
from ptne_env.learn.training.generalist import Generalist, Run, Stage

WAYS: dict[str, tuple[Stage, bool, bool]] = {
    "imitation": ("imitation", True, False),
    "evolution of the linear maps": ("evolution", True, False),
    "evolution of all weights": ("evolution", True, True),
    "PPO": ("ppo", True, False),
    "imitation from random weights": ("imitation", False, False),
    "PPO from random weights": ("ppo", False, False),
}
"""Ways by name: the stage, whether it starts with the imitated policy, and whether evolution changes all weights."""


def curve(arguments: Generalist, seconds: float, parts: int) -> list[float]:
    """Digits on the validation worlds at the start and after each of so many parts of the budget."""
    torch.set_num_threads(1)
    run, stage = Run(arguments), arguments.stages[0]
    digits, spent, number = [run.validate()], 0.0, 0
    scores: tuple[tuple[float, ...], ...] = ()
    for part in range(1, parts + 1):
        while spent < seconds * part / parts:
            began = process_time()
            outcome = run.segment(stage, number, scores)
            scores = (*scores, outcome.scores) if outcome.scores else ()
            number, spent = number + 1, spent + process_time() - began
        before = {name: each.clone() for name, each in run.policy.actor.state_dict().items()}
        run.end(stage, scores)
        digits.append(run.validate())
        run.policy.actor.load_state_dict(before)
    return digits


def main(
    minutes: Annotated[float, typer.Option(min=0.01, help="Processor time of each way, without validation.")] = 5.0,
    parts: Annotated[int, typer.Option(min=1, help="Validations of each way.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Of the training.")] = 0,
    jobs: Jobs = 2,
) -> None:
    """Train and print."""
    common = from_toml(Generalist, "generalist", seed=seed)
    # Schedules of learning rates that the budget does not reach the end of.
    endless = {"rounds": 100, "segments": 1000, "jobs": 1}
    with TemporaryDirectory() as folder:
        generalist.train(replace(common, jobs=jobs), Path(folder))
        imitated = str(Path(folder) / "policy.onnx")
        tasks = [
            (
                replace(common, stages=(stage,), start=imitated if has_start else "", layers=layers, **endless),
                60 * minutes,
                parts,
            )
            for stage, has_start, layers in WAYS.values()
        ]
        curves = Workers(jobs).gather(curve, tasks)
    headings = ["way", "0", *(f"{minutes * part / parts:.3g} min" for part in range(1, parts + 1))]
    rows = [[name, *(f"{digits:.2f}" for digits in found)] for name, found in zip(WAYS, curves, strict=True)]
    Console(soft_wrap=True).print("\n".join(table(headings, rows, texts=("way",))))


if __name__ == "__main__":
    typer.run(main)
