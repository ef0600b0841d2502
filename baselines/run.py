"""Train every shipped configuration with five seeds, ship the median ones, and write the leaderboard of the scenarios.

Run it with ``python baselines/run.py``. A run that is there already is not repeated, and one that was interrupted goes
on, so the command may be stopped and given again. ``results.json`` and ``README.md`` beside this file are its output.
Configurations named after a suite, such as ``ptne-v1-delay``, are trained and shipped here, and ranked by ``suite.py``.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Annotated, Any

import typer

from ptne_env import policies
from ptne_env.experiments import COMPARED, PolicySpec, evaluate
from ptne_env.experiments.workers import Workers
from ptne_env.files import write_atomically
from ptne_env.report.tables import number

HERE = Path(__file__).parent
RESULTS = HERE / "results.json"
ONE_SEED = frozenset({"random-energy-switching-long"})
"""Configurations that are trained once, because a run takes many minutes, and do not ship."""

SUITES = ("ptne-v1",)
"""Configurations whose names begin with one of these are trained on its tracks."""

METRICS = (
    "digits",
    "worst_decile_digits",
    "settling_time",
    "settling_time_1e_6",
    "digits_over_paper_laws",
    "probability_of_beating_paper_laws",
    "digits_over_all_laws",
    "probability_of_beating_all_laws",
)


_INTRODUCTION = (
    "Written by `python baselines/run.py`; do not edit. Digits on {episodes} held-out games per scenario (test bank, "
    "seed 0), with 95 % intervals over games. The seed with the median digits on the validation bank ships as "
    "`ppo-<configuration>`. Laws were tuned on the validation bank (`ptne_env/experiments/tuning.py`)."
)
_HEADINGS = (
    "policy",
    "digits",
    "worst decile",
    "settles to 0.5 % [s]",
    "to 1e-6 [s]",
    "over the best paper law",
    "over the best law",
    "P(beats it)",
    "trained for",
)


FILES = ("policy.onnx", "summary.json")
"""What is kept of a training run; the last one says that it is complete."""


def train_one(configuration: str, seed: int, out: Path) -> dict[str, bytes]:
    """Train one seed, on whichever machine, and give what is to be kept of it.

    Checkpoints and logs stay there: where the machines share the folder ``out``, a run whose machine was lost goes on
    from its last checkpoint, and elsewhere it starts again.
    """
    from ptne_env.training import ppo

    ppo.train(ppo.Arguments.from_toml(configuration, seed=seed), out)
    return {name: (out / name).read_bytes() for name in FILES}


def train_all(tasks: list[tuple[str, int]], runs: Path, workers: Workers) -> list[dict[str, Any]]:
    """Train what is not complete; the summaries of all."""
    folders = [runs.absolute() / name / f"seed-{seed}" for name, seed in tasks]
    missing = [index for index, folder in enumerate(folders) if not (folder / FILES[-1]).exists()]
    for place, files in workers.run(train_one, [(*tasks[index], folders[index]) for index in missing]):
        for name, content in files.items():
            write_atomically(folders[missing[place]] / name, content)
        typer.echo(f"trained {folders[missing[place]]}")
    return [json.loads((folder / FILES[-1]).read_text(encoding="utf-8")) for folder in folders]


def ship(configuration: str, summaries: list[dict[str, Any]], runs: Path) -> str:
    """Copy the policy of the median seed, by validation digits, into the package; its name there."""
    ranked = sorted(range(len(summaries)), key=lambda seed: summaries[seed]["validation_digits"])
    median = ranked[len(ranked) // 2]
    name = f"ppo-{configuration}"
    folder = Path(policies.__file__).parent
    shutil.copyfile(runs / configuration / f"seed-{median}" / "policy.onnx", folder / f"{name}.onnx")
    return name


def measure(configuration: str, summaries: list[dict[str, Any]], runs: Path, episodes: int) -> list[dict[str, Any]]:
    """Every seed, and the laws, on the test bank: one row each."""
    (scenario,) = summaries[0]["arguments"]["scenarios"]
    learned = [
        PolicySpec(
            f"{configuration}, seed {seed}", policies.load(runs / configuration / f"seed-{seed}" / "policy.onnx")
        )
        for seed in range(len(summaries))
    ]
    results = evaluate([*learned, *COMPARED], [scenario], episodes=episodes)
    rows = []
    for cell in results.cells:
        records = {record["metric"]: record for record in cell.records()}
        seed = next((index for index, entry in enumerate(learned) if entry.name == cell.policy), None)
        rows.append(
            {
                "scenario": scenario,
                "configuration": configuration if seed is not None else None,
                "policy": cell.policy,
                "seconds": None if seed is None else summaries[seed]["seconds"],
                "agent_steps": None if seed is None else summaries[seed]["agent_steps"],
                **{metric: records[metric] for metric in METRICS if metric in records},
            }
        )
    tuned = results.to_dict()["tuned_laws"][scenario]
    for row in rows:
        law = next((law for law in tuned.values() if law["name"] == row["policy"]), None)
        row["law"] = None if law is None else law["policy"]
    return rows


def leaderboard(rows: list[dict[str, Any]], episodes: int) -> str:
    """The leaderboard as Markdown."""
    lines = ["# Leaderboard", "", _INTRODUCTION.format(episodes=episodes), ""]
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        lines += [f"## {scenario}", "", f"| {' | '.join(_HEADINGS)} |", "| --- |" + " ---: |" * (len(_HEADINGS) - 1)]
        chosen = {row["policy"]: row for row in rows if row["scenario"] == scenario}
        lines += [_line(row) for row in sorted(chosen.values(), key=lambda row: -row["digits"]["mean"])]
        lines.append("")
    return "\n".join(lines)


def _line(row: dict[str, Any]) -> str:
    name = row["policy"]
    if row["law"] is not None:
        arguments = ", ".join(f"{key}={value:g}" for key, value in row["law"]["arguments"].items())
        name += f": {row['law']['target'].partition(':')[2]}({arguments})"
    cells = [name]
    cells += [_cell(row.get(metric)) for metric in ("digits", "worst_decile_digits")]
    cells += [_cell(row.get(metric)) for metric in ("settling_time", "settling_time_1e_6")]
    cells += [_cell(row.get(metric)) for metric in ("digits_over_paper_laws", "digits_over_all_laws")]
    cells.append(_cell(row.get("probability_of_beating_all_laws")))
    steps = row["agent_steps"]
    cells.append("" if steps is None else f"{steps / 1e6:.1f} M steps, {row['seconds']:.0f} s")
    return f"| {' | '.join(cells)} |"


def _cell(record: dict[str, Any] | None) -> str:
    if record is None:
        return ""
    if record["low"] == record["high"]:
        return number(record["mean"])
    return f"{number(record['mean'])} [{number(record['low'])}, {number(record['high'])}]"


def main(
    runs: Annotated[Path, typer.Option(help="Folder for the training runs.")] = Path("runs"),
    configuration: Annotated[list[str] | None, typer.Option(help="Repeat for several; all if left out.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds of each.")] = 5,
    jobs: Annotated[int, typer.Option(help="Runs at a time; each takes one core.")] = 2,
    backend: Annotated[
        str, typer.Option(help="Where: 'processes' of this machine, or 'ray', a cluster.")
    ] = "processes",
    address: Annotated[str | None, typer.Option(help="Of the cluster, such as auto or HOST:6379.")] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Games of the test bank.")] = 1000,
) -> None:
    """Train, ship and rank."""
    from ptne_env.training import ppo

    chosen = configuration or ppo.configurations()
    tasks = [(name, seed) for name in chosen for seed in range(1 if name in ONE_SEED else seeds)]
    trained = train_all(tasks, runs, Workers(jobs, backend, address))
    old = json.loads(RESULTS.read_text(encoding="utf-8"))["rows"] if RESULTS.exists() else []
    rows = [row for row in old if row["configuration"] not in chosen]
    for name in chosen:
        own = [summary for (task, _), summary in zip(tasks, trained, strict=True) if task == name]
        if name not in ONE_SEED:
            typer.echo(f"shipped {ship(name, own, runs)}")
        if not name.startswith(SUITES):
            rows += measure(name, own, runs, episodes)
    rows = list({(row["scenario"], row["policy"]): row for row in rows}.values())  # the latest of each
    write_atomically(RESULTS, json.dumps({"episodes": episodes, "rows": rows}, indent=1, allow_nan=False) + "\n")
    write_atomically(HERE / "README.md", leaderboard(rows, episodes))


if __name__ == "__main__":
    typer.run(main)
