"""Loading of policy files: valid files, and every kind of invalid file."""

import json

import numpy as np
import pytest
from extras import need_sb3

onnx = need_sb3("onnx")

from onnx import helper

import ptne_env
from ptne_env import Interface
from ptne_env import learn as policies
from ptne_env.bench import find_scenario
from ptne_env.learn import Metadata, PolicyFileError
from ptne_env.learn.learned import sealed


def metadata(**changes):
    values = {
        "interface": Interface("scaled"),
        "action_dims": (1,) * 5,
        "slots": 2,
        "scenarios": ("random-energy",),
        "steps": 1,
        "seed": 0,
        "digits": 0.5,
        "versions": {"ptne_env": "0"},
    }
    return Metadata(**values | changes)


def write(path, size=28, actions=5, described=None):
    """A policy file that returns the first entries of its observations."""
    graph = helper.make_graph(
        [helper.make_node("Slice", ["observation", "start", "end", "axis"], ["action"])],
        "policy",
        [helper.make_tensor_value_info("observation", onnx.TensorProto.FLOAT, ["rows", size])],
        [helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, ["rows", actions])],
        [
            onnx.numpy_helper.from_array(np.array([value], dtype=np.int64), name)
            for name, value in (("start", 0), ("end", actions), ("axis", 1))
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(sealed(model, described or metadata()))
    return path


@pytest.fixture
def layout():
    return ptne_env.parallel_env("random-energy", interface="scaled").layout


def test_a_policy_acts_in_the_environment_of_its_layout(tmp_path, layout):
    policy = policies.load(write(tmp_path / "mine.onnx", size=layout.size), layout)
    assert isinstance(policy, ptne_env.Policy)
    assert policy.name == "mine"
    rows = np.random.default_rng(0).normal(size=(7, layout.size)).astype(np.float32)
    actions, state = policy.predict(rows, state="memory")
    np.testing.assert_array_equal(actions, rows[:, :5])
    assert state == "memory"
    single, _ = policy.predict(rows[3])
    np.testing.assert_array_equal(single, actions[3])


def test_metadata_survive_the_round_trip():
    original = metadata(interface=Interface("physical"), versions={"torch": "x"})
    assert Metadata.from_json(original.to_json()) == original


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"interface": Interface("physical")}, "interface"),
        ({"interface": Interface("scaled", action_scale=4.0)}, "interface"),
        ({"action_dims": (1,) * 6}, "action_dims"),
        ({"slots": 3}, "neighbour slots"),
    ],
)
def test_another_layout_is_refused_and_named(tmp_path, layout, changes, named):
    actions = sum(changes.get("action_dims", (1,) * 5))
    policy = policies.load(write(tmp_path / "mine.onnx", layout.size, actions, metadata(**changes)))
    with pytest.raises(PolicyFileError, match=named):
        policies.load(tmp_path / "mine.onnx", layout)
    with pytest.raises(PolicyFileError, match="another layout"):
        ptne_env.PolicySpec("mine", policy, Interface("scaled")).build(layout)


def test_observations_of_another_length_are_refused(tmp_path):
    policy = policies.load(write(tmp_path / "mine.onnx", size=28))
    with pytest.raises(PolicyFileError, match="length 28"):
        policy.predict(np.zeros((2, 27), dtype=np.float32))


def test_a_truncated_file_at_any_length_is_refused(tmp_path):
    content = write(tmp_path / "mine.onnx").read_bytes()
    path = tmp_path / "cut.onnx"
    for length in range(0, len(content), 37):
        path.write_bytes(content[:length])
        with pytest.raises(PolicyFileError, match=r"cut.onnx"):
            policies.load(path)


@pytest.mark.parametrize("content", [b"", b"not a network", b"PK\x03\x04 a zip", json.dumps({"a": 1}).encode()])
def test_a_foreign_file_is_refused(tmp_path, content):
    path = tmp_path / "foreign.onnx"
    path.write_bytes(content)
    with pytest.raises(PolicyFileError, match="damaged or something else"):
        policies.load(path)


def test_a_missing_policy_names_the_shipped_ones():
    with pytest.raises(ValueError, match="unknown learned policy 'no-such-policy'; choose from ppo-random-energy,"):
        policies.load("no-such-policy")
    with pytest.raises(FileNotFoundError, match=r"there is no file 'missing\.onnx'"):
        policies.load("missing.onnx")


@pytest.mark.parametrize("name", policies.shipped())
def test_every_shipped_policy_fits_the_scenarios_that_it_names(name):
    policy = policies.load(name)
    interface = policy.interface
    for scenario in map(find_scenario, policy.metadata.scenarios):
        env = ptne_env.parallel_env(scenario, interface=interface.kind, action_mode=interface.action_mode)
        policy.require(env.layout)
        observations, _ = env.reset(seed=0)
        actions, _ = policy.predict(np.stack(list(observations.values())))
        assert actions.shape == (5, env.layout.action_size)
        assert np.abs(actions).max() <= env.layout.action_bound


@pytest.mark.parametrize(
    ("name", "digits"),
    [
        ("ppo-random-energy", 5.0),
        ("ppo-random-energy-switching-transformed", 3.0),
    ],
)
def test_shipped_policies_beat_the_paper_s_laws_but_not_the_best_of_all_laws(name, digits):
    scenario = policies.load(name).metadata.scenarios[0]
    results = ptne_env.evaluate([name], [scenario], episodes=100, against_laws=True)
    assert results.record(scenario, name, "digits_over_paper_laws")["low"] >= digits
    assert results.record(scenario, name, "digits_over_all_laws")["mean"] <= 0
