# ruff: noqa: INP001 - Sphinx reads it by its path
"""The documentation site, built by ``make docs`` from the Markdown files that GitHub shows and from the docstrings."""

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from ptne_env import __version__

project = "ptne_env"
release = __version__
extensions = ["myst_parser", "sphinx.ext.apidoc", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]

# The source folder is the project's, so that documents link to each other as they do on GitHub.
root_doc = "docs/index"
include_patterns = ["*.md", "baselines/*.md", "examples/*.md", "docs/**"]
exclude_patterns = [".*", "build", "dist", "results"]

html_theme = "furo"
html_title = "ptne_env"
html_show_copyright = False

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # GitHub's syntax for displayed formulas
myst_heading_anchors = 4

apidoc_modules = [
    {"path": "../ptne_env", "destination": "docs/api", "separate_modules": True, "module_first": True}
]  # fmt: skip
suppress_warnings = ["ref.python", "toc.not_included"]  # types in docstrings may have two homes; links lead to pages
autodoc_member_order = "bysource"
autodoc_mock_imports = ["jax", "optax", "ray", "stable_baselines3", "tensordict", "torch", "torchrl"]
napoleon_use_ivar = True


def _escape(_app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Escape ``|`` and ``*`` outside of code: docstrings are Unicode formulas, not markup."""
    lines[:] = [re.sub(r"(``.*?``)|([|*])", lambda found: found[1] or f"\\{found[2]}", line) for line in lines]


def _redirect(app: Sphinx, error: Exception | None) -> None:
    """Lead from the address of the site to its first page, which stands in a folder."""
    if error is None:
        page = f'<meta http-equiv="refresh" content="0; url={root_doc}.html">'
        Path(app.outdir, "index.html").write_text(page, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the functions above, the first before napoleon adds markup of its own."""
    app.connect("autodoc-process-docstring", _escape, priority=100)
    app.connect("build-finished", _redirect)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
