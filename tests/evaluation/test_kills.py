"""Commands that are killed at random moments leave no process, and go on to the results of an undisturbed run."""

import time
from functools import cache
from pathlib import Path

import pytest
from affine_games import SOAK
from processes import KILLS, kill_at_random_moments, start_python
from small_suite import without_timings

COMMANDS = {
    "compare": "compare --suite small_suite:SMALL --trust --policy grounded,adaptive --episodes 200 --no-report",
}
ROUNDS = [KILLS[1::2], KILLS[::2]]
"""Each kind of kill once."""


def start(name, folder):
    command = [*COMMANDS[name].split(), "--jobs", "2", "--out", folder]
    return start_python("-W", "error", "-m", "ptne_env.cli", *command, modules=[Path(__file__).parent])


def files(folder):
    """The files of a folder, without those that were being written."""
    return [path for path in folder.rglob("*.*") if path.is_file() and not path.name.startswith(".")]


def outcome(folder):
    """The contents of the files without timings, by name; all numbers of a CSV file are in the JSON file beside it."""
    return {
        path.name: without_timings(path.read_text(encoding="utf-8")) if path.suffix == ".json" else path.read_bytes()
        for path in files(folder)
        if path.suffix != ".csv"
    }


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """``undisturbed(name)`` returns the outcome of a command, and its duration in seconds."""

    @cache
    def run(name):
        folder, began = tmp_path_factory.mktemp(name), time.monotonic()
        start(name, folder).finish()
        return outcome(folder), time.monotonic() - began

    return run


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_killed_goes_on_to_the_results_of_an_undisturbed_one(tmp_path, undisturbed, name):
    wanted, duration = undisturbed(name)
    killed, seed = 0, list(COMMANDS).index(name)
    while killed < (25 if SOAK else 1):
        folder, kept = tmp_path / str(seed), {}

        def start_again(folder=folder, kept=kept):
            stored = {path: path.stat().st_mtime_ns for path in files(folder) if path.parent != folder}
            assert kept.items() <= stored.items()  # nothing was lost or done twice
            kept.update(stored)
            return start(name, folder)

        killed += kill_at_random_moments(start_again, ROUNDS[seed % 2], duration, seed)
        start(name, folder).finish()
        assert outcome(folder) == wanted
        seed += 1
    print(f"{name}: {killed} kills in {seed} rounds")


def test_two_runs_at_once_on_one_folder_do_not_corrupt_it(tmp_path, undisturbed):
    for run in [start("compare", tmp_path), start("compare", tmp_path)]:
        run.finish()
    assert outcome(tmp_path) == undisturbed("compare")[0]
