"""Loading of policy files: valid files, and every kind of invalid file."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from extras import need_sb3

onnx = need_sb3("onnx")

from onnx import helper

import ptne_env
from ptne_env import Interface
from ptne_env import learn as policies
from ptne_env.evaluation.policy_specs import get_policy_spec
from ptne_env.evaluation.suite import find_scenario
from ptne_env.learn import Metadata, PolicyFileError, probe, process
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.policy import PolicyError
from ptne_env.world.world import World


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
    original = metadata(interface=Interface("physical", "gains", 2.0), versions={"torch": "x"})
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
    properties = {"ptne_env": metadata(**changes).to_json()}
    actions = sum(changes.get("action_dims", (1,) * 5))
    policy = policies.load(write(tmp_path / "mine.onnx", layout.size, actions, properties))
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


@pytest.mark.parametrize(
    ("properties", "message"),
    [
        ({}, "without the metadata"),
        ({"ptne_env": "{"}, "damaged"),
        ({"ptne_env": "[]"}, "damaged"),
        ({"ptne_env": "{}"}, "damaged"),
        ({"ptne_env": metadata(layout_version=99).to_json()}, "layout version 99"),
        ({"ptne_env": json.dumps(json.loads(metadata().to_json()) | {"unheard_of": 1})}, "later version"),
        *(
            ({"ptne_env": json.dumps(json.loads(metadata().to_json()) | changes)}, "damaged")
            for changes in (
                {"action_dims": ["a"]},
                {"action_dims": [0]},
                {"slots": "2"},
                {"digits": "many"},
                {"versions": []},
                {"versions": {"torch": 2}},
                {"scenarios": [3]},
                {"scenarios": ["\x1b[31mred"]},
                {"interface": {"kind": "scaled", "own_payoff": [1]}},
                {"interface": {"kind": ["local"]}},
            )
        ),
        ({"ptne_env": "[" * 100_000}, "damaged"),
        ({"ptne_env": '{"interface":' * 100_000}, "damaged"),
    ],
)
def test_bad_metadata_are_refused(tmp_path, properties, message):
    with pytest.raises(PolicyFileError, match=message):
        policies.load(write(tmp_path / "mine.onnx", properties=properties))


def test_a_missing_policy_names_the_shipped_ones():
    with pytest.raises(
        ValueError, match="unknown learned policy 'no-such-policy'; choose from ppo-ptne-v1-generalist,"
    ):
        policies.load("no-such-policy")
    with pytest.raises(FileNotFoundError, match=r"there is no file 'missing\.onnx'"):
        policies.load("missing.onnx")


@pytest.mark.parametrize("name", policies.shipped())
def test_every_shipped_policy_fits_the_scenarios_that_it_names(name):
    policy = policies.load(name)
    interface = policy.interface
    if isinstance(policy, policies.SizeFreeFile):
        assert policy.metadata.scenarios == ("training-worlds",)
        pytest.skip("a policy without sizes fits all scenarios: test_run.py runs it on every track of ptne-v1")
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
        ("ppo-random-energy-switching", 2.5),
        ("ppo-random-energy-switching-transformed", 3.0),
    ],
)
def test_shipped_policies_beat_the_paper_s_laws_but_not_the_best_of_all_laws(name, digits):
    scenario = policies.load(name).metadata.scenarios[0]
    results = ptne_env.evaluate([name], [scenario], episodes=100, against_laws=True)
    assert results.record(scenario, name, "digits_over_paper_laws")["low"] >= digits
    assert results.record(scenario, name, "digits_over_all_laws")["mean"] <= 0


def external(location):
    weights = onnx.TensorProto(name="w", data_type=1, dims=[28, 5], data_location=onnx.TensorProto.EXTERNAL)
    weights.external_data.add(key="location", value=location)
    return weights


def graph_of(nodes, initializers=(), inputs=("observation",), output="action"):
    return helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["rows", 28]) for name in inputs],
        [helper.make_tensor_value_info(output, onnx.TensorProto.FLOAT, ["rows", 5])],
        list(initializers),
    )


def write_graph(path, graph, **changes):
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"ptne_env": metadata(**changes).to_json()})
    path.write_bytes(model.SerializeToString())
    return path


PRODUCT = helper.make_node("MatMul", ["observation", "w"], ["action"])


def branches(nodes, initializers):
    """A graph whose weights are in both branches of an ``If``."""
    branch = graph_of(nodes, initializers, inputs=())
    condition = onnx.numpy_helper.from_array(np.array(True), "condition")
    choice = helper.make_node("If", ["condition"], ["action"], then_branch=branch, else_branch=branch)
    return graph_of([choice], [condition])


def constant(weights):
    return helper.make_node("Constant", [], ["w"], value=weights)


PLACES = {
    "initializer": lambda weights: graph_of([PRODUCT], [weights]),
    "constant": lambda weights: graph_of([constant(weights), PRODUCT]),
    "initializer of a branch": lambda weights: branches([PRODUCT], [weights]),
    "constant of a branch": lambda weights: branches(
        [helper.make_node("Constant", [], ["w"], value=weights), PRODUCT], []
    ),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("location", ["secret.bin", "below/../secret.bin", "../secret.bin", "{folder}/secret.bin"])
def test_a_file_that_refers_to_another_file_is_refused(tmp_path, monkeypatch, place, location):
    (tmp_path / "here" / "below").mkdir(parents=True)
    for folder in (tmp_path, tmp_path / "here"):
        np.arange(140, dtype=np.float32).tofile(folder / "secret.bin")
    monkeypatch.chdir(tmp_path / "here")
    path = write_graph(tmp_path / "mine.onnx", PLACES[place](external(location.format(folder=tmp_path))))
    with pytest.raises(PolicyFileError, match="mine.onnx is not a readable ONNX file"):
        policies.load(path)


@pytest.mark.parametrize("place", PLACES)
def test_the_weights_of_the_other_tests_load_from_the_file_itself(tmp_path, place):
    weights = onnx.numpy_helper.from_array(np.ones((28, 5), dtype=np.float32), "w")
    policy = policies.load(write_graph(tmp_path / "mine.onnx", PLACES[place](weights)))
    np.testing.assert_array_equal(policy.predict(np.ones(28))[0], np.full(5, 28.0))


def test_a_tensor_named_location_is_no_reference(tmp_path):
    weights = onnx.numpy_helper.from_array(np.ones((28, 5), dtype=np.float32), "location")
    product = helper.make_node("MatMul", ["observation", "location"], ["action"], name="location")
    policies.load(write_graph(tmp_path / "mine.onnx", graph_of([product], [weights])))


def with_loop(repetitions):
    """A graph that computes its weights in a loop of that many repetitions, from constants alone."""
    scalar = [(name, kind, []) for name, kind in (("index", onnx.TensorProto.INT64), ("go_on", onnx.TensorProto.BOOL))]
    state = ("before", onnx.TensorProto.FLOAT, [28, 5])
    body = helper.make_graph(
        [helper.make_node("Identity", ["go_on"], ["still"]), helper.make_node("Identity", ["before"], ["after"])],
        "body",
        [helper.make_tensor_value_info(*value) for value in (*scalar, state)],
        [
            helper.make_tensor_value_info("still", onnx.TensorProto.BOOL, []),
            helper.make_tensor_value_info("after", onnx.TensorProto.FLOAT, [28, 5]),
        ],
    )
    constants = {"count": np.array(repetitions), "yes": np.array(True), "start": np.ones((28, 5), dtype=np.float32)}
    loop = helper.make_node("Loop", ["count", "yes", "start"], ["w"], body=body)
    return graph_of([loop, PRODUCT], [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()])


def with_constants(size):
    """A graph with the sum of that many constants, which are not in the file."""
    ones = helper.make_node("ConstantOfShape", ["shape"], ["ones"], value=helper.make_tensor("v", 1, [1], [1.0]))
    total = helper.make_node("ReduceSum", ["ones"], ["total"], keepdims=0)
    product = helper.make_node("MatMul", ["observation", "weights"], ["product"])
    sum_of_both = helper.make_node("Add", ["product", "total"], ["action"])
    constants = {"shape": np.array([size]), "weights": np.ones((28, 5), dtype=np.float32)}
    return graph_of(
        [ones, total, product, sum_of_both],
        [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()],
    )


def test_a_file_that_never_ends_or_takes_all_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(probe, "SECONDS", 1)
    policies.load(write_graph(tmp_path / "small.onnx", with_loop(3)))
    with pytest.raises(PolicyFileError, match=r"large.onnx .* needs more than 1 s of processor time or 2048 MiB"):
        policies.load(write_graph(tmp_path / "large.onnx", with_loop(2**62)))
    policies.load(write_graph(tmp_path / "small.onnx", with_constants(3)))
    with pytest.raises(PolicyFileError, match=r"large.onnx is not a readable .*(bad_alloc|allocate memory|MiB)"):
        policies.load(write_graph(tmp_path / "large.onnx", with_constants(2**31)))
    monkeypatch.setattr(probe, "WAIT", 0.01)
    with pytest.raises(PolicyFileError, match=r"new.onnx .* needs more than 0.01 s to load"):
        policies.load(write_graph(tmp_path / "new.onnx", with_loop(4)))
    policies.load(write_graph(tmp_path / "small.onnx", with_loop(3)))  # the same content is not tried again


def layout_of(spec):
    return make_encoder(World(find_scenario("random-energy")), spec.interface).layout


def multiplied_by_observations(graph, name):
    """The graph with a constant times the largest observation, so that nothing is to be done for zeros."""
    next(constant for constant in graph.initializer if constant.name == name).name = "factor"
    nodes = [
        helper.make_node("ReduceMax", ["observation"], ["largest"], keepdims=0),
        helper.make_node("Cast", ["largest"], ["whole"], to=onnx.TensorProto.INT64),
        helper.make_node("Mul", ["whole", "factor"], [name]),
        *graph.node,
    ]
    del graph.node[:]
    graph.node.extend(nodes)
    return graph


@pytest.mark.parametrize(
    ("graph", "reason"),
    [
        (multiplied_by_observations(with_loop(2**25), "count"), "longer than 2 s"),
        (multiplied_by_observations(with_constants(2**29), "shape"), "bad_alloc|allocate memory"),
    ],
)
def test_a_file_that_needs_much_for_a_decision_alone_fails(tmp_path, monkeypatch, graph, reason):
    spec = get_policy_spec(str(write_graph(tmp_path / "mine.onnx", graph, interface=Interface("physical"))))
    assert not spec.is_foreign
    layout = layout_of(spec)
    with spec.deciding(layout) as policy:
        zeros, starts = np.zeros((3, 28), dtype=np.float32), np.ones(3, dtype=bool)
        assert policy.predict(zeros, None, starts, deterministic=True)[0].shape == (3, 5)
        monkeypatch.setattr(process, "PATIENCE", 2.0)  # after a slow start
        with pytest.raises(PolicyError, match=reason):
            policy.predict(zeros + 1, None, starts, deterministic=True)


def test_a_file_decides_the_same_in_its_own_process(tmp_path):
    path = tmp_path / "mine.onnx"
    path.write_bytes(policies.shipped_path("ppo-random-energy").read_bytes())
    spec, shipped = get_policy_spec(str(path)), get_policy_spec("ppo-random-energy")
    layout = layout_of(spec)
    rows = np.random.default_rng(0).normal(size=(40, layout.size)).astype(np.float32)
    with spec.deciding(layout) as policy, shipped.deciding(layout) as here:
        assert isinstance(here, policies.LearnedPolicy)
        assert not isinstance(policy, policies.LearnedPolicy)
        np.testing.assert_array_equal(policy.predict(rows)[0], here.predict(rows)[0])


@pytest.mark.skipif(sys.platform != "linux", reason="ends with its parent on Linux; elsewhere within its limits")
def test_the_trial_of_a_file_ends_with_its_process(tmp_path):
    path = write_graph(tmp_path / "large.onnx", with_loop(2**62))
    code = (
        "import sys\n"
        "from ptne_env import policies\n"
        "policies.probe.SECONDS = 60\n"
        "print('loading', flush=True)\n"
        "policies.load(sys.argv[1])\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)  # noqa: S603 - our own code
    children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
    assert parent.stdout.readline() == b"loading\n"
    assert wait_until(lambda: children.read_text(encoding="ascii").strip())
    child = Path("/proc", children.read_text(encoding="ascii").strip())
    ticks = 0.3 * os.sysconf("SC_CLK_TCK")  # of processor time: it has started to load the file
    assert wait_until(lambda: int((child / "stat").read_text(encoding="ascii").split()[13]) > ticks)
    parent.kill()
    parent.communicate()
    assert wait_until(lambda: not child.exists())


def wait_until(condition, seconds=20):
    """Whether the condition becomes true in time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return False


@pytest.mark.parametrize("rows", [1, 5])
def test_a_file_for_a_fixed_number_of_rows_is_refused(tmp_path, rows):
    path = write(tmp_path / "mine.onnx")
    model = onnx.load(path)
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_value = rows
    path.write_bytes(model.SerializeToString())
    with pytest.raises(PolicyFileError, match=r"mine.onnx"):
        policies.load(path)


def test_a_file_whose_actions_have_another_length_is_refused(tmp_path):
    with pytest.raises(PolicyFileError, match=r"mine.onnx does not answer with actions of 5 float32 numbers"):
        policies.load(write(tmp_path / "mine.onnx", actions=4))
