"""The check of published results: jobs run again give the same numbers, or the difference is found."""

import dataclasses

import pytest
from small_suite import SMALL, stored, written

from ptne_env import PolicySpec, evaluate, laws
from ptne_env.experiments import Suite, run_suite
from ptne_env.experiments.check import check
from ptne_env.experiments.store import Store
from ptne_env.experiments.suite import comparison


@pytest.fixture
def results(tmp_path):
    results = run_suite(SMALL, ["grounded", "ppo-random-energy"], folder=tmp_path)
    written(results, tmp_path)
    return results


def test_a_check_repeats_jobs_bit_for_bit(results, tmp_path):
    repetitions = check(tmp_path / "results.json", suite=SMALL, sample=100)
    assert len(repetitions) == len(results.jobs) == 2 * 5
    assert {repetition.difference for repetition in repetitions} == {0.0}
    chosen = [[one.job.key for one in check(tmp_path, suite=SMALL, sample=2, seed=seed)] for seed in range(6)]
    assert all(len(some) == 2 for some in chosen)
    assert len({tuple(some) for some in chosen}) > 1


def test_a_check_finds_numbers_and_reasons_that_do_not_reproduce(results, tmp_path):
    store = Store(tmp_path)
    found = {job: store.load(job.key) for job in results.jobs}
    job = next(job for job, result in found.items() if result.not_applicable is None)
    found[job].samples["digits"][1] += 0.25
    store.save(job, found[job])
    refused = next(job for job, result in found.items() if result.not_applicable is not None)
    store.save(refused, dataclasses.replace(found[refused], not_applicable=None))
    differences = {one.job.key: one.difference for one in check(tmp_path, suite=SMALL, sample=100)}
    assert differences.pop(job.key) == pytest.approx(0.25 / (1 + found[job].samples["digits"][1]))
    assert differences.pop(refused.key) == float("inf")
    assert set(differences.values()) == {0.0}


def test_a_check_finds_the_suite_of_a_comparison_and_of_a_name_by_itself(tmp_path):
    results = evaluate(["static"], ["energy"], episodes=2, hold_steps=3, folder=tmp_path)
    assert len(check(written(results, tmp_path))) == 2
    other = tmp_path / "suite"
    written(run_suite("ptne-v1", [], tracks=["nominal"], episodes=1, folder=other), other)
    assert {repetition.difference for repetition in check(other, sample=9)} == {0.0}


def test_a_check_refuses_what_it_cannot_repeat(results, tmp_path):
    path = tmp_path / "results.json"
    with pytest.raises(ValueError, match="content hash"):
        check(path, suite=Suite("small-v1", SMALL.tracks[:1], episodes=5))
    with pytest.raises(ValueError, match="'small-v1' was an object"):
        check(path)
    for job in stored(tmp_path).values():
        job.write_text(job.read_text(encoding="utf-8").replace("digits", "digit"), encoding="utf-8")
    with pytest.raises(ValueError, match="is damaged"):
        check(path, suite=SMALL)
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match="not a file of results"):
        check(path)
    with pytest.raises(FileNotFoundError):
        check(tmp_path / "none")


def test_results_of_objects_cannot_be_checked(tmp_path):
    suite = comparison([SMALL.tracks[0].scenario], episodes=1)
    path = written(run_suite(suite, [PolicySpec("mine", laws.Static)]), tmp_path)
    with pytest.raises(ValueError, match="no job that can be run again"):
        check(path, suite=suite)
