"""Tune the constants of laws on validation episodes of ptne-v1: ``python -m baselines.tune [LAW]...``.

``tuned.csv`` beside this file is its output: the best constants found, and beside them those that the entries in
``ptne_env/evaluation/named_policies.py`` had before. The score of constants is the mean digits over some tracks, so
that no law is tuned for one world.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import differential_evolution

from baselines.published import write_rows
from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import POLICIES
from ptne_env.evaluation.comparison import compare
from ptne_env.execution import Runner, Workers
from ptne_env.suites import get_suite

TUNED: dict[str, dict[str, tuple[float, float]]] = {
    "static-tuned": {"kappa": (0.5, 10.0), "gradient_gain": (0.1, 10.0)},
    "grounded": {"kappa": (0.5, 20.0)},
    "adaptive-grounded": {"gamma": (1e-5, 1e-1), "initial_gain": (0.5, 20.0)},
    "projected-gradient": {"step": (0.02, 2.0), "mixing": (0.05, 0.5)},
    "routed-unknown": {"step": (0.02, 2.0)},
    "proximal-best-response": {"step": (0.2, 20.0), "mixing": (0.05, 0.5)},
}
"""The range of each constant, searched on a logarithmic scale, by entry."""

TRACKS = ("switching-physical", "switching-transformed", "short-deadline", "rounding")
"""Tracks of ptne-v1 with noise on the way."""

OUTPUT = Path(__file__).parent / "tuned.csv"
COLUMNS = ("policy", "constants", "digits", "constants before", "digits before")
Constants = dict[str, float]


def search(name: str, episodes: int, generations: int, runner: Runner) -> dict[str, str]:
    """Search the constants of an entry, from those that it has on, and return its row of the table.

    Args:
        name: of the entry.
        episodes: validation episodes per track.
        generations: of the differential evolution, whose candidates ``runner`` plays all at once.
        runner: runs and stores jobs.
    """
    ranges, law, suite = TUNED[name], POLICIES[name].policy, get_suite("ptne-v1")
    own = {constant: dict(law.arguments)[constant] for constant in ranges}
    drawn = {track: suite.episode_set(track, episodes, split="validation") for track in TRACKS}

    def digits(candidates: Sequence[Constants]) -> np.ndarray:
        """The mean digits over the tracks of each candidate."""
        specs = [
            PolicySpec(str(number), FactorySpec.of(law.target, **dict(law.arguments) | constants))
            for number, constants in enumerate(candidates)
        ]
        results = compare("ptne-v1", [*map(suite.track, TRACKS)], specs, drawn, runner)
        return np.mean(
            [[results.record(track, spec.name, "digits")["mean"] for spec in specs] for track in TRACKS], axis=0
        )

    def constants_at(point: np.ndarray) -> Constants:
        """The constants at a point of the search, with three digits."""
        return {name: float(f"{np.exp(value):.3g}") for name, value in zip(ranges, point, strict=True)}

    found = differential_evolution(
        lambda points: -digits([constants_at(point) for point in np.atleast_2d(points.T)]),
        [tuple(np.log(limits)) for limits in ranges.values()],
        x0=np.log(list(own.values())),
        popsize=5,
        maxiter=generations,
        polish=False,
        rng=0,
        vectorized=True,
        updating="deferred",
    )
    texts = [" ".join(f"{key}={value:g}" for key, value in each.items()) for each in (constants_at(found.x), own)]
    cells = name, texts[0], f"{-found.fun:.2f}", texts[1], f"{digits([own])[0]:.2f}"
    return dict(zip(COLUMNS, cells, strict=True))


def main() -> None:
    """Tune and print; write the table when all laws were tuned."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("law", nargs="*", metavar="LAW", help=f"of {', '.join(TUNED)}; all if left out")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--generations", type=int, default=4)
    parser.add_argument("--jobs", type=int, default=-1)
    given = parser.parse_args()
    if unknown := set(given.law) - TUNED.keys():
        parser.error(f"no constants of {', '.join(sorted(unknown))} are tuned; choose from {', '.join(TUNED)}")
    runner, rows = Runner(None, Workers(given.jobs)), []
    for name in given.law or TUNED:
        rows.append(search(name, given.episodes, given.generations, runner))
        print(*rows[-1].values(), sep="  ", flush=True)
    if not given.law:
        write_rows(OUTPUT, rows, COLUMNS)


if __name__ == "__main__":
    main()
