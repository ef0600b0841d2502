"""The learning curve of a run: its reports of progress, kept in the folder of the run, and their picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ptne_env.shared.files import write_atomically
from ptne_env.shared.style import COLOURS, INK, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Run(NamedTuple):
    """A finished run in a picture.

    Attributes:
        points: agent-steps or segments done, and the mean digits reported then.
        digits: on the validation episodes, of the policy that the run exported.
    """

    points: dict[int, float]
    digits: float


class LearningCurve:
    """The reports of one run, in the file ``curve.csv`` of its folder.

    A run that is resumed repeats the reports after its last checkpoint; they take the place of the old ones.

    Args:
        folder: of the run; need not exist yet.

    Attributes:
        points: agent-steps or segments done, and the mean digits reported then, in rising order.

    Raises:
        ValueError: when there is such a file with other content, naming it.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "curve.csv"
        self.points: dict[int, float] = {}
        if self._path.exists():
            self.points = _read(self._path)

    def add(self, done: int, digits: float) -> None:
        """Write down a report, and forget those after it; NaN, where no episode was played, is left out.

        Args:
            done: agent-steps or segments.
            digits: mean digits.

        Raises:
            OSError: when the file cannot be written.
        """
        if isnan(digits):
            return
        self.points = {before: value for before, value in self.points.items() if before < done} | {done: digits}
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([("done", "digits"), *self.points.items()])
        write_atomically(self._path, text.getvalue())


def _read(path: Path) -> dict[int, float]:
    try:
        rows = csv.DictReader(path.read_text(encoding="utf-8").splitlines(), strict=True)
        return {int(row["done"]): float(row["digits"]) for row in rows}
    except (ValueError, TypeError, KeyError, csv.Error) as error:
        raise ValueError(
            f"{path} is no learning curve: it is damaged or something else ({error}); remove it, and the curve begins "
            "where training goes on"
        ) from error


def draw(runs: Mapping[str, Run], path: Path, *, title: str, unit: str) -> None:
    """Draw the learning curves of one run, or of the seeds of one configuration with their mean, into a PNG file.

    Args:
        runs: by name.
        path: the file.
        title: of the picture.
        unit: of progress, such as ``"agent-steps"``.

    Raises:
        ImportError: when matplotlib is missing, naming the extra to install.
        OSError: when the file cannot be written.
    """
    buffer = io.BytesIO()
    with drawing("learning curves"):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.subplots()
        _draw(axes, runs)
        axes.set(title=title, xlabel=f"{unit} done", ylabel="digits")
        figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    write_atomically(path, buffer.getvalue())


def _draw(axes: Axes, runs: Mapping[str, Run]) -> None:
    """A line for every run, a circle for its exported policy, and the mean of the runs where all have a report."""
    is_alone = len(runs) == 1
    for index, (name, run) in enumerate(runs.items()):
        colour = COLOURS[index % len(COLOURS)]
        label = "training" if is_alone else f"{name}: {run.digits:.2f}"
        axes.plot(*_columns(run.points), color=colour, linewidth=1.6 if is_alone else 1.0, label=label)
        end = max(run.points)
        label = f"exported policy, validation episodes: {run.digits:.2f}" if is_alone else ""
        axes.plot([end], [run.digits], "o", color=colour, markersize=6, clip_on=False, zorder=3, label=label)
    if not is_alone:
        shared = sorted(set.intersection(*(set(run.points) for run in runs.values())))
        mean = {done: sum(run.points[done] for run in runs.values()) / len(runs) for done in shared}
        axes.plot(*_columns(mean), color=INK, linewidth=2.2, label="mean")
    axes.locator_params(axis="x", integer=True, nbins=7)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    title = None if is_alone else "circles: exported policies, validation episodes"
    axes.legend(title=title, title_fontsize="small", alignment="left")


def _columns(points: Mapping[int, float]) -> tuple[list[int], list[float]]:
    return list(points), list(points.values())
