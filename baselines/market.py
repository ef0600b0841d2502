"""The IEEE 118-bus case as a market: the table of its generators, and the picture of what a law does to it.

Run ``python -m baselines.market table`` where PyPI's ``pypower`` is installed, which holds the case.
"""

from __future__ import annotations

import csv
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import networkx as nx

TABLE = Path(str(files("ptne_env.games") / "market_118.csv"))


def generators(case: dict[str, Any]) -> list[tuple[int, float, float, float, str]]:
    """Return the bus, cost coefficients, capacity and neighbours of every generator of a case in MATPOWER's format."""
    grid: nx.Graph[int] = nx.Graph((int(branch[0]), int(branch[1])) for branch in case["branch"])
    buses = [int(generator[0]) for generator in case["gen"]]
    rows = []
    for bus, generator, cost in zip(buses, case["gen"], case["gencost"], strict=True):
        others = set(buses) - {bus}
        inner = nx.node_connected_component(grid.subgraph(set(grid) - others), bus)
        neighbours = sorted(others & set().union(*(grid[node] for node in inner)))
        rows.append((bus, float(cost[4]), float(cost[5]), float(generator[8]), " ".join(map(str, neighbours))))
    return rows


def write_table() -> None:
    """Write the table of the package, and print what stands in no row: the load, and its price at least cost."""
    from pypower.case118 import case118

    case = case118()
    rows = generators(case)
    with TABLE.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("bus", "quadratic", "linear", "capacity", "neighbours"))
        writer.writerows(rows)
    load = float(case["bus"][:, 2].sum())
    low, high = 0.0, 1000.0
    while high - low > 1e-9:
        price = (low + high) / 2
        supply = sum(min(max((price - linear) / (2 * quadratic), 0), most) for _, quadratic, linear, most, _ in rows)
        low, high = (price, high) if supply < load else (low, price)
    print(f"{len(rows)} generators, load {load:g} MW, price at least cost {price:.2f} $/MWh")


if __name__ == "__main__":
    {"table": write_table}[sys.argv[1]]()
