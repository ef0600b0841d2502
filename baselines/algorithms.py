"""The algorithms of reinforcement learning, trained on every track: ``python -m baselines.algorithms COMMAND``.

    tune [ALGORITHM]...     other settings of each algorithm beside the defaults, for fewer agent-steps on two tracks
    train [ALGORITHM]...    its settings with several seeds on every track of ptne-v1; PPO for 20 M agent-steps, or for
                            50 M where the last fifth of those gained or lost 0.05 digits or more, and SAC for 2 M
    publish                 play what was trained on the test episodes, and replace its rows in ``algorithms.csv``, its
                            learning curves in ``curves.csv``, and the files of ``ppo`` by those seeds of PPO that
                            have more digits on validation episodes; then draw the picture

Every run has a folder in ``--out``, and one core; a run that has ended is not repeated.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import qmc

from baselines.published import (
    COLUMNS,
    PPO,
    ROOT,
    TRAINED,
    TRAINING_METRICS,
    TRAININGS,
    Published,
    Row,
    best_law,
    interval_of,
    read,
    write_rows,
)
from ptne_env import learn
from ptne_env.evaluation import PolicySpec, evaluate, get_policy_spec
from ptne_env.evaluation.tracks import find_track
from ptne_env.execution import Runner, Workers
from ptne_env.shared.files import write_atomically
from ptne_env.shared.style import COLOURS, INK, drawing, encode
from ptne_env.suites import get_suite
from ptne_env.training import TRAINERS, VALIDATION_EPISODES
from ptne_env.training.configuration import POLICY, Configuration
from ptne_env.training.curve import FLAT, last_gain, read_learning_curve, validate

TRACKS = tuple(track.name for track in get_suite("ptne-v1").tracks)
TUNED_ON = ("switching-transformed", "curved")
"""The tracks on whose validation episodes settings are chosen: noisy links that come and go, and curvature."""

PICTURE = ROOT / "docs" / "images" / "algorithms.png"
CURVES, CURVE_COLUMNS = TRAININGS.with_name("curves.csv"), ("track", "policy", "seed", "minutes", "digits")

Settings = dict[str, Any]
Run = tuple[str, str, Path, Settings]
"""A track, an algorithm, the folder, and the settings that are not the defaults."""


def candidates(count: int) -> list[Settings]:
    """Settings of PPO that are tried beside the defaults: a Latin hypercube."""
    rate, horizon, log_std, batches, epochs = qmc.LatinHypercube(5, rng=0).random(count).T
    return [
        {
            "learning_rate": float(f"{10 ** (-3.3 + 1.3 * rate[i]):.2g}"),
            "discount": round(float(1 - 1 / 2 ** (1 + 3 * horizon[i])), 3),
            "log_std": round(float(-2.5 + 1.5 * log_std[i]), 1),
            "minibatches": int(2 ** (3 + int(4 * batches[i]))),
            "epochs": 1 + int(3 * epochs[i]),
        }
        for i in range(count)
    ]


class Plan(NamedTuple):
    """How an algorithm is trained.

    Attributes:
        budgets: the agent-steps of a run, and of one on a track where those do not suffice.
        seeds: the seeds on every track.
        trial_steps: the agent-steps of a trial.
        trials: the settings that are tried beside the defaults.
        ships: whether its seeds may become the files of ``ppo``.
        settings: by track, those that are not the defaults.
    """

    budgets: tuple[int, ...]
    seeds: range
    trial_steps: int
    trials: Sequence[Settings]
    ships: bool
    settings: Mapping[str, Settings] = {}


_PPO = Plan((20_000_000, 50_000_000), range(5), 5_000_000, candidates(20), ships=True)
_SAC_TRIALS = (
    {"log_std": -2.4},
    {"log_std": -3.4},
    {"discount": 0.5},
    {"hidden": (128, 128)},
    {"log_std": -2.4, "discount": 0.5},
    {"log_std": -2.4, "discount": 0.9},
    {"log_std": -2.4, "learning_rate": 3e-4},
    {"log_std": -2.4, "minibatches": 1, "epochs": 12},
)
PLANS = {
    "ippo": _PPO,
    "ippo-rnn": _PPO._replace(settings={"market-118": {"learning_rate": 1e-3}}),  # one of five falls with the default
    "mappo-rnn": _PPO,
    "sb3-sac": Plan((2_000_000,), range(2), 400_000, _SAC_TRIALS, ships=False),
}
"""The algorithms that are trained."""

ALGORITHMS = tuple(PLANS)


def train_one(track: str, algorithm: str, out: Path, settings: Settings) -> float:
    """Train in this process, write down the seconds of its core, and return the digits on validation episodes."""
    began, record = process_time(), out / "core-seconds.json"
    trainer = TRAINERS[algorithm]
    configuration = Configuration(f"ptne-v1/{track}", algorithm, **{**trainer.defaults, **settings})
    summary = trainer.load().train(configuration, out)
    if not record.exists():  # a resumed run counts what its last part took, as if all parts were as fast
        share = 1 - summary.resumed_at / summary.agent_steps
        record.write_text(json.dumps((process_time() - began) / share))
    print(f"{out}: {summary.digits:.2f} digits, {json.loads(record.read_text()):.0f} s", flush=True)
    return float(summary.digits)


def train_all(runs: Sequence[Run], jobs: int) -> list[float]:
    """Train each on a core."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    digits = dict(Workers(jobs).run(train_one, runs))
    return [digits[index] for index in range(len(runs))]


