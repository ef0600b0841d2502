"""Pages that open without a network: a report with tables, figures and a player, and a single episode."""

from __future__ import annotations

from typing import Any

from ptne_env.evaluation.traces import Scene
from ptne_env.report.content import Report, drawn

_MISSING = 'pages need an extra: pip install "ptne-env[bench]"'


def render_page(report: Report) -> str:
    """A report as HTML, with everything that it needs inside.

    Raises:
        ImportError: when Jinja or Plotly is missing, naming the extra to install.
    """
    try:
        from markupsafe import Markup
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ImportError(_MISSING) from error

    plotly = Markup(get_plotlyjs())  # noqa: S704 - the library's own script, not anybody's input
    figures = report.figures()
    return _render("page.html", title=report.title, kind=report.kind, report=report, figures=figures, plotly=plotly)


def render_episode(name: str, scene: Scene) -> str:
    """The player alone, as HTML, with the first episode of every policy of a scene side by side.

    Args:
        name: of the scenario.
        scene: what happened there.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    policies = list(scene.traces)
    figures = {"policies": policies, "profiles": {}, "scenes": [drawn(name, scene, policies)]}
    return _render("episode.html", title=f"{name}: {', '.join(policies)}", kind="scenario", figures=figures)


def _render(template: str, **values: Any) -> str:
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError as error:
        raise ImportError(_MISSING) from error

    environment = Environment(
        autoescape=True,  # names of policies are their users' own
        loader=PackageLoader("ptne_env.report"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False, "separators": (",", ":")}
    return environment.get_template(template).render(**values)
