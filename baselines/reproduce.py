"""Reproduce the paper: Table I, every figure, and a measured verdict on every claim and erratum.

``python baselines/reproduce.py`` simulates the laws in continuous time, with the matrix exponential as the exact
reference where the game is affine. It prints the tables, and writes the figures and ``results.json`` to the folder
``--out``. It takes about a minute.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ptne_env.bench.report.paper import paper_tables
from ptne_env.bench.report.reproduction import reproduce
from ptne_env.bench.report.terminal import show
from ptne_env.cli.console import console, progress


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/paper"))
    out = parser.parse_args().out
    with progress("reproducing") as advance:
        reproduction = reproduce(out, progress=advance)
    screen = console()
    for table in paper_tables(reproduction):
        screen.print(show(table, screen.width))
    print(f"{len(reproduction.figures)} figures and results.json written to {out}")


if __name__ == "__main__":
    main()
