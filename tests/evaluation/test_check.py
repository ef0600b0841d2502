"""The check of published results: tables follow from stored jobs, and jobs run again give the same numbers."""

import dataclasses
import json
import os

import numpy as np
import pytest
from ptne_env.evaluation.check import check
from ptne_env.evaluation.store import Store
from ptne_env.evaluation.suite import comparison
from small_suite import SMALL, stored, written

from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.evaluation import Suite, run_suite, tuning
from ptne_env.evaluation.jobs import JobResult
from ptne_env.evaluation.provenance import content_hash


@pytest.fixture
def results(tmp_path):
    results = run_suite(SMALL, ["grounded", "ppo-random-energy"], folder=tmp_path)
    written(results, tmp_path)
    return results


def sign(path, data):
    """Write results with the public checksum that fits them."""
    data["checksum"] = content_hash({key: value for key, value in data.items() if key not in ("checksum", "timings")})
    path.write_text(json.dumps(data), encoding="utf-8")


def test_a_check_repeats_jobs_bit_for_bit(results, tmp_path):
    outcome = check(tmp_path / "results.json", suite=SMALL, sample=100)
    assert outcome.passes()
    assert outcome.differences == ()
    assert len(outcome.repetitions) == len(results.jobs) == 2 * 5
    assert {repetition.difference for repetition in outcome.repetitions} == {0.0}
    chosen = [
        [one.job.key for one in check(tmp_path, suite=SMALL, sample=2, seed=seed).repetitions] for seed in range(6)
    ]
    assert all(len(some) == 2 + len(results.not_applicable) for some in chosen)  # n/a always runs again
    assert len({tuple(some) for some in chosen}) > 1


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda data: data["records"][0].update(mean=12.0), "records[ring, "),
        (lambda data: data["leaderboard"]["overall"].reverse(), "leaderboard.overall["),
        (lambda data: data["leaderboard"]["rows"][0].update(rank=1), "leaderboard.rows[ring, "),
        (lambda data: data["timings"][0].update(mean=0.0), "timings[ring, "),
        (lambda data: data["records"].pop(), "records is "),
        (lambda data: data["not_applicable"].clear(), "not_applicable is "),
        (lambda data: data["not_applicable"][0].update(reason="it is too good"), "not_applicable[complete, "),
        (lambda data: data["jobs"].append(data["jobs"][0] | {"training_seed": 7}), "jobs: "),
        (lambda data: data["records"][0].update(mean=10**400), "records[ring, "),
        (lambda data: data.update(awards=["grounded"]), "awards is no part"),
    ],
)
@pytest.mark.usefixtures("results")
def test_tables_that_do_not_follow_from_the_jobs_are_reported(tmp_path, change, place):
    path = tmp_path / "results.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    sign(path, data)
    outcome = check(path, suite=SMALL, sample=1)
    assert not outcome.passes()
    assert outcome.differences[0].startswith(place)


def swap_keys(data):
    first, second = (next(job for job in data["jobs"] if job["policy"] == name) for name in ("static", "oracle"))
    first["key"] = second["key"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (swap_keys, "job of policy 'static' on track 'ring' is of another policy"),
        (lambda data: data.update(seed=1), "is of another episodes"),
        (lambda data: data["episodes"].update(ring=4), "is of another episodes"),
        (lambda data: data["jobs"].pop(0), "no stored job of policy"),
        (lambda data: data["jobs"][0].update(key=None), "no stored job of policy"),
        (lambda data: data["jobs"].append(data["jobs"][0]), "a job is listed twice"),
        (lambda data: data["policies"][0]["training_seeds"][0]["arguments"].update(kappa=3.0), "of another policy"),
        (lambda data: data.update(policies=3), "not a file of results"),
        (lambda data: data["policies"][0].pop("interface"), "not a policy: KeyError: 'interface'"),
        (lambda data: data["jobs"].__setitem__(0, 3), "not a file of results"),
        (lambda data: data.pop("leaderboard"), "it has no leaderboard"),
        (lambda data: data.update(failures=[{"track": "ring", "policy": "static", "reason": ""}]), "reference policy"),
    ],
)
@pytest.mark.usefixtures("results")
def test_results_whose_jobs_are_of_something_else_are_refused(tmp_path, change, message):
    path = tmp_path / "results.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    sign(path, data)
    with pytest.raises((ValueError, RuntimeError), match=message):
        check(path, suite=SMALL, sample=1)


