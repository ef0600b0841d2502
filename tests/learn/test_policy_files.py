"""Reading policy files: they are data, and what is damaged, foreign, large or made for something else is refused."""

import json
import sys
import time
from hashlib import sha256
from pathlib import Path
from textwrap import dedent
from zipfile import ZipFile

import numpy as np
import pytest
from affine_games import SOAK
from extras import need_sb3

onnx = need_sb3("onnx")

from onnx import helper
from policy_files import OBSERVATION, first_entries, metadata, network, write
from processes import run_python

import ptne_env
from ptne_env import Interface, learn
from ptne_env.evaluation import get_policy_spec
from ptne_env.learn import Metadata, PolicyFileError
from ptne_env.learn.sb3_archive import load_archive
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.files import DamagedFileError
from ptne_env.suites import find_scenario
from ptne_env.training import configurations


@pytest.fixture
def layout():
    return ptne_env.parallel_env("random-energy").layout


def test_a_policy_acts_in_the_environment_of_its_layout(tmp_path, layout):
    policy = learn.load(write(tmp_path / "mine.onnx"), layout)
    assert isinstance(policy, ptne_env.Policy)
    assert policy.name == "mine"
    rows = np.random.default_rng(0).normal(size=(7, layout.size)).astype(np.float32)
    actions, state = policy.predict(rows, state="memory")
    np.testing.assert_array_equal(actions, rows[:, :5])
    assert state == "memory"
    single, _ = policy.predict(rows[3])
    np.testing.assert_array_equal(single, actions[3])
    with pytest.raises(ValueError, match=f"length {OBSERVATION}"):
        policy.predict(rows[:, 1:])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (
            {"interface": Interface("physical")},
            r"interface: policy Interface\('physical'\), environment Interface\('scaled'\)",
        ),
        ({"action_dims": (1,) * 6}, "action_dims"),
        ({"slots": 3}, "slots: policy 3, environment 2"),
    ],
)
def test_another_layout_is_refused_and_named(tmp_path, layout, changes, named):
    path = write(tmp_path / "mine.onnx", first_entries(actions=len(changes.get("action_dims", "12345"))), **changes)
    learn.load(path)
    with pytest.raises(LayoutError, match=f"another layout; .*{named}"):
        learn.load(path, layout)


def test_a_file_with_any_damaged_byte_or_length_is_refused(tmp_path):
    path = write(tmp_path / "mine.onnx")
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(5000 if SOAK else 100):
        damaged = bytearray(content)
        damaged[rng.integers(len(content))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged if rng.random() < 0.7 else content[: rng.integers(len(content))])
        with pytest.raises(PolicyFileError, match="damaged"):
            learn.load(path)
    path.write_bytes(content)
    learn.load(path)


OTHERS = [b"", b"not a network", b"PK\x03\x04 a zip", b"{}", first_entries().SerializeToString()]


@pytest.mark.parametrize("content", OTHERS)
def test_a_foreign_file_is_refused(tmp_path, content):
    path = tmp_path / "foreign.onnx"
    path.write_bytes(content)
    with pytest.raises(PolicyFileError, match=r"foreign.onnx is .*damaged"):
        learn.load(path)


