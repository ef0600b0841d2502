"""Import times in fresh interpreters: ``python -m benchmarks.imports [--repeats R]``.

Statements take turns; figures are medians with their range, in seconds, including the start of the interpreter. CPU
seconds do not depend on other processes.
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
    "ptne_env and all public names": "from ptne_env import *",
}


def seconds(statement: str) -> tuple[float, float]:
    """Elapsed and CPU seconds of a fresh interpreter that runs a statement."""
    before, start = os.times(), perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)  # noqa: S603 - our own statements
    elapsed, after = perf_counter() - start, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return elapsed, used


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9, help="interpreters per statement")
    repeats = parser.parse_args(arguments).repeats
    for statement in STATEMENTS.values():
        seconds(statement)  # compiles and reads files
    rounds = [[seconds(statement) for statement in STATEMENTS.values()] for _ in range(repeats)]
    table = Table("import", "elapsed [s]", "range", "CPU [s]", title=f"Fresh interpreters, median of {repeats}")
    for name, figures in zip(STATEMENTS, np.array(rounds).swapaxes(0, 1), strict=True):
        (elapsed, cpu), low, high = np.median(figures, axis=0), figures[:, 0].min(), figures[:, 0].max()
        table.add_row(name, f"{elapsed:.2f}", f"{low:.2f}–{high:.2f}", f"{cpu:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
