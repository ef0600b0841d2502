"""Reading policy files: they are data, and what is damaged, foreign, large or made for something else is refused."""

from pathlib import Path

import numpy as np
import pytest
from affine_games import SOAK
from policy_files import OBSERVATION, RECURRENT, layered, metadata, pack, pack_text, write

import ptne_env
from ptne_env import Interface, learn
from ptne_env.evaluation import get_policy_spec
from ptne_env.learn import PolicyFileError, npz_policy
from ptne_env.learn.sb3_archive import load_archive
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.files import DamagedFileError
from ptne_env.suites import get_suite


def opened(content):
    return npz_policy.open_policy(Path("mine.npz"), content)


@pytest.fixture
def layout():
    return ptne_env.parallel_env("random-energy").layout


@pytest.mark.parametrize(("activation", "function"), [("relu", lambda x: np.maximum(x, 0)), ("tanh", np.tanh)])
@pytest.mark.parametrize(("is_squashed", "bound"), [(False, lambda x: np.clip(x, -1, 1)), (True, np.tanh)])
def test_a_policy_acts_in_the_environment_of_its_layout(tmp_path, layout, activation, function, is_squashed, bound):
    policy = learn.load(write(tmp_path / "mine.npz", activation=activation, is_squashed=is_squashed), layout)
    assert isinstance(policy, ptne_env.Policy)
    assert policy.name == "mine"
    rows = 5 * np.random.default_rng(0).normal(size=(7, layout.size)).astype(np.float32)
    actions, state = policy.predict(rows, state="memory")
    first, first_bias, out, out_bias = layered().values()
    expected = out @ function(first @ rows.T + first_bias) + out_bias
    np.testing.assert_allclose(actions, bound(expected.T), rtol=1e-5, atol=1e-6)
    assert state == "memory"
    single, _ = policy.predict(rows[3])
    np.testing.assert_array_equal(single, actions[3])
    with pytest.raises(ValueError, match=f"length {OBSERVATION}"):
        policy.predict(rows[:, 1:])


def test_a_network_may_have_one_layer_alone(tmp_path):
    weights = {"out": np.eye(5, OBSERVATION, dtype=np.float32), "out_bias": np.zeros((5, 1), dtype=np.float32)}
    rows = np.random.default_rng(0).normal(size=(7, OBSERVATION)).astype(np.float32)
    actions, _ = learn.load(write(tmp_path / "mine.npz", weights)).predict(rows)
    np.testing.assert_array_equal(actions, np.clip(rows[:, :5], -1, 1))


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
    path = write(tmp_path / "mine.npz", layered(actions=len(changes.get("action_dims", "12345"))), **changes)
    learn.load(path)
    with pytest.raises(LayoutError, match=f"another layout; .*{named}"):
        learn.load(path, layout)


@pytest.mark.parametrize("content", [npz_policy.seal(layered(), metadata()), npz_policy.seal(RECURRENT, {"seed": 0})])
def test_a_file_with_a_damaged_byte_or_length_is_refused_or_plays_the_same(content):
    weights = opened(content).weights
    rng, count, refused = np.random.default_rng(0), 5000 if SOAK else 150, 0
    for _ in range(count):
        damaged = bytearray(content)
        damaged[rng.integers(len(content))] ^= 1 << rng.integers(8)
        try:
            again = opened(bytes(damaged) if rng.random() < 0.7 else content[: rng.integers(len(content))]).weights
        except PolicyFileError:
            refused += 1
        else:  # the damage is in a date or the like
            np.testing.assert_equal(again, weights)
    assert refused > 0.8 * count


def recurrent_with(version=6, **changes):
    return pack(RECURRENT | changes, version, training={})


def layered_with(**changes):
    return pack(layered(), layered=metadata().to_dict() | changes)


def test_weights_of_a_training_that_diverged_make_no_file():
    with pytest.raises(ValueError, match="a weight is not finite: the training diverged"):
        npz_policy.seal(layered() | {"out": layered()["out"] * np.nan}, metadata())


