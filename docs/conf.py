# ruff: noqa: INP001 - Sphinx reads it by its path
"""The documentation site, built by ``make docs`` from the Markdown files that GitHub shows and from the docstrings."""

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring
from sphinx.util.inspect import TypeAliasForwardRef
from sphinx.writers.html5 import HTML5Translator

from ptne_env import __version__

sys.path.insert(0, str(Path(__file__).parent))
import excerpts
import formulas
import scenario_pages

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
pygments_dark_style = "monokai"
toc_object_entries = False  # thousands of entries, copied for every page, were a fifth of the time of a build

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
    """Convert Google style to reStructuredText, typeset formulas, and escape |, which would mark a substitution."""
    text = "\n".join(GoogleDocstring(lines, Config(napoleon_use_ivar=True)).lines())
    text = formulas.typeset_docstring(text)
    lines[:] = re.sub(r"(``.*?``)|\|", lambda match: match[1] or r"\|", text).splitlines()


def _document(app: Sphinx, name: str, source: list[str]) -> None:
    """Typeset the formulas of a document."""
    if app.env.doc2path(name).suffix == ".md":
        source[0] = formulas.typeset_markdown(source[0])


def _without_field_numbers(_app: Sphinx, _what: str, _name: str, obj: object, *_: object) -> bool | None:
    """Leave out the fields of a NamedTuple: the docstring of the class has them."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def _mathml(translator: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Formulas as MathML, with the length of the longest piece, from which site.css takes the size of letters."""
    block = isinstance(node, nodes.math_block)
    tag = "div" if block else "span"
    pieces, length = formulas.mathml(node.astext(), block=block)
    style = {"style": f"--length: {length:.1f}"} if block or length > 12 else {}
    formula = [translator.starttag(node, tag, "", CLASS="math notranslate", **style), pieces, f"</{tag}>"]
    if not block:
        before, after = (_neighbour(node, step) for step in (-1, 1))
        formula = [_NO_BREAK * before.endswith(("(", "[")), *formula, _NO_BREAK * after.startswith(tuple(",.;:)]!?"))]
    translator.body += formula
    raise nodes.SkipNode


_NO_BREAK = "&#8288;"
"""The word joiner: browsers may break a line beside a formula, also before a comma."""


def _neighbour(node: nodes.Node, step: int) -> str:
    """The text directly before or after a node; empty where there is none."""
    place = node.parent.index(node) + step
    other = node.parent[place] if 0 <= place < len(node.parent) else None
    return str(other.astext()) if isinstance(other, nodes.Text) else ""


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the functions above."""
    app.connect("builder-inited", lambda _: scenario_pages.write_pages())
    app.connect("source-read", _document)
    app.connect("autodoc-process-docstring", _docstring)
    app.connect("autodoc-skip-member", _without_field_numbers)
    app.connect("build-finished", excerpts.write_texts)
    app.add_html_math_renderer("mathml", inline_renderers=(_mathml, None), block_renderers=(_mathml, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
