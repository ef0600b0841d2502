"""The learning curve of a run: the mean digits of its evaluations, and their picture."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ptne_env.bench.report.style import COLOURS, drawing
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import write_atomically


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


def draw(runs: Mapping[str, Path], path: Path, *, title: str) -> None:
    """Draw the learning curves of runs into a PNG file.

    Args:
        runs: folders by name.
        path: the file.
        title: of the picture.

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
            axes.plot(*learning_curve(folder), color=COLOURS[index % len(COLOURS)], marker="o", label=name)
        axes.set(title=title, xlabel="agent-steps done", ylabel="digits of 20 games, without exploration")
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.legend()
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    write_atomically(path, buffer.getvalue())
