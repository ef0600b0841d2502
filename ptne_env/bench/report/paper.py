"""Tables of the reproduction: Table I, claims and errata."""

from __future__ import annotations

from collections.abc import Iterable

from ptne_env.bench.report.reproduction import Reproduction
from ptne_env.bench.report.tables import Cell, Column, Table, text_table
from ptne_env.theory.paper import Claim


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
