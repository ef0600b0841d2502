"""Phase diagrams as pictures."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ptne_env.evaluation.sweep import CEILING, FLOOR, Axis, Diagram
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import write_atomically
from ptne_env.shared.style import COLOURS, INK, LINE, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINES = (COLOURS[1], COLOURS[3], COLOURS[4])
"""Colours of the boundaries: the warm ones, which stand out on every colour of the map."""


def save_diagram(diagram: Diagram, path: Path) -> None:
    """Draw a phase diagram into a file: colours are measured, thin contours and thick lines predicted.

    Args:
        diagram: the digits, measured and predicted.
        path: the file; its suffix is the format (``.png``, ``.svg``, ``.pdf``).

    Raises:
        ImportError: when matplotlib is missing, naming the extra to install.
        OSError: when the file cannot be written.
    """
    kind = path.suffix.removeprefix(".") or "png"
    buffer = io.BytesIO()
    with drawing("diagrams", {"font.size": 10, "axes.grid": False}):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(5.0, 4.6), layout="constrained")
        _draw(diagram, figure)
        figure.savefig(buffer, format=kind, dpi=140, metadata={"Software": None} if kind == "png" else None)
    write_atomically(path, buffer.getvalue())


def _draw(diagram: Diagram, figure: Figure) -> None:
    axes = figure.subplots()
    axes.set_facecolor(LINE)  # shows where no such scenario exists
    _scale(axes, diagram)  # first, because the labels of contours are placed on the scales in force
    x, y = np.array(diagram.x.values), np.array(diagram.y.values)
    measured, predicted = diagram.grid("measured"), diagram.grid("predicted")
    top = float(np.clip(np.ceil(np.nanmax(measured)), 1.0, CEILING))
    bottom = max(FLOOR, float(np.floor(np.nanmin(measured))))
    mesh = axes.pcolormesh(
        _edges(diagram.x), _edges(diagram.y), measured, cmap="viridis", vmin=bottom, vmax=top, rasterized=True
    )
    levels = np.arange(bottom + 1, top)
    contours = axes.contour(x, y, predicted, levels=levels, colors="white", linewidths=0.8, linestyles="solid")
    axes.clabel(contours, fmt="%g", fontsize=8, inline_spacing=2)
    axes.plot([], [], color="white", linewidth=0.8, label="predicted digits")
    for boundary, colour in zip(diagram.boundaries, _LINES, strict=False):
        axes.plot(boundary.x, boundary.y, color=colour, linewidth=2.2, label=boundary.label)
    axes.set(xlabel=diagram.x.label, ylabel=diagram.y.label, title=diagram.title)
    figure.colorbar(mesh, ax=axes, label=f"measured digits at T, mean of {diagram.episodes}")
    figure.legend(
        loc="outside lower center", ncols=2, frameon=True, facecolor=INK, edgecolor="none", labelcolor="white"
    )


def _scale(axes: Axes, diagram: Diagram) -> None:
    """Give both axes their scale, limits and ticks."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    for name, axis, side in (("x", diagram.x, axes.xaxis), ("y", diagram.y, axes.yaxis)):
        edges = _edges(axis)
        axes.set(**{f"{name}scale": "log" if axis.is_logarithmic else "linear", f"{name}lim": (edges[0], edges[-1])})
        if axis.is_logarithmic:
            side.set_major_locator(LogLocator(subs=(1, 2, 5) if edges[-1] < 5e3 * edges[0] else (1,)))
            side.set_major_formatter(FormatStrFormatter("%g"))
            side.set_minor_formatter(NullFormatter())


def _edges(axis: Axis) -> FloatArray:
    """Borders of the cells around the values of an axis."""
    values = np.log(axis.values) if axis.is_logarithmic else np.array(axis.values)
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.asarray(np.exp(edges) if axis.is_logarithmic else edges)