@pytest.mark.usefixtures("results")
def test_a_failure_that_does_not_repeat_is_reported(tmp_path):
    path = tmp_path / "results.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    data["failures"] = [{"track": "ring", "policy": "grounded", "reason": "step 3: oops"}]
    sign(path, data)
    outcome = check(path, suite=SMALL, sample=1)
    assert not outcome.passes()
    assert outcome.repetitions[0].difference == float("inf")


def test_a_check_finds_stored_numbers_and_reasons_that_do_not_reproduce(results, tmp_path):
    store = Store(tmp_path)
    found = {job: store.load(job.key) for job in results.jobs}
    job = next(job for job, result in found.items() if result.not_applicable is None)
    found[job].samples["digits"][1] += 0.25
    store.save(job, found[job])
    refused = next(job for job, result in found.items() if result.not_applicable is not None)
    store.save(refused, dataclasses.replace(found[refused], not_applicable="it is too good"))
    outcome = check(tmp_path, suite=SMALL, sample=100)
    assert outcome.differences
    differences = {one.job.key: one.difference for one in outcome.repetitions}
    assert differences.pop(job.key) == pytest.approx(0.25 / (1 + found[job].samples["digits"][1]))
    assert differences.pop(refused.key) == float("inf")
    assert set(differences.values()) == {0.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda data: data["episodes"].update(energy=10_001),
            "names 10001 episodes of track 'energy'; .* at most 10000",
        ),
        (lambda data: data["episodes"].update(energy=2.5), "episodes of track 'energy' must be a whole number"),
        (
            lambda data: data["suite"]["tracks"][0]["scenario"].update(hold_steps=10**15),
            "names 1000000000000000 hold_steps; a check runs at most 10000",
        ),
    ],
)
def test_results_that_ask_for_too_much_work_are_refused(tmp_path, change, message):
    path = written(evaluate(["zero-input"], ["energy"], episodes=2, folder=tmp_path), tmp_path)
    data = json.loads(path.read_text(encoding="utf-8"))
    data["failures"] = [{"track": "energy", "policy": "zero-input", "reason": "a failure runs again"}]
    change(data)
    sign(path, data)
    with pytest.raises(ValueError, match=message):
        check(path)


def test_a_check_finds_the_suite_of_a_comparison_and_of_a_name_by_itself(tmp_path):
    results = evaluate(["static"], ["energy"], episodes=2, hold_steps=3, folder=tmp_path)
    assert len(check(written(results, tmp_path)).repetitions) == 1
    other = tmp_path / "suite"
    written(run_suite("ptne-v1", [], tracks=["nominal"], episodes=1, folder=other), other)
    assert check(other, sample=9).passes()


def test_the_choice_of_tuned_laws_is_rebuilt_from_their_trials(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 3)
    path = written(
        evaluate(["ppo-random-energy"], ["random-energy"], episodes=3, against_laws=True, folder=tmp_path), tmp_path
    )
    assert check(path, sample=2).passes()
    data = json.loads(path.read_text(encoding="utf-8"))
    weak = data["tuned_laws"]["random-energy"]["all"]
    weak["training_seeds"][0] = FactorySpec.of("ptne_env.laws:Static", kappa=0.5).to_dict() | {"files": {}}
    sign(path, data)
    assert check(path, sample=1).differences[0].startswith("tuned_laws.random-energy.all")