def tune(algorithm: str, out: Path, jobs: int) -> None:
    """Try the settings of an algorithm, and print them and their digits, the best first."""
    plan = PLANS[algorithm]
    trials = [{}, *plan.trials]
    runs = [
        (track, algorithm, out / "tune" / algorithm / track / str(index), {"steps": plan.trial_steps, **trial})
        for index, trial in enumerate(trials)
        for track in TUNED_ON
    ]
    digits = np.reshape(train_all(runs, jobs), (-1, len(TUNED_ON)))
    for index in np.argsort(-digits.mean(axis=1)):
        print(f"{algorithm} {digits[index].mean():.2f}", digits[index].round(2), trials[index] or "defaults")


def folder_of(algorithm: str, track: str, steps: int, out: Path) -> Path:
    """The folder of all seeds of an algorithm on a track."""
    return out / algorithm / track / f"{steps // 1_000_000}M"


def gain(folder: Path) -> float:
    """The digits that the last fifth of the runs in a folder gained, as the mean over those that have ended, or 0."""
    return fmean([last_gain(summary.parent) for summary in sorted(folder.glob("seed-*/summary.json"))] or [0.0])


def train(algorithms: Sequence[str], out: Path, jobs: int) -> None:
    """Train the seeds of algorithms on all tracks: seed 0 tells where the small budget does not do, or all of them."""
    for last in (1, None, None):
        runs: list[Run] = []
        for algorithm in algorithms:
            plan = PLANS[algorithm]
            for track in TRACKS:
                is_flat = abs(gain(folder_of(algorithm, track, plan.budgets[0], out))) < FLAT
                steps = plan.budgets[0 if is_flat else -1]
                for seed in plan.seeds[:last]:
                    folder = folder_of(algorithm, track, steps, out) / f"seed-{seed}"
                    settings = {"steps": steps, "seed": seed, **plan.settings.get(track, {})}
                    runs.append((track, algorithm, folder, settings))
        train_all(sorted(runs, key=lambda run: (run[3]["seed"], run[3]["steps"])), jobs)


def trained(out: Path) -> Iterator[tuple[str, str, Path]]:
    """The tracks and algorithms of which all seeds have ended, and the folder of the longest training."""
    for track in TRACKS:
        for algorithm in ALGORITHMS:
            plan = PLANS[algorithm]
            folders = [folder_of(algorithm, track, steps, out) for steps in reversed(plan.budgets)]
            ended = [folder for folder in folders if len([*folder.glob("seed-*/summary.json")]) == len(plan.seeds)]
            yield from ((track, algorithm, folder) for folder in ended[:1])


def rows_of(track: str, algorithm: str, folder: Path, runner: Runner) -> list[Row]:
    """The rows of an algorithm on a track, from its runs and the test episodes of ptne-v1."""
    spec = get_policy_spec(f"{algorithm}={folder}/seed-*/{POLICY}")
    name = f"ptne-v1/{track}"
    results = evaluate([spec], name, run=runner)
    means = results.samples[name, algorithm]["digits"].mean(axis=1)
    summaries = [json.loads(path.read_text()) for path in folder.glob("seed-*/summary.json")]
    seconds = [json.loads(path.read_text()) for path in folder.glob("seed-*/core-seconds.json")]
    steps = fmean(summary["agent_steps"] for summary in summaries)
    numbers = means.std(ddof=1), len(means), steps / 1e6, fmean(seconds) / 60, gain(folder)
    common = {"suite": "algorithms", "track": track, "policy": algorithm}
    return [
        common | {"metric": "digits"} | interval_of(results.record(name, algorithm, "digits")),
        *(
            common | {"metric": metric, "mean": f"{number:.7g}"}
            for metric, number in zip(TRAINING_METRICS, numbers, strict=True)
        ),
    ]


def ship(track: str, folder: Path) -> None:
    """Replace the file of PPO on a track by the seed with the most digits on validation episodes, if it has more."""
    digits = {seed: float(json.loads((seed / "summary.json").read_text())["digits"]) for seed in folder.glob("seed-*")}
    best, path = max(digits, key=digits.__getitem__), Path(learn.__file__).parent / f"{PPO}-{track}.npz"
    shipped = -np.inf
    if path.exists():
        policy = PolicySpec("shipped", learn.load(path))  # on the episodes that the seeds were validated on
        shipped = float(validate(policy, find_track(f"ptne-v1/{track}"), VALIDATION_EPISODES).mean())
    if digits[best] > shipped:
        write_atomically(path, (best / POLICY).read_bytes())
    print(f"{path.name}: {shipped:.2f}, {best}: {digits[best]:.2f}")


