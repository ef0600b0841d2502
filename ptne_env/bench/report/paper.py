"""The page of the reproduction: Table I, figures, claims and errata."""

from __future__ import annotations

from collections.abc import Iterable

from ptne_env.bench.report.figures import FIGURES
from ptne_env.bench.report.page import Page, Part
from ptne_env.bench.report.reproduction import Reproduction
from ptne_env.bench.report.tables import Cell, Column, Table, text_table
from ptne_env.theory.paper import Claim

_QUESTION = (
    "Do the control laws of Z. Feng and G. Hu, Prescribed-Time Fully Distributed Nash Equilibrium Seeking in "
    "Noncooperative Games, do what the paper claims?"
)


def paper_tables(reproduction: Reproduction) -> tuple[Table, Table, Table]:
    """Table I beside the paper's, the claims with their verdicts, and the errata.

    Args:
        reproduction: of :func:`~ptne_env.bench.report.reproduction.reproduce`.
    """
    rows = {row.algorithm: row for row in reproduction.table}
    columns = {
        "κ": {name: Cell.of(row.kappa) for name, row in rows.items()},
        "c [1/s]": {name: Cell.of(row.gain) for name, row in rows.items()},
        "paper [s]": {name: Cell.of(row.paper) for name, row in rows.items()},
        "ours [s]": {name: Cell("never") if row.ours is None else Cell.of(row.ours) for name, row in rows.items()},
        "error at the paper's time": {name: Cell.of(row.at_paper_time) for name, row in rows.items()},
    }
    table = Table(
        "Table I: seconds until the strategies stay within 0.5 % of the equilibrium",
        "algorithm",
        tuple(rows),
        tuple(Column(label, cells) for label, cells in columns.items()),
        ("Example 1 on the 5-cycle, our choice: our copy of the paper lacks its graph.",),
    )
    errata = [claim for claim in reproduction.claims if claim.name.startswith("Erratum")]
    stated = [claim for claim in reproduction.claims if claim not in errata]
    return table, _verdicts("Claims of the paper", stated), _verdicts("Errata of the paper", errata)


def _verdicts(caption: str, claims: Iterable[Claim]) -> Table:
    rows = ((claim.name, claim.word, claim.statement, claim.finding) for claim in claims)
    return text_table(caption, "", ("verdict", "says", "measured"), rows)


def paper_page(reproduction: Reproduction, command: str) -> str:
    """The reproduction as one HTML file.

    Args:
        reproduction: of :func:`~ptne_env.bench.report.reproduction.reproduce`.
        command: that repeats it.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    table, claims, errata = paper_tables(reproduction)
    failing = [claim.name for claim in reproduction.claims if claim.verdict == "fails"]
    stated = len(claims.rows)
    failed = [name for name in failing if name in claims.rows]
    answer = f"{stated - len(failed)} of {stated} claims hold when measured. Failing: {'; '.join(failed) or 'none'}."
    pictures = {path.stem: path.read_bytes() for path in reproduction.figures}
    figures = (
        Part(f"{spec.number}: {spec.name}", picture=pictures[spec.name], caption=spec.caption) for spec in FIGURES
    )
    return Page(
        title="The paper reproduced",
        question=_QUESTION,
        answer=(answer,),
        parts=(
            Part("Table I", tables=(table,)),
            *figures,
            Part("Claims", tables=(claims,)),
            Part("Errata", "Errors of the paper; docs/errata.md explains each of them.", (errata,)),
            Part("Reproduce", facts=(("command", command),)),
        ),
    ).html()
