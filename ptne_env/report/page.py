"""A report as one page that opens without a network: tables, figures and a player of episodes."""

from __future__ import annotations

from ptne_env.report.content import Report


def render_page(report: Report) -> str:
    """The page as HTML, with everything that it needs inside.

    Raises:
        ImportError: when Jinja or Plotly is missing, naming the extra to install.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
        from markupsafe import Markup
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ImportError('the report page needs an extra: pip install "ptne-env[bench]"') from error

    environment = Environment(
        autoescape=True,  # names of policies are their users' own
        loader=PackageLoader("ptne_env.report"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False, "separators": (",", ":")}
    plotly = Markup(get_plotlyjs())  # noqa: S704 - the library's own script, not anybody's input
    return environment.get_template("page.html").render(report=report, figures=report.figures(), plotly=plotly)
