# ruff: noqa: INP001 - Sphinx reads it by its path
"""The documentation site, built by ``make docs`` from the Markdown files that GitHub shows and from the docstrings."""

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring
from sphinx.util.inspect import TypeAliasForwardRef
from sphinx.writers.html5 import HTML5Translator

from ptne_env import __version__

project = "ptne_env"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc"]

# The source folder is the project's, so that documents link to each other as they do on GitHub.
root_doc = "docs/index"
include_patterns = ["*.md", "baselines/*.md", "examples/*.md", "docs/**"]
exclude_patterns = [".*", "build", "dist", "results"]

html_theme = "furo"
html_title = "ptne_env"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
templates_path = ["templates"]
html_additional_pages = {"index": "redirect.html"}
html_math_renderer = "mathml"

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # GitHub's syntax for displayed formulas
myst_heading_anchors = 4

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_mock_imports = ["llvmlite", "numba", "ray", "torchrl", "tensordict", "benchmarl"]  # extras not needed here
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    name: name for name in ("Array", "BoolArray", "CounterArray", "Float32Array", "FloatArray", "IntArray", "Memory")
}
TypeAliasForwardRef.__repr__ = lambda alias: alias.name  # Sphinx prints its wrapper within tuples and dictionaries
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100


def _docstring(_app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Convert Google style to reStructuredText and escape |x|, which reStructuredText would take for a substitution."""
    text = "\n".join(GoogleDocstring(lines, Config(napoleon_use_ivar=True)).lines())
    lines[:] = re.sub(r"(``.*?``)|\|", lambda match: match[1] or r"\|", text).splitlines()


def _without_field_numbers(_app: Sphinx, _what: str, _name: str, obj: object, *_: object) -> bool | None:
    """Leave out the fields of a NamedTuple: the docstring of the class has them."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def _mathml(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Formulas as MathML, which needs neither a script nor a network."""
    block = isinstance(node, nodes.math_block)
    tag = "div" if block else "span"
    formula = re.sub(
        r'<mo( class="mathopen")?>(?=[‖|])',  # by default the left one of a pair stretches, and the right one has a gap
        lambda match: f'<mo stretchy="false" form="{"prefix" if match[1] else "postfix"}">',
        tex2mathml(node.astext(), as_block=block),
    )
    translator.body += [translator.starttag(node, tag, "", CLASS="math notranslate"), formula, f"</{tag}>"]
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the functions above."""
    app.connect("autodoc-process-docstring", _docstring)
    app.connect("autodoc-skip-member", _without_field_numbers)
    app.add_html_math_renderer("mathml", inline_renderers=(_mathml, None), block_renderers=(_mathml, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
