"""The learning curve of a run, its picture, and the validation of its policy."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from ptne_env.evaluation import COMPARED, METRICS, POLICIES, PolicySpec, Results, evaluate
from ptne_env.evaluation.tracks import Track
from ptne_env.learn.npz_policy import open_policy
from ptne_env.report.tables import leaders
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import read_file, write_atomically
from ptne_env.shared.style import COLOURS, INK, drawing, encode
from ptne_env.training import VALIDATION_EPISODES
from ptne_env.training.configuration import POLICY, RunSummary, write_record
from ptne_env.world.scenario import Scenario

CURVE_EPISODES = 50
"""The validation episodes of each evaluation of a learning curve."""

FLAT = 0.05
"""A training is flat when its last fifth gained or lost fewer digits."""


def read_learning_curve(folder: Path) -> tuple[FloatArray, FloatArray]:
    """Read the agent-steps and the means of the evaluations of a run; of a resumed run, those since it resumed."""
    path = folder / "evaluations.npz"
    if not path.exists():
        return np.empty(0), np.empty(0)
    try:
        with np.load(io.BytesIO(read_file(path))) as file:
            return file["timesteps"].astype(float), file["results"].mean(axis=1)
    except Exception as error:  # zip files raise many classes
        raise ValueError(f"{path} is no learning curve: it is damaged or something else ({error})") from error


def last_gain(folder: Path) -> float:
    """Return the digits that the last fifth of a run gained, which are negative where it lost some."""
    steps, digits = read_learning_curve(folder)
    return float(digits[-1] - np.interp(0.8 * steps[-1], steps, digits))


def write_learning_curve(folder: Path, steps: Any, results: Any) -> None:
    """Write the agent-steps of evaluations and their results, one row each, as Stable-Baselines3 does."""
    buffer = io.BytesIO()
    np.savez(buffer, timesteps=steps, results=results)
    write_atomically(folder / "evaluations.npz", buffer.getvalue())


def finish(out: Path, content: bytes, world: Scenario | Track, steps: int, resumed_at: int, began: float) -> RunSummary:
    """Validate the content of a policy file, write it and the summary of its run, and return the summary.

    Raises:
        ValueError: when the policy fails on a validation episode.
    """
    seconds = monotonic() - began
    digits = validate(PolicySpec("trained", open_policy(Path(POLICY), content)), world, VALIDATION_EPISODES)
    summary = RunSummary(steps, resumed_at, seconds, float(digits.mean()))
    write_atomically(out / POLICY, content)
    write_record(out / "summary.json", summary)
    return summary


def validate(policy: PolicySpec, world: Scenario | Track, episodes: int) -> FloatArray:
    """Return the digits of a policy on each of some validation episodes.

    Raises:
        ValueError: when it fails on one of them.
    """
    results = evaluate([policy], [world], episodes=episodes, split="validation")
    for reason in results.failures.values():
        raise ValueError(f"the trained policy fails on {world.name!r}: {reason}")
    return results.samples[world.name, policy.name]["digits"][0]


def evaluate_laws(world: Scenario | Track, episodes: int = 20) -> Results:
    """Evaluate the laws on validation episodes of the world of a training."""
    laws = [name for name in COMPARED if POLICIES[name].is_law]
    return evaluate(laws, [world], episodes=episodes, split="validation")


def draw(runs: Mapping[str, Path], path: Path, *, title: str, steps: int, laws: Results) -> None:
    """Draw the learning curves of runs, from their folders by name, the paper's law and the best law into a PNG file.

    The axis ends at ``steps`` agent-steps, unless a curve goes on. The lines show the laws of :func:`evaluate_laws`.

    Raises:
        ImportError: when matplotlib is missing, naming the extra to install.
        OSError: when the file cannot be written.
    """
    with drawing("learning curves"):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.subplots()
        for index, (name, folder) in enumerate(runs.items()):
            curve = read_learning_curve(folder)
            axes.plot(*curve, color=COLOURS[index % len(COLOURS)], marker="o", label=name, clip_on=False)
            steps = max([steps, *curve[0].astype(int)])
        for (name, kind), style in zip(leaders(laws).items(), ("--", ":"), strict=False):
            record = laws.record(laws.tracks[0].name, name, "digits")
            axes.axhline(record["mean"], color=INK, linestyle=style, linewidth=1, label=f"{name} ({kind})")
        axes.set(title=title, xlabel="agent-steps", ylabel=f"{METRICS['digits'].label}, without exploration")
        axes.set_xlim(0, steps)
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.locator_params(axis="x", nbins=5)  # else labels of millions overlap
        figure.legend(loc="outside lower center", ncols=2)
    write_atomically(path, encode(figure, "png", dpi=150))
