"""Pages that open without a network, from one template: text, tables, charts and the player of an episode."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from gzip import compress
from itertools import cycle
from typing import Any

import numpy as np

from ptne_env.report.dots import DotPlot
from ptne_env.report.tables import Table
from ptne_env.report.traces import Scene
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.style import COLOURS, DARK, LIGHT

_SIGNIFICANT = 2
"""Digits of errors; strategies and estimates have steps of a hundredth of their range at the start, or finer."""


@dataclass(frozen=True)
class Part:
    """A part of a page.

    Attributes:
        title: its heading.
        text: a paragraph below the heading.
        tables: below the text.
        scene: name of the scene of the page whose errors a chart shows.
        caption: of the chart.
        facts: names and values.
        has_player: whether the player of the page stands here.
        is_folded: whether a click on the heading shows the rest.
    """

    title: str
    text: str = ""
    tables: tuple[Table, ...] = ()
    scene: str = ""
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
        dots: the answer as a picture.
        scenes: by name; the player shows them.
    """

    title: str
    parts: tuple[Part, ...]
    question: str = ""
    answer: tuple[str, ...] = ()
    dots: DotPlot | None = None
    scenes: Mapping[str, Scene] = field(default_factory=dict)

    def html(self) -> str:
        """One HTML file with everything that it needs inside.

        Raises:
            ImportError: when Jinja is missing, naming the extra to install.
        """
        try:
            from jinja2 import Environment, PackageLoader, StrictUndefined
        except ImportError as error:
            raise ImportError('pages need Jinja: pip install "ptne-env[bench]"') from error

        names = [
            *(self.dots.kinds if self.dots else ()),
            *(name for each in self.scenes.values() for name in each.traces),
        ]
        policies = dict(zip(dict.fromkeys(names), cycle(COLOURS), strict=False))
        packed = {f"scene-{index}": _packed(_drawn(scene)) for index, scene in enumerate(self.scenes.values())}
        environment = Environment(
            autoescape=True,  # users choose the names of policies
            loader=PackageLoader("ptne_env.report"),
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        made = environment.get_template("page.html").render(
            page=self, packed=packed, light=LIGHT, dark=DARK, colours=COLOURS, policies=policies
        )
        return re.sub(r"\n\s+", "\n", made)  # the indentation of the template is a tenth of the page


def _packed(content: Any) -> str:
    """JSON as gzip in base64: the browser unpacks it when it is shown."""
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    return b64encode(compress(text.encode(), mtime=0)).decode("ascii")


def _drawn(scene: Scene) -> dict[str, Any]:
    """A scene for charts and the player, as a JSON object; numbers that do not exist are ``None``.

    Numbers are as exact as a picture shows them: the digits of noise would be most of the file.
    """
    starts = np.concatenate([scene.equilibrium, *(trace.strategies[:, 0] for trace in scene.traces.values())])
    decimals = 2 - int(np.floor(np.log10(np.ptp(starts) or 1.0)))
    changes = np.flatnonzero(np.r_[True, (np.diff(scene.live, axis=1)).any(axis=0)])
    return {
        "t": scene.t.round(6).tolist(),
        "s": scene.s.round(6).tolist(),
        "gain": _rounded(scene.gain, 3),
        "deadline": scene.deadline_frame,
        "players": int(scene.owners[-1]) + 1,
        "owners": scene.owners.tolist(),
        "equilibrium": scene.equilibrium.round(6).tolist(),
        "links": scene.links.tolist(),
        "live": [[int(frame), np.flatnonzero(scene.live[:, frame]).tolist()] for frame in changes],
        "traces": {
            name: {
                "error": _rounded(trace.error),
                "errors": _rounded(trace.errors if scene.episodes > 1 else trace.errors[1:2]),
                "strategies": _fixed(trace.strategies, decimals),
                "estimates": [] if trace.estimates is None else _fixed(trace.estimates, decimals),
                "inputs": _fixed(trace.inputs, 2),
            }
            for name, trace in scene.traces.items()
        },
    }


def _fixed(values: FloatArray, decimals: int) -> Any:
    """Numbers with so many decimals as nested lists."""
    return _rounded(values.round(decimals) + 0.0, 9)  # no -0.0


def _rounded(values: FloatArray, digits: int = _SIGNIFICANT) -> Any:
    """Numbers with so many significant digits as nested lists."""
    if values.ndim > 1:
        return [_rounded(row, digits) for row in values]
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values]
