"""Reproduce the paper: Table I, every figure, and a measured verdict on every claim and erratum.

``python -m baselines.reproduce`` simulates the laws in continuous time, with the matrix exponential as the exact
reference where the game is affine. It prints the tables, and writes the figures and ``results.json`` to the folder
``--out``. It takes about a minute.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table as RichTable

from baselines.paper.claims import CLAIMS, Claim
from baselines.paper.errata import ERRATA
from baselines.paper.experiments import DEADLINE, GAIN, GAMMA, INITIAL_GAIN, S_END, Experiments
from baselines.paper.figures import FIGURES, draw
from baselines.paper.table import TableRow, table_one
from ptne_env import __version__
from ptne_env.cli.console import console, progress
from ptne_env.report.tables import Cell, Column, Table
from ptne_env.report.terminal import draw_table
from ptne_env.shared.files import write_atomically

CHECKS = (*CLAIMS, *ERRATA)
"""All measurements, in the order of the paper and of docs/errata.md."""


@dataclass(frozen=True)
class Reproduction:
    """Results of :func:`reproduce`.

    Attributes:
        table: the rows of Table I.
        claims: every claim and erratum with its verdict.
        figures: the figure files, an SVG per figure.
    """

    table: tuple[TableRow, ...]
    claims: tuple[Claim, ...]
    figures: tuple[Path, ...]

    def to_dict(self) -> dict[str, Any]:
        """A JSON object without NaN or infinite numbers, the same in every run."""
        numbers = {"deadline": DEADLINE, "gain": GAIN, "gamma": GAMMA, "initial_gain": INITIAL_GAIN, "s_end": S_END}
        return {
            "version": __version__,
            "settings": numbers | {"graph": "5-cycle"},
            "table_1": [dataclasses.asdict(row) for row in self.table],
            "claims": [dataclasses.asdict(claim) for claim in self.claims],
            "figures": [path.name for path in self.figures],
        }


def reproduce(out: Path) -> Reproduction:
    """Run every experiment of the paper, and write its table, figures (SVG) and claims to the folder ``out``.

    Raises:
        ImportError: naming the extra to install when matplotlib is missing.
        NotADirectoryError: when ``out`` is a file.
    """
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out} is a file; name a directory to write the figures to")
    out.mkdir(parents=True, exist_ok=True)
    experiments, claims, figures, total = Experiments(), list[Claim](), list[Path](), len(CHECKS) + len(FIGURES)
    with progress("reproducing") as advance:
        for done, check in enumerate(CHECKS):
            advance(check.__name__.replace("_", " ").capitalize(), done, total)
            claims += check(experiments)
        for done, spec in enumerate(FIGURES, len(CHECKS)):
            advance(f"Figure {spec.name}", done, total)
            figures.append(out / f"{spec.name}.svg")
            write_atomically(figures[-1], draw(spec, experiments))
    reproduction = Reproduction(table_one(experiments), tuple(claims), tuple(figures))
    text = json.dumps(reproduction.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
    write_atomically(out / "results.json", text + "\n")
    return reproduction


def draw_table_one(reproduction: Reproduction, width: int) -> RenderableType:
    """Table I beside the paper's, for a terminal of ``width`` columns."""
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
    return draw_table(table, width)


def draw_verdicts(reproduction: Reproduction) -> Iterator[RenderableType]:
    """The claims of the paper with their verdicts, and the errata."""
    for caption, is_erratum in (("Claims of the paper", False), ("Errata of the paper", True)):
        table = RichTable("", "verdict", "says", "measured", title=caption, title_justify="left", box=box.SIMPLE_HEAD)
        for claim in reproduction.claims:
            if claim.name.startswith("Erratum") == is_erratum:
                colour = "green" if claim.verdict == "holds" else "red"
                table.add_row(claim.name, f"[{colour}]{claim.word}[/]", escape(claim.statement), escape(claim.finding))
        yield table


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/paper"))
    out = parser.parse_args().out
    reproduction = reproduce(out)
    screen = console()
    screen.print(draw_table_one(reproduction, screen.width), *draw_verdicts(reproduction), sep="\n")
    print(f"{len(reproduction.figures)} figures and results.json written to {out}")


if __name__ == "__main__":
    main()
