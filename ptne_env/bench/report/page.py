"""Pages that open without a network, from one template: text, tables, charts and the player of an episode."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from gzip import compress
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from ptne_env.bench.report.style import COLOURS, DARK, LIGHT
from ptne_env.bench.report.tables import Table
from ptne_env.bench.report.traces import Scene
from ptne_env.shared.arrays import FloatArray
from ptne_env.world import distances

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_SIGNIFICANT = 3
"""Digits of the numbers that the player draws."""


@dataclass(frozen=True)
class Part:
    """A part of a page.

    Attributes:
        title: its heading.
        text: a paragraph below the heading.
        tables: below the text.
        scene: whose errors a chart shows.
        picture: an SVG file.
        caption: of the chart or the picture.
        facts: names and values.
        has_player: whether the player of the page stands here.
        is_folded: whether a click on the heading shows the rest.
    """

    title: str
    text: str = ""
    tables: tuple[Table, ...] = ()
    scene: Scene | None = None
    picture: bytes = b""
    caption: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    has_player: bool = False
    is_folded: bool = False


@dataclass(frozen=True)
class Page:
    """The content of a page.

    Attributes:
        title: of the page.
        parts: in their order.
        question: that the page answers.
        answer: in sentences.
        scenes: by name; the player shows them.
    """

    title: str
    parts: tuple[Part, ...]
    question: str = ""
    answer: tuple[str, ...] = ()
    scenes: Mapping[str, Scene] = field(default_factory=dict)

    def html(self) -> str:
        """One HTML file with everything that it needs inside.

        Raises:
            ImportError: when Jinja or Plotly is missing, naming the extra to install.
        """
        try:
            from jinja2 import Environment, PackageLoader, StrictUndefined
            from plotly.offline import get_plotlyjs
        except ImportError as error:
            raise ImportError('pages need Jinja and Plotly: pip install "ptne-env[bench]"') from error

        names = dict.fromkeys(name for scene in self.scenes.values() for name in scene.traces)
        colours = dict(zip(names, cycle(COLOURS), strict=False))
        packed = {f"scene-{index}": _packed(_drawn(scene)) for index, scene in enumerate(self.scenes.values())}
        for index, part in enumerate(self.parts):
            if part.scene is not None:
                packed |= {f"chart-{index}": _packed(error_chart(part.scene, colours).to_json()), "plotly": ""}
        if "plotly" in packed:
            packed["plotly"] = _packed(get_plotlyjs())
        environment = Environment(
            autoescape=True,  # users choose the names of policies
            loader=PackageLoader("ptne_env.bench.report"),
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters["base64"] = lambda data: b64encode(data).decode("ascii")
        return environment.get_template("page.html").render(
            page=self, packed=packed, light=LIGHT, dark=DARK, colours=COLOURS
        )


def error_chart(scene: Scene, colours: Mapping[str, str]) -> Figure:
    """The error of every policy of a scene over time: the median, and a band where there are several episodes.

    Args:
        scene: of a track.
        colours: by policy.

    Raises:
        ImportError: when Plotly is missing.
    """
    from plotly.graph_objects import Figure

    figure = Figure()
    for name, trace in scene.traces.items():
        low, middle, high = np.maximum(trace.errors, distances.FLOOR)
        common = {"mode": "lines", "legendgroup": name, "name": name}
        if scene.episodes > 1:
            band = {"fill": "toself", "fillcolor": colours[name], "line_width": 0, "opacity": 0.2}
            around = (np.r_[scene.t, scene.t[::-1]], np.r_[low, high[::-1]])
            figure.add_scatter(x=around[0], y=around[1], hoverinfo="skip", showlegend=False, **band, **common)
        figure.add_scatter(x=scene.t, y=middle, line_color=colours[name], **common)
    figure.add_vline(scene.t[scene.deadline_frame], line_dash="dot", line_width=1, line_color="#808080")
    figure.update_xaxes(title="time t [s]")
    figure.update_yaxes(title="relative error of estimates", type="log", exponentformat="power", dtick=2)
    transparent = "rgba(0,0,0,0)"
    return figure.update_layout(
        template="none",
        height=400,
        margin={"l": 60, "r": 10, "t": 10, "b": 45},
        font_family="inherit",
        paper_bgcolor=transparent,
        plot_bgcolor=transparent,
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom"},
    )


def _packed(content: Any) -> str:
    """A text, or something else as JSON, as gzip in base64: the browser unpacks it when it is shown."""
    text = content if isinstance(content, str) else json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    return b64encode(compress(text.encode(), mtime=0)).decode("ascii")


def _drawn(scene: Scene) -> dict[str, Any]:
    """A scene for the player, as a JSON object; numbers that do not exist are ``None``.

    Strategies and estimates are given as distances from the equilibrium, which keeps the last digits of small ones.
    """
    x = scene.equilibrium
    changes = np.flatnonzero(np.r_[True, (np.diff(scene.live, axis=1)).any(axis=0)])
    return {
        "t": scene.t.round(6).tolist(),
        "s": scene.s.round(6).tolist(),
        "gain": _rounded(scene.gain),
        "deadline": scene.deadline_frame,
        "players": int(scene.owners[-1]) + 1,
        "owners": scene.owners.tolist(),
        "equilibrium": x.round(6).tolist(),
        "links": scene.links.tolist(),
        "live": [[int(frame), np.flatnonzero(scene.live[:, frame]).tolist()] for frame in changes],
        "traces": {
            name: {
                "error": _rounded(trace.error),
                "strategies": _rounded(trace.strategies - x[:, None]),
                "estimates": [] if trace.estimates is None else _rounded(trace.estimates - x[:, None, None]),
                "inputs": _rounded(trace.inputs),
            }
            for name, trace in scene.traces.items()
        },
    }


def _rounded(values: FloatArray) -> Any:
    """Numbers with few digits as nested lists."""
    if values.ndim > 1:
        return [_rounded(row) for row in values]
    return [float(f"{value:.{_SIGNIFICANT}g}") if np.isfinite(value) else None for value in values]
