"""Speed of our environments and of their peers in one run: ``python -m benchmarks.speed [--json FILE] [--quick]``.

Agent-steps per second with random actions and full observations. Contenders take turns, five times each; figures are
medians with their range. With the extra ``[fast]`` our steps are compiled, except those named ``numpy``. Missing peers
are left out and named. The run takes about ten minutes on two cores; ``--quick`` takes seconds and only checks that
everything runs.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks import ours, peers, scaling
from benchmarks.timing import QUICK, Contender, Plan, Spread, interleave, ratio
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.shared.files import write_atomically

INTERFACES = ("physical", "scaled")

BATCHES = (1024, 8192)
"""Environments on the vector path."""

SLOT_ENVIRONMENTS = 64
"""Environments of the Stable-Baselines3 adapter."""

TENSORDICT_ENVIRONMENTS = 256
"""Environments of the TorchRL adapter."""

TARGETS: dict[tuple[str, str], float] = {
    ("single", "physical"): 40.0,
    ("single", "local"): 30.0,
    ("vector 1024", "physical"): 25.0,
    ("vector 1024", "local"): 20.0,
    ("vector 8192", "physical"): 9.0,
    ("vector 8192", "local"): 7.0,
    ("slots", "physical"): 900.0,
    ("slots", "local"): 900.0,
    ("TorchRL", "physical"): 100.0,
    ("TorchRL", "local"): 100.0,
}
"""Wanted speed as a multiple of the peer's."""

ROOFLINE_TARGET = 2.5
"""Largest time of a step as a multiple of the time of a copy of the bytes that it must move."""

_PACKAGES = (
    *("numpy", "pettingzoo", "gymnasium", "numba", "mpe2", "supersuit", "vmas", "stable-baselines3"),
    *("torch", "torchrl"),
)


class _Report:
    """Collects measurements, notes on missing peers, and verdicts on targets."""

    def __init__(self, plan: Plan, console: Console) -> None:
        self.plan = plan
        self.console = console
        self.comparisons: dict[str, Any] = {}
        self.targets: list[dict[str, Any]] = []
        self.notes: list[str] = []

    def available(self, build: Callable[[], Any]) -> Any:
        """The result of ``build``, or ``None`` and a note if a peer is missing."""
        try:
            return build()
        except peers.MissingPeerError as error:
            if str(error) not in self.notes:
                self.notes.append(str(error))
                self.console.print(f"[yellow]{error}[/]")
            return None

    def compare(
        self, group: str, mine: Sequence[Contender], theirs: Sequence[Contender], copy: Contender | None = None
    ) -> None:
        """Measure in turns; compare ours with the fastest peer, and the first of ours with a copy of its bytes."""
        self.console.print(f"measuring: {group}", style="dim")
        rates = interleave([*mine, *theirs, *([copy] if copy else [])], self.plan)
        spreads = {name: Spread.of(values) for name, values in rates.items()}
        best = max(theirs, key=lambda peer: spreads[peer.name].median).name if theirs else None
        ratios = {one.name: ratio(rates, one.name, best) for one in mine} if best else {}
        self.comparisons[group] = {
            "agent_steps_per_second": {name: spread.to_dict() for name, spread in spreads.items()},
            "peer": best,
            "times_as_fast": {name: spread.to_dict() for name, spread in ratios.items()},
        }
        for (of, kind), target in TARGETS.items():
            name = f"ptne_env, {kind}"
            if of == group and name in ratios:
                met = ratios[name].median >= target
                self._judge(f"{group}, {kind}: times as fast as {best}", ratios[name], target, met)
        if copy:
            times = ratio(rates, copy.name, mine[0].name)
            name = f"{group}, physical: times as long as {copy.name}"
            self._judge(name, times, ROOFLINE_TARGET, times.median <= ROOFLINE_TARGET, at_most=True)

    def _judge(self, name: str, measured: Spread, target: float, met: bool, *, at_most: bool = False) -> None:  # noqa: FBT001 - a verdict
        self.targets.append({"name": name, "target": target, **measured.to_dict(), "met": met, "at_most": at_most})


def measure(plan: Plan, console: Console) -> dict[str, Any]:
    """All measurements, as a JSON object."""
    ours.use("compiled")
    report = _Report(plan, console)
    load_before = os.getloadavg() if hasattr(os, "getloadavg") else None

    peer = report.available(peers.mpe2)
    own = [*_both(ours.single), ours.dictionaries()]
    report.compare("single", own, [peer] if peer else [])

    for batch in (8, 16) if plan.quick else BATCHES:
        theirs = report.available(lambda batch=batch: peers.vmas(batch)) or []
        own = _both(lambda kind, batch=batch: ours.vector(kind, batch))
        layout = VectorParallelEnv("energy", 1).layout
        report.compare(f"vector {batch}", own, theirs, scaling.copy_of(layout, batch))

    count = 2 if plan.quick else SLOT_ENVIRONMENTS
    own = report.available(lambda: _both(lambda kind: ours.slots(kind, count)))
    if own:
        peer = report.available(lambda: peers.supersuit(count))
        report.compare("slots", own, [peer] if peer else [])

    count = 2 if plan.quick else TENSORDICT_ENVIRONMENTS
    peer = report.available(lambda: ours.tensordicts("physical", count, is_wrapped=True))
    if peer:
        own = _both(lambda kind: ours.tensordicts(kind, count))
        report.compare("TorchRL", own, [ours.by("compiled", peer)])

    ours.use("compiled")
    console.print("measuring: law rollouts", style="dim")
    laws = {name: Spread.of(rates).to_dict() for name, rates in interleave(ours.law_rollouts(plan), plan).items()}
    console.print("measuring: growth", style="dim")
    copied = scaling.copy_speed(plan)
    return {
        "machine": _machine(load_before),
        "plan": {"repeats": plan.repeats, "seconds": plan.seconds, "quick": plan.quick},
        "comparisons": report.comparisons,
        "targets": report.targets,
        "laws": laws,
        "parts_microseconds": {
            f"{kind}, {batch} env{'s' * (batch > 1)}": ours.parts(kind, batch, plan)
            for batch in (1, 16 if plan.quick else 1024)
            for kind in INTERFACES
        },
        "copy_bytes_per_second": copied.to_dict(),
        "players": scaling.over_players(plan),
        "batch": scaling.over_batch(plan),
        "notes": report.notes,
    }