def test_trials_that_older_results_list_beside_a_published_choice_are_no_fault(tmp_path, monkeypatch):
    paper = tuning.Tunable.of("Static", is_of_paper=True, kappa=(0.05, 50.0))
    monkeypatch.setattr(tuning, "FIELD", (paper, tuning.Tunable.of("Routed", step=(0.003, 3.0))))
    monkeypatch.setattr(tuning, "BUDGET", tuning.Budget())
    path = written(
        evaluate(["ppo-random-energy"], ["random-energy"], episodes=3, against_laws=True, folder=tmp_path), tmp_path
    )
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data["trials"] == {"random-energy": []}
    data["trials"]["random-energy"] = ["0" * 64]
    sign(path, data)
    assert check(path, sample=1).passes()


def test_a_policy_that_does_better_on_the_published_episodes_is_reported(results, tmp_path):
    store = Store(tmp_path)
    data = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    suite = Suite("small-v1", SMALL.tracks[:1], episodes=100)
    results = run_suite(suite, ["grounded"], folder=tmp_path)
    assert check(written(results, tmp_path), suite=suite, sample=9, seed=0).passes()
    job = next(job for job in results.jobs if job.policy.name == "grounded")
    result = store.load(job.key)
    result.samples["digits"][:] = np.minimum(12.0, result.samples["digits"] + 3)
    store.save(job, result)
    found = {one.job.key: one for one in check(tmp_path, suite=suite, sample=9, seed=0).repetitions}
    assert found[job.key].knows_episodes
    assert found[job.key].published > found[job.key].fresh + 1
    assert [one.knows_episodes for one in found.values()].count(True) == 1
    assert data["seed"] == 0


def test_a_policy_that_is_faster_on_the_published_episodes_is_reported(tmp_path):
    suite = Suite("small-v1", SMALL.tracks[:1], episodes=20)
    results = run_suite(suite, ["grounded"], folder=tmp_path)
    written(results, tmp_path)
    store = Store(tmp_path)
    job = next(job for job in results.jobs if job.policy.name == "grounded")
    result = store.load(job.key)
    result.samples["settling_time_1e_6"][:] = 0.01  # by which policies that saturate a track are ranked
    store.save(job, result)
    found = {one.job.key: one.knows_episodes for one in check(tmp_path, suite=suite, sample=9).repetitions}
    assert [key for key, knows in found.items() if knows] == [job.key]


def test_numbers_of_n_a_are_always_run_again(tmp_path):
    results = run_suite(SMALL, ["grounded"], folder=tmp_path)
    store = Store(tmp_path)
    job = next(job for job in results.jobs if job.policy.name == "grounded")
    store.save(job, JobResult({}, {}, "it does not fit"))
    written(run_suite(SMALL, ["grounded"], folder=tmp_path), tmp_path)
    for seed in range(5):
        outcome = check(tmp_path, suite=SMALL, sample=1, seed=seed)
        assert outcome.differences == ()
        assert not outcome.passes()


@pytest.mark.usefixtures("results")
@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"format"', '"seed": 1, "format"', 1),
        lambda text: text.replace('"seed": 0', '"seed": NaN'),
    ],
)
def test_a_text_that_readers_take_differently_is_refused(tmp_path, change):
    path = tmp_path / "results.json"
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(ValueError, match="an object has a key twice|NaN is not JSON"):
        check(path, suite=SMALL)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such files")
def test_results_that_are_a_pipe_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "results.json")
    with pytest.raises(ValueError, match="it is no file"):
        check(tmp_path)


def test_a_check_refuses_results_that_it_cannot_repeat(results, tmp_path):
    path = tmp_path / "results.json"
    with pytest.raises(ValueError, match="content hash"):
        check(path, suite=Suite("small-v1", SMALL.tracks[:1], episodes=5))
    with pytest.raises(ValueError, match="was an object: pass it"):
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
    with pytest.raises(ValueError, match="policy 'mine' was an object"):
        check(path, suite=suite)


def test_files_that_a_check_misses_are_named_with_advice(results, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none'"):
        check(tmp_path / "none")
    path = next(iter(stored(tmp_path).values()))
    path.unlink()
    with pytest.raises(
        FileNotFoundError, match=f"no stored job of policy .*{path.name} is missing; copy the folder jobs/"
    ):
        check(tmp_path, suite=SMALL)
