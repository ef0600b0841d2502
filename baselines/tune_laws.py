"""Tune the laws of the field for a suite: the best mean digits over its tracks, on the validation split.

Run it as ``python baselines/tune_laws.py``. It prints every candidate with its mean, the best of each law first; the
entries of ``ptne_env/evaluation/policy_specs.py`` have these parameters. The paper's laws have the paper's.
"""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from common import Jobs, Ray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ptne_env import FactorySpec
from ptne_env.evaluation import PolicySpec, Workers, run_suite

GRIDS: dict[str, dict[str, tuple[Any, ...]]] = {
    "Static": {"kappa": (2.0, 2.5, 3.0, 3.5), "gradient_gain": (2.0, 2.5, 3.0, 3.5)},
    "FixedGain": {"kappa": (1.5, 2.0, 2.5, 3.0)},
    "AdaptiveGrounded": {"gamma": (0.0001, 0.001, 0.01), "initial_gain": (2.0, 3.0, 4.0, 5.0)},
    "ProjectedGradient": {"step": (0.2, 0.3, 0.4, 0.5), "mixing": (0.2, 0.3, 0.45)},
}
"""The values of each parameter, by law."""


def candidates(law: str) -> Iterator[FactorySpec]:
    """A factory spec for every point of the law's grid."""
    grid = GRIDS[law]
    for values in product(*grid.values()):
        yield FactorySpec.of(f"ptne_env.laws:{law}", **dict(zip(grid, values, strict=True)))


def main(
    suite: str = "ptne-v1",
    law: Annotated[list[str] | None, typer.Option(help="A law by its class; repeat for several.")] = None,
    episodes: int = 20,
    folder: Path = Path("results/tuning"),
    jobs: Jobs = -1,
    ray: Ray = None,
) -> None:
    """Run the grids, and print them."""
    specs = [
        PolicySpec(f"{name} {point.to_dict()['arguments']}", point)
        for name in law or GRIDS
        for point in candidates(name)
    ]
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("tuning", total=None)
        results = run_suite(
            suite,
            specs,
            folder=folder,
            split="validation",
            episodes=episodes,
            workers=Workers(jobs, ray),
            progress=lambda _, total: progress.update(task, advance=1, total=total),
        )
    means: dict[str, float] = {}
    for spec in specs:
        found = [track for track in results.tracks if (track.name, spec.name) in results.samples]
        means[spec.name] = float(
            np.mean([results.record(track.name, spec.name, track.metric)["mean"] for track in found])
        )
    table = Table("candidate", "mean digits")
    for name in sorted(means, key=lambda name: (name.split()[0], -means[name])):
        table.add_row(name, f"{means[name]:.3f}")
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
