"""Phase diagrams as pictures, drawn with matplotlib."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ptne_env.arrays import FloatArray
from ptne_env.experiments.sweep import CEILING, FLOOR, Axis, Diagram
from ptne_env.files import write_atomically

_LINES = ("#D55E00", "#CC79A7", "#E69F00")
"""Of boundaries; distinct for colour-blind readers, and on every colour of the map."""


def save_diagram(diagram: Diagram, path: Path) -> None:
    """Draw a phase diagram into a file: colours are measured, thin contours and thick lines predicted.

    Args:
        diagram: what was measured.
        path: the file; its suffix is the format (``.png``, ``.svg``, ``.pdf``).

    Raises:
        ImportError: when matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
        from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
    except ImportError as error:
        raise ImportError('diagrams need matplotlib: pip install "ptne-env[bench]"') from error
    figure = Figure(figsize=(6.4, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.set_facecolor("#DDDDDD")  # where there is no such scenario
    # First the scales, for labels of contours are placed on those that there are.
    axes.set_xscale("log" if diagram.x.is_logarithmic else "linear")
    axes.set_yscale("log" if diagram.y.is_logarithmic else "linear")
    for axis, side, limit in ((diagram.x, axes.xaxis, axes.set_xlim), (diagram.y, axes.yaxis, axes.set_ylim)):
        edges = _edges(axis)
        limit(float(edges[0]), float(edges[-1]))
        if axis.is_logarithmic:
            side.set_major_locator(LogLocator(subs=(1, 2, 5) if edges[-1] < 5e3 * edges[0] else (1,)))
            side.set_major_formatter(FormatStrFormatter("%g"))
            side.set_minor_formatter(NullFormatter())
    x, y = np.array(diagram.x.values), np.array(diagram.y.values)
    measured, predicted = diagram.grid("measured"), diagram.grid("predicted")
    top = float(np.clip(np.ceil(np.nanmax(measured)), 1.0, CEILING))
    bottom = max(FLOOR, float(np.floor(np.nanmin(measured))))
    mesh = axes.pcolormesh(
        _edges(diagram.x), _edges(diagram.y), measured, cmap="viridis", vmin=bottom, vmax=top, rasterized=True
    )
    levels = np.arange(bottom + 1, top)
    contours = axes.contour(x, y, predicted, levels=levels, colors="white", linewidths=0.8, linestyles="solid")
    axes.clabel(contours, fmt="%g", fontsize=7, inline_spacing=2)
    axes.plot([], [], color="white", linewidth=0.8, label="predicted digits")
    for boundary, colour in zip(diagram.boundaries, _LINES, strict=False):
        axes.plot(boundary.x, boundary.y, color=colour, linewidth=2.2, label=boundary.label)
    axes.set_xlabel(diagram.x.label)
    axes.set_ylabel(diagram.y.label)
    axes.set_title(diagram.title, fontsize=10)
    figure.colorbar(mesh, ax=axes, label=f"measured digits at T, mean of {diagram.episodes}")
    legend = figure.legend(loc="outside lower center", ncols=3, fontsize=8, facecolor="#777777", labelcolor="white")
    legend.get_frame().set_edgecolor("none")
    buffer, kind = io.BytesIO(), path.suffix.removeprefix(".") or "png"
    figure.savefig(buffer, format=kind, dpi=110, metadata={"Software": None} if kind == "png" else None)
    write_atomically(path, buffer.getvalue())


def _edges(axis: Axis) -> FloatArray:
    """Borders of the cells around the values of an axis."""
    values = np.log(axis.values) if axis.is_logarithmic else np.array(axis.values)
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[values[0] - (middle[0] - values[0])], middle, [2 * values[-1] - middle[-1]]])
    return np.asarray(np.exp(edges) if axis.is_logarithmic else edges)
