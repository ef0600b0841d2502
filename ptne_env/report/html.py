"""HTML from the templates of this package."""

from __future__ import annotations

from typing import Any

from ptne_env.style import DARK, LIGHT


def render_template(template: str, **values: Any) -> str:
    """A page from a template of ``ptne_env/report/templates``; it needs no network.

    Args:
        template: the file name.
        **values: the variables of the template.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError as error:
        raise ImportError('pages need Jinja: pip install "ptne-env[bench]"') from error

    environment = Environment(
        autoescape=True,  # users choose the names of policies
        loader=PackageLoader("ptne_env.report"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False, "separators": (",", ":")}
    return environment.get_template(template).render(light=LIGHT, dark=DARK, **values)
