"""Reproduction of the whole paper: Table I, figures, claims and errata, as files and as tables in a terminal."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ptne_env._version import __version__
from ptne_env.shared.files import write_atomically
from ptne_env.theory.paper.claims import CLAIMS, Claim
from ptne_env.theory.paper.errata import ERRATA
from ptne_env.theory.paper.experiments import DEADLINE, GAIN, GAMMA, INITIAL_GAIN, S_END, Experiments
from ptne_env.theory.paper.figures import FIGURES, draw, draw_panels
from ptne_env.theory.paper.page import render_page
from ptne_env.theory.paper.table import TableRow, table_one

if TYPE_CHECKING:
    from rich.table import Table

RESULTS_FILE, PAGE_FILE = "results.json", "index.html"

CHECKS = (*CLAIMS, *ERRATA)
"""All measurements, in the order of the paper and of docs/errata.md."""

_SETTINGS = {
    "deadline": DEADLINE,
    "gain": GAIN,
    "gamma": GAMMA,
    "initial_gain": INITIAL_GAIN,
    "s_end": S_END,
    "graph": "5-cycle",
}


@dataclass(frozen=True)
class Reproduction:
    """Results of :func:`reproduce`.

    Attributes:
        table: the rows of Table I.
        claims: every claim and erratum with its verdict.
        figures: the figure files, a PNG and an SVG per figure.
        results: the JSON file with all numbers.
        page: the HTML page.
        seconds: duration.
    """

    table: tuple[TableRow, ...]
    claims: tuple[Claim, ...]
    figures: tuple[Path, ...]
    results: Path
    page: Path
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """A JSON object without NaN or infinite numbers, the same in every run."""
        return {
            "version": __version__,
            "settings": _SETTINGS,
            "table_1": [dataclasses.asdict(row) for row in self.table],
            "claims": [dataclasses.asdict(claim) for claim in self.claims],
            "figures": [path.name for path in self.figures],
        }


def reproduce(out: Path, *, progress: Callable[[int, int, str], None] | None = None) -> Reproduction:
    """Run every experiment of the paper and write its table, figures and claims to ``out``.

    Args:
        out: directory for the figures (PNG and SVG), ``results.json`` and ``index.html``; created if missing.
        progress: called as ``progress(done, total, part)`` before each part and at the end.

    Raises:
        ImportError: naming the extra to install when matplotlib or Jinja is missing.
        NotADirectoryError: when ``out`` is a file.
    """
    began = time.perf_counter()
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out} is a file; name a directory to write the figures to")
    out.mkdir(parents=True, exist_ok=True)
    experiments, total, done = Experiments(), 1 + len(CHECKS) + len(FIGURES), 0

    def announce(part: str) -> None:
        nonlocal done
        if progress is not None:
            progress(done, total, part)
        done += 1

    announce("Table I")
    table = table_one(experiments)
    claims: list[Claim] = []
    for check in CHECKS:
        announce(check.__name__.replace("_", " ").capitalize())
        claims += check(experiments)
    figures: list[Path] = []
    pictures: dict[str, list[str]] = {}
    for spec in FIGURES:
        announce(f"Figure {spec.name}")
        figures += [out / f"{spec.name}.png", out / f"{spec.name}.svg"]
        write_atomically(figures[-2], draw(spec, experiments, "png"))
        write_atomically(figures[-1], draw(spec, experiments, "svg"))
        pictures[spec.name] = draw_panels(spec, experiments)
    announce("Done")
    results, page = out / RESULTS_FILE, out / PAGE_FILE
    write_atomically(page, render_page(table, claims, pictures, _SETTINGS, str(out)))
    reproduction = Reproduction(table, tuple(claims), tuple(figures), results, page, time.perf_counter() - began)
    write_atomically(results, json.dumps(reproduction.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    return reproduction


def render(reproduction: Reproduction) -> tuple[Table, Table]:
    """Two rich tables for a terminal: Table I beside the paper's, and every claim with its verdict.

    Raises:
        ImportError: naming the extra to install when rich is missing.
    """
    try:
        from rich.table import Table  # rich is an extra
        from rich.text import Text
    except ImportError as error:
        raise ImportError('terminal tables need rich: pip install "ptne-env[bench]"') from error
    times = Table(title="Table I: seconds until the strategies are within 0.5 % of the equilibrium")
    times.add_column("Algorithm")
    for heading in ("κ", "c [1/s]", "Paper [s]", "Ours [s]", "Error at the paper's time"):
        times.add_column(Text(heading), justify="right")  # Text, so that brackets are not markup
    for row in reproduction.table:
        ours = "never" if row.ours is None else f"{row.ours:.2f}"
        cells = (row.algorithm, f"{row.kappa:g}", f"{row.gain:g}", f"{row.paper:g}", ours, f"{row.at_paper_time:.2g}")
        times.add_row(*cells)
    verdicts = Table(
        title="Claims and errata, each decided by measurement",
        caption="An erratum is confirmed when the measurement agrees with docs/errata.md.",
        show_lines=True,
    )
    verdicts.add_column("Claim", ratio=3)
    verdicts.add_column("Verdict", no_wrap=True)
    verdicts.add_column("Measured", ratio=6)
    for claim in reproduction.claims:
        colour = "green" if claim.verdict == "holds" else "red"
        verdicts.add_row(Text(claim.name), Text(claim.word, style=colour), Text(claim.finding))
    return times, verdicts
