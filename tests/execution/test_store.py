"""The runner and what it stores: jobs are stored atomically, not run again, and damaged files are noticed."""

import json
import os
import random

import numpy as np
import pytest
from small_suite import BASE, SMALL, stored

from ptne_env import PolicySpec, evaluate, laws
from ptne_env.evaluation import METRICS, EpisodeSet, Metric, Track, get_policy_spec, register
from ptne_env.evaluation.comparison import Job, JobResult
from ptne_env.evaluation.provenance import content_hash
from ptne_env.execution import Runner
from ptne_env.execution.runner import key_of
from ptne_env.suites import run_suite

JOB = Job(Track("ring", BASE, "The base."), get_policy_spec("static"), 0, EpisodeSet(4))


def test_stored_jobs_are_not_run_again(tmp_path, monkeypatch):
    first = run_suite(SMALL, ["grounded"], run=Runner(tmp_path))
    assert len(stored(tmp_path)) == 2 * 4
    monkeypatch.setattr(Job, "compute", lambda job: pytest.fail("run again"))
    second = run_suite(SMALL, ["grounded"], run=Runner(tmp_path))
    assert second.records == first.records  # timings too


def test_nothing_is_stored_without_a_folder_of_a_failed_job_or_of_code_of_the_user(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_suite(SMALL, ["grounded"], tracks=["ring"], episodes=1, run=Runner())
    evaluate(PolicySpec("mine", laws.Grounded), BASE, episodes=1, run=Runner(tmp_path))
    Runner(tmp_path).save(key_of(JOB), JOB, JobResult(failure="step 3: no number"))
    assert not any(tmp_path.iterdir())


def test_progress_is_reported_once_per_job_and_long_jobs_run_first():
    calls = []
    runner = Runner(progress=lambda *arguments: calls.append(arguments))
    long = BASE.replace(name="long", steps=500)
    evaluate(["static", "grounded"], [BASE, long], episodes=1, run=runner)
    assert [job for job, *_ in calls] == [
        f"{name}: {law}" for name in ("long", BASE.name) for law in ("static", "grounded")
    ]
    work = [done for _, done, _ in calls]
    assert work == sorted(set(work))
    assert {total for *_, total in calls} == {work[-1]}


def damaged(whole, randomness):
    """Bytes of a stored result with a random damage."""
    if randomness.random() < 0.5:
        start, stop = sorted(randomness.sample(range(len(whole)), 2))
        return whole[:start] + randomness.choice((b"", whole[stop:]))
    changed = bytearray(whole)
    for _ in range(randomness.choice((1, 8))):
        changed[randomness.randrange(len(whole))] ^= 1 << randomness.randrange(8)
    return bytes(changed)


def test_a_damaged_result_is_run_again_or_gives_exactly_the_stored_numbers(tmp_path):
    runner, result = Runner(tmp_path), JOB.compute()
    runner.save(key_of(JOB), JOB, result)
    path = runner.path(key_of(JOB))
    whole, randomness, refused = path.read_bytes(), random.Random(7), 0  # noqa: S311 - damages
    for _ in range(60):
        path.write_bytes(damaged(whole, randomness))
        found = runner.find(key_of(JOB))
        refused += found is None
        if found is not None:
            np.testing.assert_equal(found.samples, result.samples)
    assert refused > 50


def test_a_stored_result_of_another_job_or_form_is_run_again(tmp_path):
    runner = Runner(tmp_path)
    runner.save(key_of(JOB), JOB, JOB.compute())
    path = runner.path(key_of(JOB))
    data = json.loads(path.read_text(encoding="utf-8"))
    for change in ({"key": "0" * 64}, {"samples": 3}, {"samples": {"digits": "x"}}):
        content = {key: value for key, value in (data | change).items() if key != "checksum"}
        path.write_text(json.dumps(content | {"checksum": content_hash(content)}), encoding="utf-8")
        assert runner.find(key_of(JOB)) is None


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_the_place_of_a_result_is_replaced_by_it(tmp_path):
    runner = Runner(tmp_path)
    path = runner.path(key_of(JOB))
    path.parent.mkdir()
    os.mkfifo(path)
    assert runner.find(key_of(JOB)) is None
    runner.save(key_of(JOB), JOB, JobResult(not_applicable="no"))
    assert runner.find(key_of(JOB)).not_applicable == "no"


def test_a_file_in_the_place_of_the_folder_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        evaluate("static", BASE, episodes=4, run=Runner(tmp_path / "file"))


def test_a_metric_of_ones_own_reaches_workers_and_stops_the_reuse_of_results(tmp_path):
    from ptne_env.execution import Workers

    register(Metric("own", "own", "always 7", value=lambda rollout: np.full(len(rollout.diverged), 7.0)))
    try:
        for _ in range(2):
            results = evaluate(["static", "grounded"], BASE, episodes=2, run=Runner(tmp_path, Workers(2)))
            assert results.record(BASE.name, "static", "own")["mean"] == 7.0
    finally:
        del METRICS["own"]
    assert not any(tmp_path.iterdir())
