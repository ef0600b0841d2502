"""The verification of published results: tables follow from samples, and jobs run again give the same numbers."""

import json
import re
from functools import partial

import pytest
from small_suite import SMALL, write_results

from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.evaluation.provenance import content_hash
from ptne_env.execution import verification
from ptne_env.execution.verification import verify
from ptne_env.learn import shipped_path
from ptne_env.suites import run_suite


@pytest.fixture(scope="module")
def data():
    own = PolicySpec("mine", FactorySpec.of("law:grounded", kappa=3.0))
    return run_suite(SMALL, ["grounded", "ppo-random-energy", own]).to_dict()


@pytest.fixture
def written(data, tmp_path):
    """Writes results with a change, and with the checksum that fits."""

    return partial(write_results, tmp_path, data)


def samples_of(data, policy="grounded", track="ring"):
    return data["samples"][track][policy]


def test_honest_results_pass_with_two_jobs_of_every_entry_and_one_of_references(written):
    outcome = verify(written())
    assert outcome.passes
    assert outcome.same_arithmetic
    assert outcome.differences == ()
    assert outcome.jobs == 2 * 6
    assert {repetition.difference for repetition in outcome.repetitions} == {0.0}
    names = [repetition.policy for repetition in outcome.repetitions]
    expected = {"grounded": 2, "ppo-random-energy": 2, "mine": 2, "zero-input": 1, "static": 1, "oracle": 1}
    assert {name: names.count(name) for name in names} == expected
    choices = {tuple(one.track for one in verify(written(), sample=1).repetitions) for _ in range(4)}
    assert len(choices) > 1


def swap(data):
    """The samples of the oracle stand in the row of another policy, and the table follows from them."""
    for track in ("ring", "complete"):
        data["samples"][track]["grounded"] = data["samples"][track]["oracle"]
    records = {(one["track"], one["policy"], one["metric"]): one for one in data["records"]}
    for one in data["records"]:
        if one["policy"] == "grounded":
            one.update(records[one["track"], "oracle", one["metric"]] | {"policy": "grounded"})


def test_numbers_of_another_policy_are_found_by_running_jobs_again(written):
    outcome = verify(written(swap))
    assert outcome.differences == ()
    assert not outcome.passes
    assert {one.policy for one in outcome.repetitions if not one.agrees} == {"grounded"}


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (lambda data: data["records"][0].update(mean=11.0), "the record of digits of "),
        (lambda data: data["records"].pop(), "is missing, or there are too many"),
        (lambda data: samples_of(data)["digits"][0].__setitem__(2, 12.5), "digits of grounded on ring is outside"),
        (lambda data: samples_of(data)["settling_time"][0].__setitem__(2, -1.0), "settling_time of .* is outside"),
        (lambda data: samples_of(data)["digits"][0].__setitem__(2, 3.0), "the record of digits of grounded"),
        (lambda data: samples_of(data)["digits"].__setitem__(0, [1.0]), "has the shape"),
        (lambda data: samples_of(data).pop("regret"), "other metrics than a run gives"),
        (lambda data: data["samples"]["ring"].pop("grounded"), "grounded on ring has other metrics"),
        (lambda data: data["not_applicable"].clear(), "ppo-random-energy on complete has no result"),
        (lambda data: data["policies"][1]["training_seeds"][0].update(sha256="0" * 64), "files of policy ppo-"),
        (
            lambda data: data["policies"][4]["training_seeds"][0].update(arguments={"kappa": 9.0}),
            "policy static is not the reference policy",
        ),
    ],
)
def test_tables_samples_and_rules_that_do_not_hold_are_reported(written, change, difference):
    outcome = verify(written(change), sample=1)
    assert not outcome.passes
    assert any(re.search(difference, text) for text in outcome.differences)


@pytest.mark.parametrize(
    ("kind", "reason"), [("failures", "step 3: oops"), ("not_applicable", "it is too good for this track")]
)
def test_a_failure_or_a_refusal_that_does_not_repeat_is_reported(written, kind, reason):
    def change(data):
        for track in ("ring", "complete"):
            del data["samples"][track]["grounded"], data["timings"][track]["grounded"]
            data[kind].append({"track": track, "policy": "grounded", "reason": reason})
        data["records"] = [one for one in data["records"] if one["policy"] != "grounded"]

    outcome = verify(written(change))
    assert outcome.differences == ()
    assert {one.policy for one in outcome.repetitions if not one.agrees} == {"grounded"}


def test_a_published_suite_has_its_own_tracks_episodes_and_references(tmp_path, monkeypatch):
    results = run_suite("ptne-v1", [], tracks="nominal", episodes=2)
    path = tmp_path / "results.json"

    def differences(**changes):
        content = {key: value for key, value in (results.to_dict() | changes).items() if key != "checksum"}
        signed = {key: value for key, value in content.items() if key != "timings"}
        path.write_text(json.dumps(content | {"checksum": content_hash(signed)}), encoding="utf-8")
        return verify(path, sample=1).differences

    assert differences() == ()
    (track,) = results.to_dict()["tracks"]
    easier = track | {"scenario": track["scenario"] | {"steps": 800}}
    assert differences(tracks=[easier]) == ("track nominal is not that of ptne-v1",)
    other = {"nominal": results.to_dict()["episodes"]["nominal"] | {"track": ["mine", "nominal"]}}
    assert differences(episodes=other) == ("the episodes of track nominal are not those of ptne-v1",)


def test_on_another_arithmetic_jobs_are_judged_by_statistics(written, monkeypatch):
    def rounded_elsewhere(data):
        data["arithmetic"]["blas"] = "another kernel"
        for policies in data["samples"].values():
            for samples in policies.values():
                samples["digits"] = [[value - 1e-4 for value in values] for values in samples["digits"]]

    monkeypatch.setattr(verification, "_differences_of_tables", lambda *_: ())
    outcome = verify(written(rounded_elsewhere))
    assert not outcome.same_arithmetic
    assert outcome.passes
    assert max(one.difference for one in outcome.repetitions) > 1e-6

    def forged(data):
        rounded_elsewhere(data)
        swap(data)

    outcome = verify(written(forged))
    assert {one.policy for one in outcome.repetitions if not one.agrees} == {"grounded"}


def test_policy_files_lie_beside_the_results(tmp_path):
    file = tmp_path / "here" / "mine.onnx"
    file.parent.mkdir()
    file.write_bytes(shipped_path("ppo-random-energy").read_bytes())
    results = evaluate([str(file), "static"], SMALL.tracks[0], episodes=2)
    there = tmp_path / "there"
    there.mkdir()
    (there / "results.json").write_text(results.to_json(), encoding="utf-8")
    file.rename(there / "renamed.onnx")
    assert verify(there).passes
    (there / "renamed.onnx").unlink()
    with pytest.raises(FileNotFoundError, match=r"mine\.onnx"):
        verify(there)


def test_results_of_objects_are_refused(tmp_path):
    path = tmp_path / "objects.json"
    path.write_text(evaluate(PolicySpec("mine", laws.Static), SMALL.tracks[0], episodes=1).to_json())
    with pytest.raises(ValueError, match="policy 'mine' was an object"):
        verify(path)