def curves_of(track: str, algorithm: str, folder: Path) -> list[Row]:
    """The digits of all seeds on validation episodes, over the minutes of a core."""
    rows = []
    for run in sorted(folder.glob("seed-*")):
        steps, digits = read_learning_curve(run)
        minutes = json.loads((run / "core-seconds.json").read_text()) / 60 * steps / steps[-1]
        common = {"track": track, "policy": algorithm, "seed": run.name.removeprefix("seed-")}
        points = zip(minutes, digits, strict=True)
        rows += [common | {"minutes": f"{minute:.4g}", "digits": f"{value:.4g}"} for minute, value in points]
    return rows


def merge(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> list[Row]:
    """Write rows into a file in the place of those of the same trainings there, and return all of them."""
    with path.open(encoding="utf-8", newline="") as file:
        kept = [row for row in csv.DictReader(file) if training_of(row) not in set(map(training_of, rows))]
    merged = sorted([*kept, *rows], key=training_of)
    write_rows(path, merged, columns)
    return merged


def training_of(row: Row) -> tuple[int, int]:
    """The places of the track and algorithm of a row."""
    return TRACKS.index(row["track"]), ALGORITHMS.index(row["policy"])


def draw(curves: Sequence[Row]) -> None:
    """Draw the digits of seeds over the minutes of a core, a track per panel, beside laws and the network.

    A mark with a bar shows the mean and the standard deviation over all seeds, on the test episodes.
    """
    numbers, legend = read(), {}
    with drawing("learning curves"):
        figure = Figure(figsize=(9.0, 9.5), layout="constrained")
        grid = figure.subplots(-(-len(TRACKS) // 3), 3, sharex=True)
        for axes, track in zip(grid.flat, TRACKS, strict=False):
            lines = {"the paper's law": "static", "best law": best_law(numbers, "ptne-v1", track)[0], TRAINED: TRAINED}
            for (label, policy), style in zip(lines.items(), ("-.", ":", "--"), strict=True):
                axes.axhline(mean_of(numbers, "ptne-v1", track, policy), color=INK, linestyle=style, linewidth=1)
                legend[label] = axes.get_lines()[-1]
            for color, algorithm in zip(COLOURS, ALGORITHMS, strict=False):
                for seed in PLANS[algorithm].seeds:
                    here = [row for row in curves if (row["track"], row["policy"]) == (track, algorithm)]
                    points = [(row["minutes"], row["digits"]) for row in here if row["seed"] == str(seed)]
                    axes.plot(*np.reshape(points, (-1, 2)).astype(float).T, color=color, linewidth=0.8)
                if numbers.cell("algorithms", track, algorithm):
                    place = [
                        mean_of(numbers, "algorithms", track, algorithm, metric)
                        for metric in ("core_minutes", "digits", "spread")
                    ]
                    legend[algorithm] = axes.errorbar(*place, color=color, fmt="o", markersize=3)
            axes.set(title=track, xscale="log")
            axes.tick_params(labelbottom=True)
            axes.xaxis.set_major_formatter("{x:g}")
        for unused in figure.axes[len(TRACKS) :]:
            unused.set_axis_off()
        figure.supxlabel("minutes of a core")
        figure.supylabel("digits at the deadline")
        figure.legend(legend.values(), legend.keys(), loc="outside upper center", ncols=len(legend))
        write_atomically(PICTURE, encode(figure, "png", dpi=110))


def mean_of(numbers: Published, *place: str) -> float:
    """A published number."""
    return float((numbers.cell(*place) or {})["mean"])


def publish(out: Path, jobs: int) -> None:
    """Write the rows and curves of everything that is trained, the files of ``ppo``, and the picture."""
    runner, rows, curves = Runner(out / "jobs", Workers(jobs)), list[Row](), list[Row]()
    for track, algorithm, folder in trained(out):
        rows += rows_of(track, algorithm, folder, runner)
        curves += curves_of(track, algorithm, folder)
        if PLANS[algorithm].ships:
            ship(track, folder)
    merge(TRAININGS, COLUMNS, rows)
    draw(merge(CURVES, CURVE_COLUMNS, curves))


def main() -> None:
    """Tune, train or publish."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=["tune", "train", "publish"])
    parser.add_argument("algorithms", nargs="*", default=ALGORITHMS, metavar="ALGORITHM")
    parser.add_argument("--out", type=Path, default=Path("runs"))
    parser.add_argument("--jobs", type=int, default=-1)
    arguments = parser.parse_args()
    if arguments.command == "tune":
        for algorithm in arguments.algorithms:
            tune(algorithm, arguments.out, arguments.jobs)
    elif arguments.command == "publish":
        publish(arguments.out, arguments.jobs)
    else:
        train(arguments.algorithms, arguments.out, arguments.jobs)


if __name__ == "__main__":
    main()
