"""The HTML page of the reproduction: Table I, figures with the paper's captions, claims and verdicts."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from ptne_env.bench.report.html import render_template
from ptne_env.evaluation.provenance import versions
from ptne_env.theory.paper.claims import Claim
from ptne_env.theory.paper.figures import FIGURES
from ptne_env.theory.paper.table import TableRow

_ERRATUM = "Erratum"
"""Prefix of the names of errata."""


def render_page(
    table: Sequence[TableRow],
    claims: Sequence[Claim],
    pictures: Mapping[str, Sequence[str]],
    settings: Mapping[str, object],
    out: str,
) -> str:
    """Table I, every figure, claim and erratum as HTML.

    Args:
        table: Table I.
        claims: claims and errata.
        pictures: the SVG elements of each figure by its name, see :func:`ptne_env.theory.paper.figures.draw_panels`.
        settings: settings of the experiments.
        out: folder of the results, for the command that reproduces them.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    places = {claim.name: place for place, claim in enumerate(claims)}
    figures = [
        {
            "spec": spec,
            "panels": pictures[spec.name],
            "claims": [claims[places[name]] for name in spec.claims],
        }
        for spec in FIGURES
    ]
    found = {f"{name} version": version for name, version in versions().items() if name != "sources"}
    stated = [claim for claim in claims if not claim.name.startswith(_ERRATUM)]
    return render_template(
        "paper.html",
        title="The paper reproduced",
        answer=_answer(stated),
        table=table,
        figures=figures,
        claims=stated,
        errata=[claim for claim in claims if claim.name.startswith(_ERRATUM)],
        places=places,
        command=shlex.join(["ptne", "reproduce", "--out", out]),
        settings=[(name.replace("_", " "), str(value)) for name, value in {**settings, **found}.items()],
    )


def _answer(claims: Sequence[Claim]) -> str:
    failing = [claim.name for claim in claims if claim.verdict == "fails"]
    return f"{len(claims) - len(failing)} of {len(claims)} claims hold when measured. Failing: " + (
        "; ".join(failing) or "none"
    )
