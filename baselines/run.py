"""Train every shipped configuration with five seeds, ship the median ones, and write the leaderboard of the scenarios.

Run it with ``python baselines/run.py``. A run that is there already is not repeated, and one that was interrupted goes
on, so the command may be stopped and given again. ``results.json`` and ``README.md`` beside this file are its output.
Configurations for suites, such as ``ptne-v1-noise`` and ``generalist``, are trained and shipped here, and ranked by
``suite.py``.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from common import Jobs, Ray, interval, table

from ptne_env import learn as policies
from ptne_env.evaluation import COMPARED, PolicySpec, Workers, evaluate
from ptne_env.evaluation.statistics import Summary
from ptne_env.learn import training
from ptne_env.shared.files import write_atomically

if TYPE_CHECKING:
    from ptne_env.learn.training.arguments import Arguments
    from ptne_env.learn.training.generalist import Generalist

HERE = Path(__file__).parent
RESULTS = HERE / "results.json"
ONE_SEED = frozenset({"random-energy-switching-long"})
"""Configurations that are trained once, because a run takes many minutes, and do not ship."""

SUITES = ("ptne-v1", training.GENERALIST)
"""Configurations whose names begin with one of these are for suites."""

METRICS = (
    "digits",
    "digits_cvar",
    "settling_time",
    "settling_time_1e_6",
    "digits_over_paper_laws",
    "probability_of_beating_paper_laws",
    "digits_over_all_laws",
    "probability_of_beating_all_laws",
)


_INTRODUCTION = (
    "Written by `python baselines/run.py`; do not edit. Digits on {episodes} test episodes per scenario (seed 0), "
    "with 95 % intervals over episodes. The training seed with the median digits on the validation episodes ships as "
    "`ppo-<configuration>`. Laws were tuned on the validation episodes (`ptne_env/evaluation/tuning.py`)."
)
_HEADINGS = (
    "policy",
    "digits",
    "CVaR (10 %)",
    "settles to 0.5 % [s]",
    "to 1e-6 [s]",
    "over the best paper law",
    "over the best law",
    "P(beats it)",
    "trained for",
)


FILES = ("policy.onnx", "summary.json")
"""The files that are kept of a training run; a run with the last of them is complete."""


def policy_name(configuration: str) -> str:
    """The name under which a configuration ships."""
    return training.SHIPPED if configuration == training.GENERALIST else f"ppo-{configuration}"


def arguments_of(configuration: str, seed: int) -> Arguments | Generalist:
    """The arguments of a run."""
    from ptne_env.learn.training import arguments, generalist

    kind = generalist.Generalist if configuration == training.GENERALIST else arguments.Arguments
    return arguments.from_toml(kind, configuration, seed=seed)


def train_one(configuration: str, seed: int, out: Path) -> dict[str, bytes]:
    """Train one seed on any machine; the content of :data:`FILES`.

    Checkpoints and logs stay there: where the machines share the folder ``out``, a run whose machine was lost goes on
    from its last checkpoint, and elsewhere it starts again.
    """
    from ptne_env.learn.training import generalist, ppo

    trainer = generalist if configuration == training.GENERALIST else ppo
    trainer.train(arguments_of(configuration, seed), out)
    return {name: (out / name).read_bytes() for name in FILES}


def train_all(tasks: list[tuple[str, int]], runs: Path, workers: Workers) -> list[dict[str, Any]]:
    """Train the runs that are not complete; the summaries of all.

    Raises:
        ValueError: when a folder holds a run with other arguments.
    """
    from ptne_env.learn.training.checkpoint import finished

    folders = [runs.absolute() / name / f"seed-{seed}" for name, seed in tasks]
    done = [finished(arguments_of(*task), folder) for task, folder in zip(tasks, folders, strict=True)]
    missing = [index for index, summary in enumerate(done) if summary is None]
    for place, files in workers.run(train_one, [(*tasks[index], folders[index]) for index in missing]):
        for name, content in files.items():
            write_atomically(folders[missing[place]] / name, content)
        typer.echo(f"trained {folders[missing[place]]}")
    return [json.loads((folder / FILES[-1]).read_text(encoding="utf-8")) for folder in folders]


def ship(configuration: str, summaries: list[dict[str, Any]], runs: Path) -> str:
    """Copy the policy of the median seed, by validation digits, into the package; its name there."""
    ranked = sorted(range(len(summaries)), key=lambda seed: summaries[seed]["validation_digits"])
    median = ranked[len(ranked) // 2]
    name = policy_name(configuration)
    folder = Path(policies.__file__).parent
    shutil.copyfile(runs / configuration / f"seed-{median}" / "policy.onnx", folder / f"{name}.onnx")
    return name


def measure(configuration: str, summaries: list[dict[str, Any]], runs: Path, episodes: int) -> list[dict[str, Any]]:
    """A row per training seed and law, with its metrics on the test episodes."""
    (scenario,) = summaries[0]["arguments"]["scenarios"]
    trained = {
        f"{configuration}, seed {seed}": PolicySpec(
            f"{configuration}, seed {seed}", policies.load(runs / configuration / f"seed-{seed}" / "policy.onnx")
        )
        for seed in range(len(summaries))
    }
    summary_of = dict(zip(trained, summaries, strict=True))
    results = evaluate([*trained.values(), *COMPARED], [scenario], episodes=episodes)
    laws = {law.name: law.to_dict()["training_seeds"][0] for law in results.tuned[scenario].values()}
    return [
        {
            "scenario": scenario,
            "configuration": configuration if name in trained else None,
            "policy": name,
            "seconds": summary_of[name]["seconds"] if name in trained else None,
            "agent_steps": summary_of[name]["agent_steps"] if name in trained else None,
            **{
                record["metric"]: record
                for record in results.records
                if record["policy"] == name and record["metric"] in METRICS
            },
            "law": laws.get(name),
        }
        for name in results.policies_on(scenario)
    ]


def leaderboard(rows: list[dict[str, Any]], episodes: int) -> str:
    """The leaderboard as Markdown."""
    lines = ["# Leaderboard", "", _INTRODUCTION.format(episodes=episodes), ""]
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        chosen = {row["policy"]: row for row in rows if row["scenario"] == scenario}
        ranked = sorted(chosen.values(), key=lambda row: -row["digits"]["mean"])
        lines += [f"## {scenario}", "", *table(_HEADINGS, [_cells(row) for row in ranked]), ""]
    return "\n".join(lines)


_SHOWN = (
    "digits",
    "digits_cvar",
    "settling_time",
    "settling_time_1e_6",
    "digits_over_paper_laws",
    "digits_over_all_laws",
    "probability_of_beating_all_laws",
)


def _cells(row: dict[str, Any]) -> list[str]:
    name = row["policy"]
    if row["law"] is not None:
        arguments = ", ".join(f"{key}={value:g}" for key, value in row["law"]["arguments"].items())
        name += f": {row['law']['target'].partition(':')[2]}({arguments})"
    steps = row["agent_steps"]
    trained = "" if steps is None else f"{steps / 1e6:.1f} M steps, {row['seconds']:.0f} s"
    return [name, *(interval(_summary(row.get(metric))) for metric in _SHOWN), trained]


def _summary(record: dict[str, Any] | None) -> Summary | None:
    return None if record is None else Summary(record["mean"], record["low"], record["high"])


def main(
    runs: Annotated[Path, typer.Option(help="Folder for the training runs.")] = Path("runs"),
    configuration: Annotated[list[str] | None, typer.Option(help="Repeat for several; all if left out.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds of each.")] = 5,
    jobs: Jobs = 2,
    ray: Ray = None,
    episodes: Annotated[int, typer.Option(min=1, help="Test episodes.")] = 1000,
) -> None:
    """Train, ship and rank."""
    chosen = configuration or [*training.configurations(), training.GENERALIST]
    tasks = [(name, seed) for name in chosen for seed in range(1 if name in ONE_SEED else seeds)]
    trained = train_all(tasks, runs, Workers(jobs, ray))
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
