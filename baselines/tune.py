"""Tune the constants of laws on validation episodes of ptne-v1: ``python baselines/tune.py [LAW]...``.

The constants are those of the entries of ``ptne_env/evaluation/entries.py``; ``tuned.csv`` beside this file is its
output. The score of constants is the mean digits over some tracks, so that no law is tuned for one world.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from scipy.optimize import differential_evolution

from ptne_env import FactorySpec, PolicySpec
from ptne_env.bench import run_suite

LAWS: dict[str, dict[str, tuple[float, float]]] = {
    "static": {"kappa": (0.5, 10.0), "gradient_gain": (0.5, 10.0)},
    "fixed-gain": {"kappa": (0.5, 10.0)},
    "grounded": {"kappa": (0.5, 20.0)},
    "adaptive-grounded": {"gamma": (1e-5, 1e-1), "initial_gain": (0.5, 20.0)},
    "projected-gradient": {"step": (0.02, 2.0), "mixing": (0.05, 0.5)},
    "routed-unknown": {"step": (0.02, 2.0)},
    "proximal-best-response": {"step": (0.2, 20.0), "mixing": (0.05, 0.5)},
}
"""The range of each constant, searched on a logarithmic scale, by law."""

TRACKS = ("nominal", "switching-transformed", "markov", "noise", "delay", "coarse-step", "unseen-graphs", "robots")
COLUMNS = ("law", "constants", "digits")


def digits(law: str, constants: dict[str, float], episodes: int) -> float:
    """The mean digits of a law over the tracks."""
    spec = PolicySpec("candidate", FactorySpec.of(f"law:{law}", **constants))
    results = run_suite("ptne-v1", [spec], tracks=TRACKS, episodes=episodes, split="validation")
    return float(np.mean([results.record(track, "candidate", "digits")["mean"] for track in TRACKS]))


def tuned(law: str, episodes: int, evaluations: int) -> dict[str, str]:
    """The best constants of a law, as a row of the table."""
    ranges = LAWS[law]

    def constants(point: np.ndarray) -> dict[str, float]:
        return {name: float(f"{np.exp(value):.3g}") for name, value in zip(ranges, point, strict=True)}

    population = max(4, evaluations // 5)
    found = differential_evolution(
        lambda point: -digits(law, constants(point), episodes),
        [tuple(np.log(limits)) for limits in ranges.values()],
        popsize=max(1, population // len(ranges)),
        maxiter=4,
        polish=False,
        rng=0,
    )
    text = " ".join(f"{name}={value:g}" for name, value in constants(found.x).items())
    return dict(zip(COLUMNS, (law, text, f"{-found.fun:.2f}"), strict=True))


def main() -> None:
    """Tune, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "law", nargs="*", metavar="LAW", choices=[*LAWS, []], help=f"of {', '.join(LAWS)}; all if left out"
    )
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--evaluations", type=int, default=100)
    given = parser.parse_args()
    rows = []
    for law in given.law or LAWS:
        rows.append(tuned(law, given.episodes, given.evaluations))
        print(*rows[-1].values(), flush=True)
    with (Path(__file__).parent / "tuned.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
