"""Loading of policy files: valid files, and every kind of invalid file."""

import json

import numpy as np
import pytest
from affine_games import SOAK
from extras import need_sb3

onnx = need_sb3("onnx")

from onnx import helper

import ptne_env
from ptne_env import Interface, policies
from ptne_env.experiments.suite import find_scenario
from ptne_env.policies import Metadata, PolicyFileError


def metadata(**changes):
    values = {
        "interface": Interface("local"),
        "action_dims": (1,) * 5,
        "slots": 2,
        "scenarios": ("random-energy",),
        "steps": 1,
        "seed": 0,
        "digits": 0.5,
        "versions": {"ptne_env": "0"},
    }
    return Metadata(**values | changes)


def write(path, size=28, actions=5, properties=None):
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
    helper.set_model_props(model, {"ptne_env": metadata().to_json()} if properties is None else properties)
    path.write_bytes(model.SerializeToString())
    return path


@pytest.fixture
def layout():
    return ptne_env.parallel_env("random-energy", interface="local").layout


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
    original = metadata(interface=Interface("physical", "gains", 2.0), versions={"torch": "x"})
    assert Metadata.from_json(original.to_json()) == original


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"interface": Interface("physical")}, "interface"),
        ({"interface": Interface("local", action_scale=4.0)}, "interface"),
        ({"action_dims": (1,) * 6}, "action_dims"),
        ({"slots": 3}, "neighbour slots"),
    ],
)
def test_another_layout_is_refused_and_named(tmp_path, layout, changes, named):
    properties = {"ptne_env": metadata(**changes).to_json()}
    policy = policies.load(write(tmp_path / "mine.onnx", size=layout.size, properties=properties))
    with pytest.raises(PolicyFileError, match=named):
        policies.load(tmp_path / "mine.onnx", layout)
    with pytest.raises(PolicyFileError, match="another layout"):
        ptne_env.PolicySpec("mine", policy, Interface("local")).build(layout)


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


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ({}, "without the metadata"),
        ({"ptne_env": "{"}, "damaged"),
        ({"ptne_env": "[]"}, "damaged"),
        ({"ptne_env": "{}"}, "damaged"),
        ({"ptne_env": metadata(layout_version=99).to_json()}, "layout version 99"),
        ({"ptne_env": json.dumps(json.loads(metadata().to_json()) | {"unheard_of": 1})}, "later version"),
    ],
)
def test_bad_metadata_are_refused(tmp_path, properties, message):
    with pytest.raises(PolicyFileError, match=message):
        policies.load(write(tmp_path / "mine.onnx", properties=properties))


def test_a_missing_policy_names_the_shipped_ones():
    with pytest.raises(FileNotFoundError, match="shipped policy"):
        policies.load("no-such-policy")


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
    ("name", "metric", "digits"),
    [
        ("ppo-random-energy", "digits_over_paper_laws", 5.0),
        ("ppo-random-energy-switching", "digits_over_all_laws", 2.5),
        ("ppo-random-energy-switching-transformed", "digits_over_all_laws", 1.0),
    ],
)
def test_shipped_policies_beat_tuned_laws_on_unseen_games(name, metric, digits, monkeypatch):
    if not SOAK:  # laws tuned on fewer episodes take a tenth of the time
        monkeypatch.setattr("ptne_env.experiments.tuning.VALIDATION_EPISODES", 20)
    scenario = policies.load(name).metadata.scenarios[0]
    results = ptne_env.evaluate([name], [scenario], episodes=100)
    assert results.record(scenario, name, metric)["low"] >= digits


def test_a_file_that_refers_to_another_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret.bin").write_bytes(np.arange(140, dtype=np.float32).tobytes())
    model = onnx.load(write(tmp_path / "mine.onnx"))
    weights = onnx.TensorProto(name="w", data_type=1, dims=[28, 5], data_location=onnx.TensorProto.EXTERNAL)
    weights.external_data.add(key="location", value="secret.bin")
    del model.graph.initializer[:], model.graph.node[:]
    model.graph.initializer.append(weights)
    model.graph.node.append(helper.make_node("MatMul", ["observation", "w"], ["action"]))
    (tmp_path / "mine.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(PolicyFileError, match="mine.onnx keeps weights in another file"):
        policies.load(tmp_path / "mine.onnx")
