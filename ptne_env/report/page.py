"""Pages that open without a network: a report with tables, figures and a player, and a single episode."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping
from gzip import compress
from importlib import resources
from typing import Any

from ptne_env.experiments.traces import Scene
from ptne_env.report.content import Report, drawn
from ptne_env.style import COLOURS, DARK, LIGHT


def render_page(report: Report) -> str:
    """A report as HTML, with everything that it needs inside.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    scenes = {section.name: drawn(report.scenes[section.name], section.shown) for section in report.sections}
    figures = {
        "colours": COLOURS,
        "policies": report.policies,
        "profiles": report.profiles,
        "thresholds": report.thresholds,
        "shown": report.sections[0].shown,
        "scenes": list(scenes),
    }
    plotly = resources.files("ptne_env.report") / "plotly" / "plotly-basic.min.js"
    packed = _packed(scenes) | {"plotly": _pack(plotly.read_text(encoding="utf-8"))}
    return render_template(
        "page.html", title=report.title, kind=report.kind, report=report, figures=figures, packed=packed
    )


def render_episode(name: str, scene: Scene) -> str:
    """The player alone, as HTML, with the first episode of every policy of a scene side by side.

    Args:
        name: of the scenario.
        scene: what happened there.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    policies = list(scene.traces)
    figures = {"colours": COLOURS, "policies": policies, "scenes": [name]}
    packed = _packed({name: drawn(scene, policies)})
    title = f"{name}: {', '.join(policies)}"
    return render_template("episode.html", title=title, kind="scenario", figures=figures, packed=packed)


def _packed(scenes: Mapping[str, Any]) -> dict[str, str]:
    """Every scene by itself, as a browser unpacks it only when somebody looks at it."""
    return {
        f"scene-{index}": _pack(json.dumps(scene, allow_nan=False, ensure_ascii=False, separators=(",", ":")))
        for index, scene in enumerate(scenes.values())
    }


def _pack(text: str) -> str:
    return b64encode(compress(text.encode(), mtime=0)).decode("ascii")


def render_template(template: str, **values: Any) -> str:
    """A page from a template of ``ptne_env/report/templates``.

    Args:
        template: its file name.
        **values: what the template names.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError as error:
        raise ImportError('pages need Jinja: pip install "ptne-env[bench]"') from error

    environment = Environment(
        autoescape=True,  # names of policies are their users' own
        loader=PackageLoader("ptne_env.report"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False, "separators": (",", ":")}
    return environment.get_template(template).render(light=LIGHT, dark=DARK, **values)