LARGE = np.zeros((3, 2000, 2000), dtype=np.float32)
FOREIGN = {
    "nothing": (b"", ""),
    "text": (b"{}", ""),
    "cut off": (b"PK\x03\x04 a zip", ""),
    "another version": (
        recurrent_with(version=9),
        "it is of version 9, and 6 is expected: use the version of ptne_env that made it",
    ),
    "other shapes": (recurrent_with(gate=np.zeros((1, 5), dtype=np.float32)), "other shapes"),
    "more weights": (recurrent_with(more=np.zeros(1, dtype=np.float32)), "other shapes"),
    "not a number": (recurrent_with(gate=RECURRENT["gate"] * np.nan), "not finite"),
    "large": (recurrent_with(again=LARGE), "unpacks to more than 16 MiB"),
    "large with layers": (pack(layered() | {"again": LARGE}, layered={}), "unpacks to more than 16 MiB"),
    "objects": (recurrent_with(gate=np.array([print])), "Object arrays cannot be loaded"),
    "no layers": (pack(RECURRENT, layered=metadata().to_dict()), ""),
    "other actions": (layered_with(action_dims=[1] * 4), "other shapes"),
    "an unknown value": (layered_with(unheard_of=1), "unheard_of"),
    "a player without actions": (layered_with(action_dims=[0]), "action_dims must be"),
    "a text for a number": (layered_with(slots="2"), "slots must be"),
    "a list for an interface": (layered_with(interface=["scaled"]), ""),
    "another function": (layered_with(activation="elu"), "unknown activation 'elu'; did you mean 'relu'"),
    "a text for a flag": (layered_with(is_squashed="no"), "is_squashed must be True or False"),
    **{text[:9]: (pack_text(layered(), text), "") for text in ("{", "[]", "{}", "[" * 100_000, '{"a":' * 100_000)},
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_foreign_file_is_refused_with_the_reason(case):
    content, reason = FOREIGN[case]
    with pytest.raises(PolicyFileError, match=f"mine.npz is damaged, or no policy of this library: .*{reason}"):
        opened(content)


@pytest.mark.parametrize("size", [2**25 + 1, 2**40])
def test_a_large_file_is_refused_before_it_is_read(tmp_path, size):
    path = tmp_path / "large.npz"
    with path.open("wb") as file:
        file.truncate(size)  # it takes no space
    with pytest.raises(DamagedFileError, match=r"large\.npz has more than 32 MiB"):
        learn.load(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a device that never ends")
@pytest.mark.parametrize("name", ["endless.npz", "endless.zip"])
def test_a_link_to_a_device_is_refused_before_it_is_read(tmp_path, name):
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises(DamagedFileError, match=f"{name}' is a pipe or a device: name a regular file"):
        get_policy_spec(str(tmp_path / name), trust=True)
    with pytest.raises(DamagedFileError, match=f"{name}' is a pipe or a device"):
        (load_archive if name.endswith(".zip") else learn.load)(tmp_path / name)


def test_a_missing_policy_names_the_shipped_ones():
    with pytest.raises(
        ValueError, match="unknown learned policy 'no-such-policy'; choose from ppo-.*recurrent-random-worlds"
    ):
        learn.load("no-such-policy")
    with pytest.raises(FileNotFoundError, match=r"there is no file 'missing\.npz'"):
        learn.load("missing.npz")


def test_each_track_has_the_file_of_ppo_that_was_trained_on_it():
    for track in (track.name for track in get_suite("ptne-v1").tracks):
        policy = learn.load(f"ppo-{track}")
        assert policy.metadata.training["scenario"] == f"ptne-v1/{track}"
        policy.with_layout(ptne_env.parallel_env(f"ptne-v1/{track}").layout)  # else it raises


@pytest.mark.parametrize(
    ("name", "scenario", "digits"),
    [("recurrent-random-worlds", "random-energy", 10.0), ("ppo", "ptne-v1/nominal", 10.0)],
)
def test_the_shipped_policies_have_digits_where_they_were_trained(name, scenario, digits):
    results = ptne_env.evaluate([name], [ptne_env.get_scenario(scenario)], episodes=10, split="validation")
    assert results.record(results.tracks[0].name, name, "digits")["mean"] > digits
