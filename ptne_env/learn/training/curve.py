"""The learning curve of a run: the mean digits of its evaluations, and their picture."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ptne_env.bench.report.style import COLOURS, INK, drawing
from ptne_env.bench.suite import LAW
from ptne_env.evaluation import COMPARED, POLICIES, evaluate
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import write_atomically
from ptne_env.world.scenario import Scenario


def learning_curve(folder: Path) -> tuple[FloatArray, FloatArray]:
    """Agent-steps and mean digits of the evaluations in the folder of a run; of a resumed one, those since then.

    Raises:
        ValueError: when the file is damaged.
    """
    path = folder / "evaluations.npz"
    if not path.exists():
        return np.empty(0), np.empty(0)
    try:
        with np.load(path) as file:
            return file["timesteps"].astype(float), file["results"].mean(axis=1)
    except Exception as error:  # zip files raise many classes
        raise ValueError(f"{path} is no learning curve: it is damaged or something else ({error})") from error


def yardsticks(scenario: Scenario, episodes: int = 20) -> dict[str, float]:
    """The digits that the paper's law gains, and those of the best law, on validation episodes.

    Args:
        scenario: of the training.
        episodes: of each law.

    Returns:
        Digits by the name of the law and what it is, of one law where both are the same.
    """
    laws = [name for name in COMPARED if not (POLICIES[name].files or POLICIES[name].is_oracle)]
    results = evaluate(laws, [scenario], episodes=episodes, split="validation")
    gained = {name: float(found["digits_gained"].mean()) for (_, name), found in results.samples.items()}
    kinds = {max(gained, key=gained.__getitem__): "the best law", LAW: "the paper's law"}
    return {f"{name} ({kinds[name]})": gained[name] for name in reversed(kinds) if name in gained}


def draw(runs: Mapping[str, Path], path: Path, *, title: str, steps: int, lines: Mapping[str, float]) -> None:
    """Draw the learning curves of runs into a PNG file.

    Args:
        runs: folders by name.
        path: the file.
        title: of the picture.
        steps: the agent-steps that were asked for, where the axis ends.
        lines: digits of other policies by name.

    Raises:
        ImportError: when matplotlib is missing, naming the extra to install.
        OSError: when the file cannot be written.
    """
    buffer = io.BytesIO()
    with drawing("learning curves"):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.subplots()
        for index, (name, folder) in enumerate(runs.items()):
            colour = COLOURS[index % len(COLOURS)]
            axes.plot(*learning_curve(folder), color=colour, marker="o", label=name, clip_on=False)
        for (name, digits), style in zip(lines.items(), ("--", ":"), strict=False):
            axes.axhline(digits, color=INK, linestyle=style, linewidth=1, label=name)
        axes.set(title=title, xlabel="agent-steps", ylabel="digits gained, without exploration", xlim=(0, steps))
        axes.xaxis.set_major_formatter("{x:,.0f}")
        figure.legend(loc="outside lower center", ncols=2)
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    write_atomically(path, buffer.getvalue())
