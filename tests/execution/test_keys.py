"""Keys of stored jobs: what they depend on."""

from dataclasses import replace

import numpy as np
import pytest
from small_suite import BASE, COMPLETE

from ptne_env import FactorySpec, PolicySpec, laws, parallel_env
from ptne_env.evaluation import METRICS, OPTIONAL, EpisodeSet, Metric, Track, get_policy_spec, register
from ptne_env.evaluation.comparison import Job
from ptne_env.execution import runner
from ptne_env.execution.runner import content_of, key_of
from ptne_env.learn import shipped_path

JOB = Job(Track("ring", BASE, "The base."), get_policy_spec("static"), 0, EpisodeSet(3, 0, "test", ("small", "ring")))


def test_a_key_does_not_depend_on_names_of_policies_sentences_and_other_extras():
    same = PolicySpec("another-name", FactorySpec.of("ptne_env.laws:Static", kappa=2.0))
    assert key_of(replace(JOB, policy=same)) == key_of(JOB)
    assert key_of(replace(JOB, track=replace(JOB.track, change="Another sentence."))) == key_of(JOB)
    assert set(content_of(JOB)["versions"]) == {"ptne_env", "numpy", "scipy", "networkx"}


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
    assert key_of(replace(JOB, **change)) not in (key_of(JOB), None)


def test_a_key_depends_on_the_physics_and_on_the_content_of_a_policy_file(monkeypatch, tmp_path):
    path, keys = tmp_path / "mine.npz", set()
    content = shipped_path("ppo-nominal").read_bytes()
    path.write_bytes(content)
    job = replace(JOB, policy=get_policy_spec(str(path)))
    keys.add(key_of(job))
    monkeypatch.setattr(runner, "PHYSICS", -1)
    keys.add(key_of(job))
    path.write_bytes(content + b"\0")
    keys.add(key_of(job))
    assert len(keys) == 3


def test_a_job_with_code_of_the_user_has_no_key():
    own = Metric("own", "own", "always 7", value=lambda rollout: np.full(len(rollout.diverged), 7.0))
    foreign = BASE.replace(start=FactorySpec.of("elsewhere:start"))
    for policy in (
        PolicySpec("object", laws.Static(parallel_env(BASE, interface="physical").layout)),
        PolicySpec("class", laws.Static),
    ):
        assert key_of(replace(JOB, policy=policy)) is None
    assert key_of(replace(JOB, track=replace(JOB.track, scenario=foreign))) is None
    register(own)
    try:
        assert key_of(JOB) is None
    finally:
        del METRICS["own"]


def test_a_shipped_metric_that_is_registered_is_stored_under_another_key(monkeypatch):
    before = key_of(JOB)
    monkeypatch.setitem(METRICS, "messages", OPTIONAL["messages"])
    assert key_of(JOB) not in (None, before)
    world, messages = JOB.track.world, JOB.compute().samples["messages"]
    assert set(messages) == {world.clock.steps * np.count_nonzero(world.topology.union.adjacency)}
    monkeypatch.delitem(METRICS, "messages")
    assert key_of(JOB) == before
