"""A command that is killed at random moments leaves no process, and goes on to the results of an undisturbed run."""

import time
from pathlib import Path

import pytest
from affine_games import SOAK
from processes import KILLS, kill_at_random_moments, start_python

from ptne_env.evaluation.results import read_results

COMMAND = "compare --suite ptne-v1 nominal liar --policy grounded,adaptive --episodes 5 --no-report"
ROUNDS = [KILLS[1::2], KILLS[::2]] if SOAK else [KILLS[:1]]


def start(folder, jobs=2):
    return start_python("-W", "error", "-m", "ptne_env.cli", *COMMAND.split(), "--jobs", jobs, "--out", folder)


def outcome(folder):
    return read_results(folder).to_dict()["checksum"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The outcome of the command, and its duration in seconds."""
    folder, began = tmp_path_factory.mktemp("undisturbed"), time.monotonic()
    start(folder, jobs=1).finish()
    return outcome(folder), time.monotonic() - began


def test_a_command_that_is_killed_goes_on_to_the_results_of_an_undisturbed_one(tmp_path, undisturbed):
    wanted, duration = undisturbed
    killed = seed = 0
    while killed < (25 if SOAK else 1):
        folder, kept = tmp_path / str(seed), {}

        def start_again(folder=folder, kept=kept):
            stored = {path: path.stat().st_mtime_ns for path in Path(folder).glob("jobs/*.json")}
            assert kept.items() <= stored.items()  # nothing was lost or done twice
            kept.update(stored)
            return start(folder)

        killed += kill_at_random_moments(start_again, ROUNDS[seed % len(ROUNDS)], duration, seed)
        start(folder, jobs=1).finish()
        assert outcome(folder) == wanted
        seed += 1


def test_two_runs_at_once_on_one_folder_do_not_corrupt_it(tmp_path, undisturbed):
    for run in [start(tmp_path, jobs=1), start(tmp_path, jobs=1)]:
        run.finish()
    assert outcome(tmp_path) == undisturbed[0]
