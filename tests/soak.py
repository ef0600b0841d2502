"""Assertions over many random episodes: ``python tests/soak.py [--episodes E] [--each N] [--world W]``.

Every world is one session of fuzz.py and has a number: ``--world W`` plays that world alone, with a traceback. The exit
code is 1 after a violation, when most worlds are refused, or when a usual run leaves a part of the library out.
"""

import argparse
import sys
import traceback

from fuzz import Tally, play
from joblib import Parallel, delayed

NORMAL = 100_000
"""Episodes of a usual run, in which every part of the library has been played."""

CHUNK = 32
"""Worlds between two counts of the episodes."""


def attempt(seed, episodes):
    """The tally of a world, and its violation: the last frames of the traceback, or an empty text."""
    try:
        return play(seed, episodes), ""
    except Exception:  # noqa: BLE001 - every exception is a violation
        return Tally(worlds=1), "".join(traceback.format_exc(limit=-3))


def main(arguments=None):
    """Play worlds until they sum up to the episodes, and print the tally and the violations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=NORMAL, help="smallest number of episodes")
    parser.add_argument("--each", type=int, default=200, help="episodes in each world")
    parser.add_argument("--jobs", type=int, default=-1, help="processes, -1 for one per core")
    parser.add_argument("--world", type=int, help="play this world alone")
    options = parser.parse_args(arguments)
    if options.world is not None:
        print(play(options.world, options.each))
        return 0
    total, world, failed = Tally(), 0, False
    with Parallel(n_jobs=options.jobs) as parallel:
        while total.episodes < options.episodes and not (failed or total.refuses_too_many):
            worlds = range(world, world + CHUNK)
            for number, (tally, violation) in zip(
                worlds, parallel(delayed(attempt)(number, options.each) for number in worlds), strict=True
            ):
                total.add(tally)
                if violation:
                    failed = True
                    print(f"--world {number}: {violation}")
            world += CHUNK
    print(total)
    unplayed = total.unplayed if total.episodes >= NORMAL else []
    if unplayed:
        print(f"no world has played {', '.join(unplayed)}")
    return int(failed or total.refuses_too_many or bool(unplayed))


if __name__ == "__main__":
    sys.exit(main())