def _both(build: Callable[[Any], Contender]) -> list[Contender]:
    """Our contenders with compiled steps and with numpy's, under both interfaces."""
    paths: tuple[ours.StepPath, ...] = ("compiled", "numpy")
    return [ours.by(path, build(kind)) for path in paths for kind in INTERFACES]


def _machine(load_before: Sequence[float] | None) -> dict[str, Any]:
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "versions": versions,
        "load_before": list(load_before) if load_before else None,
        "load_after": list(os.getloadavg()) if load_before else None,
    }


def _number(value: float) -> str:
    for limit, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= limit:
            return f"{value / limit:.3g} {unit}"
    return f"{value:.3g}"


def _costs(row: dict[str, Any]) -> list[str]:
    """Nanoseconds of an agent-step, compiled and by numpy."""
    return [f"{row[name]:.4g}" for name in ("nanoseconds_per_agent_step", "nanoseconds_by_numpy")]


def _range(spread: dict[str, float]) -> str:
    return f"{_number(spread['low'])} – {_number(spread['high'])}"


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right")
    return table


def tables(results: dict[str, Any]) -> list[Table]:
    """The results as tables."""
    shown = []
    for group, comparison in results["comparisons"].items():
        table = _table(f"Agent-steps per second: {group}", "contender", "median", "range", "times the peer", "range")
        for name, rate in comparison["agent_steps_per_second"].items():
            times = comparison["times_as_fast"].get(name)
            label = f"{name} (the peer)" if name == comparison["peer"] else name
            cells = (f"{times['median']:.3g}", f"{times['low']:.3g} – {times['high']:.3g}") if times else ("", "")
            table.add_row(label, _number(rate["median"]), _range(rate), *cells)
        shown.append(table)

    table = _table("Agent-steps per second: environment and law together", "law", "median", "range")
    for name, rate in results["laws"].items():
        table.add_row(name, _number(rate["median"]), _range(rate))
    shown.append(table)

    table = _table(
        "Microseconds of the parts of a step, each alone", "batch", *next(iter(results["parts_microseconds"].values()))
    )
    for name, row in results["parts_microseconds"].items():
        table.add_row(name, *(f"{value:.3g}" for value in row.values()))
    shown.append(table)

    table = _table(
        f"Growth with players and neighbours (numpy copies {_number(results['copy_bytes_per_second']['median'])}B/s)",
        "graph", "N", "D", "B", "ns per agent-step", "by numpy", "needs operations", "operations/s", "needs bytes",
        "bytes/s",
    )  # fmt: skip
    for row in results["players"]:
        table.add_row(
            row["graph"],
            *(str(row[name]) for name in ("players", "neighbours", "envs")),
            *_costs(row),
            *(_number(row[name]) for name in ("operations", "operations_per_second", "bytes", "bytes_per_second")),
        )
    shown.append(table)

    table = _table(
        "Growth with environments, N = 5", "interface", "B", "ns per agent-step", "by numpy", "bytes held per env",
        "at the peak", "held, numpy", "at the peak",
    )  # fmt: skip
    for row in results["batch"]:
        memory = [row[path][when] for path in ("bytes_per_env", "bytes_per_env_by_numpy") for when in ("held", "peak")]
        table.add_row(row["interface"], str(row["envs"]), *_costs(row), *map(_number, memory))
    shown.append(table)

    table = _table("Targets", "target", "wanted", "median", "range", "met")
    for row in results["targets"]:
        share = row["target"] < 1
        wanted, *values = (
            f"{row[key]:.2%}" if share else f"{row[key]:.3g}" for key in ("target", "median", "low", "high")
        )
        verdict = "[green]yes[/]" if row["met"] else "[red]no[/]"
        sign = "≤" if row["at_most"] else "≥"
        table.add_row(row["name"], f"{sign} {wanted}", values[0], f"{values[1]} – {values[2]}", verdict)
    shown.append(table)
    return shown


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and write.

    Returns:
        0, also when a target is missed.
    """
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed", description="Speed of our environments and of their peers."
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all measurements to this file")
    parser.add_argument(
        "--quick", action="store_true", help="only check that everything runs; seconds instead of minutes"
    )
    options = parser.parse_args(arguments)
    console = Console(width=None if sys.stdout.isatty() else 120)
    results = measure(QUICK if options.quick else Plan(), console)
    console.print(*tables(results), *results["notes"], sep="\n")
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(options.json, json.dumps(results, indent=2) + "\n")
        console.print(f"wrote {options.json}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
