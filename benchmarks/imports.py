"""How long importing takes, each time in a fresh interpreter: ``python -m benchmarks.imports [--repeats R]``.

Statements take turns; figures are medians with their range, in seconds, the interpreter's own start included. The CPU
column is what the machine had to do, whatever else it did meanwhile.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.table import Table

STATEMENTS = {
    "nothing": "pass",
    "NumPy": "import numpy",
    "Gymnasium and PettingZoo": "import gymnasium, pettingzoo",
    "ptne_env": "import ptne_env",
    "ptne_env and an environment": "import ptne_env; ptne_env.parallel_env('energy')",
    "ptne_env and everything it names": "from ptne_env import *",
}


def seconds(statement: str) -> tuple[float, float]:
    """Elapsed and CPU seconds of a fresh interpreter that runs a statement."""
    before, start = os.times(), perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)  # noqa: S603 - our own interpreter and statements
    elapsed, after = perf_counter() - start, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return elapsed, used


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9, help="interpreters per statement")
    repeats = parser.parse_args(arguments).repeats
    for statement in STATEMENTS.values():
        seconds(statement)  # what is compiled and read once
    rounds = [[seconds(statement) for statement in STATEMENTS.values()] for _ in range(repeats)]
    table = Table("import", "elapsed [s]", "range", "CPU [s]", title=f"Fresh interpreters, median of {repeats}")
    for name, figures in zip(STATEMENTS, np.array(rounds).swapaxes(0, 1), strict=True):
        (elapsed, cpu), low, high = np.median(figures, axis=0), figures[:, 0].min(), figures[:, 0].max()
        table.add_row(name, f"{elapsed:.2f}", f"{low:.2f}–{high:.2f}", f"{cpu:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
