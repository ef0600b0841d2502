"""Stored jobs: written atomically, not run again, and found by everything that their numbers depend on."""

import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from small_suite import SMALL, outcome, stored, without_timings

from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.experiments import Suite, Track, get_policy_spec, jobs, run_suite
from ptne_env.experiments.suite import REFERENCES

ARGUMENTS = ("compare", "--suite", "ptne-v1", "--policy", "grounded,adaptive", "--episodes", "20", "--no-report")
ARGUMENTS += ("--track", "nominal", "--track", "switching-physical", "--track", "mixed-team")
JOBS = 3 * 5


def start(folder, *, workers=1):
    """The command line in a process group of its own."""
    command = [sys.executable, "-W", "error", "-m", "ptne_env.cli", *ARGUMENTS]
    return subprocess.Popen(  # noqa: S603
        [*command, "--out", str(folder), "--jobs", str(workers)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def finish(process):
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    finish(start(folder))
    assert len(stored(folder)) == JOBS
    return outcome(folder)


@pytest.mark.parametrize(("kills", "workers"), [(3, 1), (1, 2)])
def test_a_killed_run_goes_on_and_ends_like_an_undisturbed_one(undisturbed, tmp_path, kills, workers):
    randomness = random.Random(kills)  # noqa: S311 - moments to kill at
    for _ in range(kills):
        before = {name: path.stat().st_mtime_ns for name, path in stored(tmp_path).items()}
        process = start(tmp_path, workers=workers)
        wanted = len(before) + randomness.randint(1, 3)
        while len(stored(tmp_path)) < wanted and process.poll() is None:
            time.sleep(0.005)
        time.sleep(randomness.uniform(0, 0.05))
        assert process.poll() is None, process.stderr.read()
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        after = stored(tmp_path)
        assert wanted <= len(after) < JOBS
        assert before == {name: after[name].stat().st_mtime_ns for name in before}  # nothing was lost or done twice
        for path in after.values():
            without_timings(path.read_text(encoding="utf-8"))
    finish(start(tmp_path, workers=workers))
    assert outcome(tmp_path) == undisturbed


def test_two_runs_at_once_on_one_folder_do_not_corrupt_it(undisturbed, tmp_path):
    both = [start(tmp_path), start(tmp_path)]
    for process in both:
        finish(process)
    assert outcome(tmp_path) == undisturbed


def test_stored_jobs_are_not_run_again(tmp_path, monkeypatch):
    first = run_suite(SMALL, ["grounded"], folder=tmp_path)
    monkeypatch.setattr(jobs.Job, "compute", lambda job: pytest.fail("run again"))
    second = run_suite(SMALL, ["grounded"], folder=tmp_path)
    assert first.records == second.records  # timings too
    assert first.samples.keys() == second.samples.keys()
    for place, samples in first.samples.items():
        for metric, values in samples.items():
            np.testing.assert_array_equal(values, second.samples[place][metric])


def test_nothing_is_stored_without_a_folder_or_of_an_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_suite(SMALL, ["grounded"], tracks=["ring"], episodes=1)
    assert not any(tmp_path.iterdir())
    results = run_suite(SMALL, [PolicySpec("mine", laws.Grounded)], tracks=["ring"], episodes=1, folder=tmp_path)
    assert len(stored(tmp_path)) == len(REFERENCES)
    assert {job.policy.name: job.key is None for job in results.jobs}["mine"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[: len(text) // 2],
        lambda text: text.replace('"digits": [', '"digits": [0.5, ', 1),
        lambda text: "[]",
        lambda text: '{"samples": 3}',
        lambda text: text.replace('"timings"', '"tidings"', 1),
    ],
)
def test_a_damaged_job_is_run_again(tmp_path, damage):
    run_suite(SMALL, [], tracks=["ring"], folder=tmp_path)
    path = next(iter(stored(tmp_path).values()))
    whole = path.read_text(encoding="utf-8")
    path.write_text(damage(whole), encoding="utf-8")
    run_suite(SMALL, [], tracks=["ring"], folder=tmp_path)
    assert without_timings(path.read_text(encoding="utf-8")) == without_timings(whole)


def keys(suite=SMALL, policies=("grounded",), **arguments):
    specs = [*map(get_policy_spec, policies), *REFERENCES]
    sets = {track.name: suite.episode_set(track.name, **arguments) for track in suite.tracks}
    return {jobs.Job(track, spec, 0, sets[track.name]).key for track in suite.tracks for spec in specs}


def test_a_job_depends_on_everything_that_its_numbers_depend_on(monkeypatch):
    usual = keys()
    assert keys() == usual
    slower = tuple(Track(t.name, t.scenario.replace(gain=19.0), t.change) for t in SMALL.tracks)
    for change in (
        {"seed": 1},
        {"split": "validation"},
        {"episodes": 4},
        {"suite": Suite("small-v2", SMALL.tracks, 5)},
        {"suite": Suite("small-v1", slower, 5)},
    ):
        assert not usual & keys(**change)
    other = PolicySpec("grounded", FactorySpec.of("ptne_env.laws:Grounded", kappa=3.0))
    assert len(usual & keys(policies=[other])) == 2 * len(REFERENCES)
    monkeypatch.setattr(jobs, "versions", lambda: {"ptne_env": "another"})
    assert not usual & keys()
