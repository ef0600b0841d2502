"""HTML from the templates of this package."""

from __future__ import annotations

import html
import re
from typing import Any

from ptne_env.shared.style import DARK, LIGHT

_INDEX = re.compile(
    r"(?<=[\w)*'])(?P<kind>\^|(?<!\w\w)_)"  # an index follows one letter: ptne_env is a name
    r"(?:\{(?P<braces>[^{}]*)\}|\((?P<round>[^()]*)\)|(?P<plain>[-−]?\d+(?:\.\d+)?|[^\W_]+))"
)


def indexed(text: str) -> str:
    """A text as HTML, with indices and exponents, such as those of x^i_j and e^{−r s}, below and above the line."""

    def moved(match: re.Match[str]) -> str:
        tag = "sup" if match["kind"] == "^" else "sub"
        content = next(part for part in match.group("braces", "round", "plain") if part is not None)
        return f"<{tag}>{content.replace('-', '−')}</{tag}>"

    return _INDEX.sub(moved, html.escape(text, quote=False))


def with_minus_signs(text: str) -> str:
    """A text with the sign of minus before numbers, such as −0.1 and [−0.2, 0.1]; exponents such as 1e-6 stay."""
    return re.sub(r"(?<![\w.-])-(?=\d)", "−", text)


def render_template(template: str, **values: Any) -> str:
    """A page from a template of ``ptne_env/bench/report/templates``; it needs no network.

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
        loader=PackageLoader("ptne_env.bench.report"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"indexed": indexed, "with_minus_signs": with_minus_signs}
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False, "separators": (",", ":")}
    return environment.get_template(template).render(light=LIGHT, dark=DARK, **values)
