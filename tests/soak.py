"""Many random episodes and what must hold in all of them: ``python tests/soak.py [--episodes E] [--seed S]``.

Every world is one session of fuzz.py, found again by its number: ``--world W`` plays that one alone, with a traceback.
The sum is the same on every run with the same options. The whole of 100,000 episodes takes about ten minutes on two
cores. The exit code is 1 when anything did not hold.
"""

import argparse
import sys
import traceback
from collections import Counter
from dataclasses import asdict
from time import perf_counter

from fuzz import Tally, play
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

CHUNK = 32
"""Worlds between two looks at how many episodes there were."""

ENOUGH = 100
"""Worlds in which something did not hold, after which it is no use to go on."""


def attempt(seed, episodes):
    """What a world has shown, and what did not hold there: its last frames, or nothing."""
    try:
        return play(seed, episodes), ""
    except Exception:  # noqa: BLE001 - whatever it is, it should not have been raised
        return Tally(worlds=1), "".join(traceback.format_exc(limit=-3))


def soak(episodes, seed, each, jobs):
    """Play worlds until there were as many episodes: the sum, and what did not hold by world."""
    total, violations, world = Tally(), {}, seed
    with Parallel(n_jobs=jobs) as parallel:
        while total.episodes < episodes and len(violations) < ENOUGH:
            worlds = range(world, world + CHUNK)
            for number, (tally, violation) in zip(
                worlds, parallel(delayed(attempt)(number, each) for number in worlds), strict=True
            ):
                total.add(tally)
                if violation:
                    violations[number] = violation
            world += CHUNK
    return total, violations


def main(arguments=None):
    """Play, and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100_000, help="at least as many")
    parser.add_argument("--seed", type=int, default=0, help="number of the first world")
    parser.add_argument("--each", type=int, default=200, help="episodes in each world")
    parser.add_argument("--jobs", type=int, default=-1, help="processes, -1 for one per core")
    parser.add_argument("--world", type=int, help="play this world alone")
    options = parser.parse_args(arguments)
    if options.world is not None:
        print(asdict(play(options.world, options.each)))
        return 0
    started = perf_counter()
    total, violations = soak(options.episodes, options.seed, options.each, options.jobs)
    table = Table(title=f"Random episodes in {perf_counter() - started:.0f} s", show_header=False)
    for name, value in {**asdict(total), "violations": len(violations)}.items():
        table.add_row(name.replace("_", " "), f"{value:,}")
    console = Console()
    console.print(table)
    for reason, count in Counter(violation.splitlines()[-1] for violation in violations.values()).most_common():
        first = next(number for number, violation in violations.items() if violation.endswith(reason + "\n"))
        console.print(f"{count} × {reason} (--world {first})", markup=False)
    return int(bool(violations))


if __name__ == "__main__":
    sys.exit(main())