@pytest.mark.parametrize("size", [2**24 + 1, 2**40])
@pytest.mark.parametrize("name", ["large.onnx", "large.npz"])
def test_a_large_file_is_refused_before_it_is_read(tmp_path, name, size):
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(size)  # it takes no space
    with pytest.raises(DamagedFileError, match=rf"{name} has more than 16 MiB"):
        learn.load(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a device that never ends")
@pytest.mark.parametrize("name", ["endless.onnx", "endless.npz", "endless.zip"])
def test_a_link_to_a_device_is_refused_before_it_is_read(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises(DamagedFileError, match=f"{name}' is a pipe or a device: name a regular file"):
        get_policy_spec(str(tmp_path / name), trust=True)
    with pytest.raises(DamagedFileError, match=f"{name}' is a pipe or a device"):
        (load_archive if name.endswith(".zip") else learn.load)(tmp_path / name)


CHANGES = ({"unheard_of": 1}, {"action_dims": ["a"]}, {"action_dims": [0]}, {"slots": "2"}, {"interface": ["scaled"]})
BAD = [json.dumps(json.loads(metadata().to_json()) | each) for each in CHANGES]


@pytest.mark.parametrize("text", [*BAD, "{", "[]", "{}", "[" * 100_000, '{"interface":' * 100_000])
def test_metadata_that_are_no_description_are_refused(text):
    with pytest.raises(PolicyFileError, match="damaged or of another version"):
        Metadata.from_json(text)


def test_metadata_of_another_version_are_refused_with_advice():
    with pytest.raises(PolicyFileError, match=r"layout version 99, this library has 1; use the version of ptne_env"):
        Metadata.from_json(metadata(layout_version=99).to_json())


def test_a_missing_policy_names_the_shipped_ones():
    with pytest.raises(
        ValueError, match="unknown learned policy 'no-such-policy'; choose from ppo-.*ppo-random-energy"
    ):
        learn.load("no-such-policy")
    with pytest.raises(FileNotFoundError, match=r"there is no file 'missing\.onnx'"):
        learn.load("missing.onnx")


def test_the_shipped_files_are_found_in_a_zip(tmp_path):
    package, archive = Path(ptne_env.__file__).parent, tmp_path / "library.zip"
    with ZipFile(archive, "w") as library:
        for path in package.rglob("*.*"):
            if path.suffix in (".py", ".onnx", ".npz", ".toml"):
                library.write(path, path.relative_to(package.parent))
    program = """
    import hashlib, ptne_env
    from ptne_env import learn, training
    assert ".zip" in ptne_env.__file__
    print(*(hashlib.sha256(learn.shipped_path(name).read_bytes()).hexdigest() for name in learn.shipped_names()))
    print(*training.configurations())
    """
    hashes, names = run_python("-c", dedent(program), modules=[archive], folder=tmp_path).stdout.splitlines()
    assert hashes.split() == [
        sha256(learn.shipped_path(name).read_bytes()).hexdigest() for name in learn.shipped_names()
    ]
    assert names.split() == list(configurations())


@pytest.mark.parametrize("module", ["onnx", "onnxruntime"])
def test_without_onnx_the_extra_to_install_is_named(monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r'pip install "ptne-env\[bench\]"'):
        learn.load("ppo-random-energy")


def product(weights, size=OBSERVATION):
    return network([helper.make_node("MatMul", ["observation", "w"], ["action"])], {"w": weights}, size=size)


def external_weights():
    """Weights that are in another file, which exists."""
    weights = onnx.TensorProto(name="w", data_type=1, dims=[OBSERVATION, 5], data_location=onnx.TensorProto.EXTERNAL)
    weights.external_data.add(key="location", value="secret.bin")
    return weights


def as_constant():
    weights = helper.make_node("Constant", [], ["w"], value=external_weights())
    return network([weights, helper.make_node("MatMul", ["observation", "w"], ["action"])], {})


def with_operator(kind, **attributes):
    return network([helper.make_node(kind, ["observation"], ["action"], **attributes)], {}, actions=OBSERVATION)


def large_sum():
    """The sum of a column and a row has more numbers than the file."""
    column, row = np.ones((2**13, 1), dtype=np.float32), np.ones((1, 2**13), dtype=np.float32)
    nodes = [
        helper.make_node("Add", ["column", "row"], ["sum"]),
        helper.make_node("Slice", ["sum", "start", "end"], ["w"]),
        helper.make_node("MatMul", ["observation", "w"], ["action"]),
    ]
    ends = {"start": np.array([0, 0]), "end": np.array([OBSERVATION, 5])}
    return network(nodes, {"column": column, "row": row, **ends})


BRANCH = helper.make_graph([], "branch", [], [])
REFUSED = {
    "weights in another file": (lambda: product(external_weights()), "refers to other files"),
    "a constant in another file": (as_constant, "refers to other files"),
    "a loop": (lambda: with_operator("Loop", body=BRANCH), "operations that are not allowed: Loop"),
    "a branch": (lambda: with_operator("If", then_branch=BRANCH), "operations that are not allowed: If"),
    "random numbers": (lambda: with_operator("RandomNormalLike"), "not allowed: RandomNormalLike"),
    "an operation of others": (lambda: with_operator("Tanh", domain="others"), "not allowed: others.Tanh"),
    "an array larger than the file": (large_sum, "computes an array of .* more than 1048576 numbers, 'sum'"),
    "a long observation": (lambda: first_entries(size=2**40), "more than 1048576 numbers, 'observation'"),
    "weights that do not fit": (lambda: product(np.ones((3, 5), dtype=np.float32)), "is no valid network"),
    "one row only": (lambda: first_entries(rows=1), "cannot decide a batch of any number of rows"),
    "actions of another length": (lambda: first_entries(actions=4), "answer with actions of 5 float32 numbers"),
    "too many operations": (
        lambda: network([helper.make_node("Tanh", ["observation"], [str(n)]) for n in range(1001)], {}),
        "more than 1000 operations",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_network_with_anything_but_arithmetic_of_moderate_size_is_refused_at_once(case, tmp_path, monkeypatch):
    build, reason = REFUSED[case]
    np.ones(OBSERVATION * 5, dtype=np.float32).tofile(tmp_path / "secret.bin")
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path / "mine.onnx", build())
    began = time.process_time()
    with pytest.raises(PolicyFileError, match=f"mine.onnx .*{reason}"):
        learn.load(path)
    assert time.process_time() - began < 20


@pytest.mark.parametrize(
    ("name", "scenario", "digits"),
    [("ppo-random-energy", "random-energy", 10.0), ("ppo-ptne-v1", "ptne-v1/nominal", 7.0)],
)
def test_the_shipped_policies_have_digits_where_they_were_trained(name, scenario, digits):
    policy = learn.load(name)
    assert policy.metadata.training["scenario"] == scenario
    results = ptne_env.evaluate([name], [find_scenario(scenario)], episodes=10, split="validation")
    assert results.record(results.tracks[0].name, name, "digits")["mean"] > digits
