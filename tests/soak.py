"""Assertions over many random episodes: ``python tests/soak.py [--episodes E] [--seed S]``.

Every world is one session of fuzz.py and has a number: ``--world W`` plays that world alone, with a traceback. The
counts are the same on every run with the same options. 100,000 episodes take about four minutes on two cores. The exit
code is 1 after a violation, or when most worlds are refused.
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
"""Worlds between two counts of the episodes."""

ENOUGH = 100
"""Worlds with a violation, after which the soak ends early."""


def attempt(seed, episodes):
    """The tally of a world, and its violation: the last frames of the traceback, or an empty text."""
    try:
        return play(seed, episodes), ""
    except Exception:  # noqa: BLE001 - every exception is a violation
        return Tally(worlds=1), "".join(traceback.format_exc(limit=-3))


def soak(episodes, seed, each, jobs):
    """Play worlds until they sum up to ``episodes``: the tally, and the violations by world.

    The soak ends early after many violations, and when most worlds are refused.
    """
    total, violations, world = Tally(), {}, seed
    with Parallel(n_jobs=jobs) as parallel:
        while total.episodes < episodes and len(violations) < ENOUGH and not total.refuses_too_many:
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
    """Play, and print the tally and the violations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100_000, help="smallest number of episodes")
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
    if total.refuses_too_many:
        console.print(f"{total.refused_worlds} of {total.worlds} worlds were refused: the soak tests nothing")
    return int(bool(violations) or total.refuses_too_many)


if __name__ == "__main__":
    sys.exit(main())
