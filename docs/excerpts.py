# ruff: noqa: INP001 - conf.py imports it from its folder
"""Excerpts of search results where the site is opened from a disk.

Sphinx's search fetches each page that it found to show an excerpt, and browsers fetch nothing from a disk. So the texts
of all pages are written to one script, and a search page with that script answers the fetches from it.
"""

import json
from html import escape
from pathlib import Path

import formulas
from docutils import nodes
from sphinx.application import Sphinx

SCRIPT = "_static/texts.js"


def write_texts(app: Sphinx, error: Exception | None) -> None:
    """Write the texts of all pages, section by section, when the site is complete."""
    if error is None:
        texts = {name: _sections(app.env.get_doctree(name)) for name in sorted(app.env.found_docs)}
        script = f"const TEXTS = {json.dumps(texts, ensure_ascii=False, separators=(',', ':'))};\n"
        (Path(app.outdir) / SCRIPT).write_text(script, encoding="utf-8")


def _sections(node: nodes.Node) -> str:
    """The text below a node; sections keep their elements and identifiers, which search results lead to.

    Of the two names of a type, the short one and the one with its module (condition ``*``), the short one is kept.
    """
    if isinstance(node, nodes.Text):
        return escape(node.astext(), quote=False)
    if isinstance(node, nodes.math | nodes.math_block):
        return escape(formulas.plain(node.astext()), quote=False)
    if isinstance(node, nodes.raw | nodes.Invisible | nodes.comment) or node.get("condition") == "*":
        return ""
    inner = "".join(_sections(child) for child in node.children)
    if isinstance(node, nodes.section):
        return f'<section id="{node["ids"][0]}">{inner}</section>'
    return inner + " " if isinstance(node, nodes.Body | nodes.Part | nodes.Structural) else inner
