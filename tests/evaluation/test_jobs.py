"""Jobs: what their keys depend on."""

from dataclasses import replace

import numpy as np
import pytest
from small_suite import BASE, COMPLETE

from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.evaluation import METRICS, EpisodeSet, Metric, Track, get_policy_spec, jobs, register
from ptne_env.evaluation.jobs import Job, JobResult
from ptne_env.learn import shipped_path

JOB = Job(Track("ring", BASE, "The base."), get_policy_spec("static"), 0, EpisodeSet(3, 0, "test", ("small", "ring")))


def test_a_key_does_not_depend_on_names_of_policies_sentences_and_other_extras():
    same = PolicySpec("another-name", FactorySpec.of("ptne_env.laws:Static", kappa=2.0))
    assert replace(JOB, policy=same).key == JOB.key
    assert replace(JOB, track=replace(JOB.track, change="Another sentence.")).key == JOB.key
    assert set(JOB.to_dict()["versions"]) == {"ptne_env", "numpy", "scipy", "networkx"}
    assert "onnxruntime" in replace(JOB, policy=get_policy_spec("ppo-random-energy")).to_dict()["versions"]


@pytest.mark.parametrize(
    "change",
    [
        {"policy": PolicySpec("static", FactorySpec.of("law:static", kappa=2.1))},
        {
            "policy": PolicySpec("static", (FactorySpec.of("law:grounded"), FactorySpec.of("law:static"))),
            "training_seed": 0,
        },
        {"track": Track("ring", COMPLETE, "The base.")},
        {"episodes": EpisodeSet(4, 0, "test", ("small", "ring"))},
        {"episodes": EpisodeSet(3, 0, "test", ("other", "ring"))},
        {"episodes": EpisodeSet(3, 1, "test", ("small", "ring"))},
        {"episodes": EpisodeSet(3, 0, "validation", ("small", "ring"))},
    ],
)
def test_a_key_depends_on_everything_that_the_numbers_do(change):
    assert replace(JOB, **change).key not in (JOB.key, None)


def test_a_key_depends_on_the_physics_and_on_the_content_of_a_policy_file(monkeypatch, tmp_path):
    path, keys = tmp_path / "mine.onnx", set()
    content = shipped_path("ppo-random-energy").read_bytes()
    path.write_bytes(content)
    job = replace(JOB, policy=get_policy_spec(str(path)))
    keys.add(job.key)
    monkeypatch.setattr(jobs, "PHYSICS", -1)
    keys.add(replace(job).key)
    path.write_bytes(content + b"\0")
    keys.add(replace(job).key)
    assert len(keys) == 3


def test_a_job_with_code_of_the_user_has_no_key():
    own = Metric("own", "own", "always 7", value=lambda rollout: np.full(len(rollout.diverged), 7.0))
    foreign = BASE.replace(start=FactorySpec.of("elsewhere:start"))
    for policy in (PolicySpec("object", laws.Static(JOB.track.world and _layout())), PolicySpec("class", laws.Static)):
        assert replace(JOB, policy=policy).key is None
    assert replace(JOB, track=replace(JOB.track, scenario=foreign)).key is None
    register(own)
    try:
        assert replace(JOB).key is None
    finally:
        del METRICS["own"]


def _layout():
    import ptne_env

    return ptne_env.parallel_env(BASE, interface="physical").layout


def test_a_result_is_its_own_dict_and_back_and_another_form_is_refused():
    result = JOB.compute()
    data = result.to_dict()
    again = JobResult.from_dict(data, JOB)
    for metric, values in result.samples.items():
        np.testing.assert_array_equal(values, again.samples[metric])
        assert METRICS[metric].admits(values)
    for wrong in (
        {"samples": {}, "not_applicable": None},
        {"samples": {"digits": [1.0, 2.0, 3.0]}, "not_applicable": None},
        {"samples": {name: values[:2] for name, values in data["samples"].items()}, "not_applicable": None},
        {"samples": {name: "x" for name in data["samples"]}, "not_applicable": None},
        {"not_applicable": None},
    ):
        with pytest.raises(ValueError, match="expected 3 numbers|not a result"):
            JobResult.from_dict(wrong, JOB)


@pytest.mark.parametrize(
    ("metric", "good", "bad"),
    [
        ("digits", 12.0, 12.1),
        ("settling_time", 0.0, -1.0),
        ("settled_share", 1.0, 1.5),
        ("log_error_area", -12.0, -13.0),
    ],
)
def test_metrics_refuse_values_outside_their_range(metric, good, bad):
    assert METRICS[metric].admits(np.array([good, np.nan]))
    assert not METRICS[metric].admits(np.array([good, bad]))
