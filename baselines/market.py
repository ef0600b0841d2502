"""The IEEE 118-bus case as a market: the table of its generators, and the picture of what laws do to it.

``python -m baselines.market table`` writes the table, where PyPI's ``pypower`` is installed, which holds the case;
``python -m baselines.market picture`` writes ``docs/images/market.png``.
"""

from __future__ import annotations

import argparse
import csv
from typing import Any

import networkx as nx
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

from baselines.published import ROOT
from ptne_env import record
from ptne_env.shared.style import COLOURS, INK, drawing

TABLE, PICTURE = ROOT / "ptne_env" / "games" / "market_118.csv", ROOT / "docs" / "images" / "market.png"
TRACK, LAWS = "ptne-v1/market-118", ("relay", "routed-unknown", "static")


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

    def excess(price: float) -> float:
        supply = (min(max((price - linear) / (2 * quadratic), 0), most) for _, quadratic, linear, most, _ in rows)
        return sum(supply) - load

    price = brentq(excess, 0, 1000)
    print(f"{len(rows)} generators, load {load:g} MW, price at least cost {price:.2f} $/MWh")


def draw_picture() -> None:
    """Draw the price under several laws, and all outputs under the first of them, in the first episode of the track."""
    runs = {law: record(law, TRACK) for law in LAWS}
    run, strategies = runs[LAWS[0]], {law: run.strategies[:, :, 0].T for law, run in runs.items()}
    market: Any = run.episodes.initial_state(run.rollout.world).game
    equilibrium = run.nash_equilibria[:, 0]
    steps = np.arange(len(run.t))
    kinds = {"at capacity": equilibrium == market.high, "stopped": equilibrium == 0}
    kinds["between"] = ~(kinds["at capacity"] | kinds["stopped"])
    with drawing("figures"):
        figure = Figure(figsize=(8, 3.4), dpi=130, layout="constrained")
        left, right = figure.subplots(1, 2)
        for law, colour in zip(LAWS, COLOURS, strict=False):
            price = market.price(strategies[law])
            left.plot(steps, price, color=colour, label=law)
        at_rest = float(market.price(equilibrium[:, None])[0])
        left.axhline(at_rest, color=INK, linestyle=":", linewidth=1, label="equilibrium")
        left.set(title="Price in $/MWh", xlabel="step", xlim=(0, steps[-1]))
        left.legend()
        for (kind, firms), colour in zip(kinds.items(), ("#d55e00", "#7f7f7f", "#0072b2"), strict=True):
            lines = strategies[LAWS[0]][firms]
            for line in lines:
                right.plot(steps, line, color=colour, linewidth=0.8, alpha=0.8)
            right.plot([], [], color=colour, label=f"{kind} at the equilibrium ({len(lines)})")
            right.plot(np.full(len(lines), steps[-1]), equilibrium[firms], "o", color=colour, markersize=3)
        right.set(title=f"Outputs in MW under {LAWS[0]}; dots: equilibrium", xlabel="step", xlim=(0, steps[-1] + 3))
        right.set_ylim(top=1.35 * right.get_ylim()[1])  # room for the legend
        right.legend(loc="upper left")
        figure.savefig(PICTURE)
    print(f"written: {PICTURE}; price at the equilibrium {at_rest:.2f} $/MWh")


def main() -> None:
    """Do what the command line says."""
    jobs = {"table": write_table, "picture": draw_picture}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("job", choices=jobs)
    jobs[parser.parse_args().job]()


if __name__ == "__main__":
    main()
