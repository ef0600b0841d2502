"""The arguments of a training run are checked when they are made."""

import dataclasses
import re
from pathlib import Path

import pytest
from extras import need_sb3

need_sb3("pydantic")

from ptne_env.bench import find_scenario
from ptne_env.learn.training import configurations
from ptne_env.learn.training.arguments import Arguments


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("steps", -5, "be greater than 0, got -5"),
        ("steps", 0, "be greater than 0, got 0"),
        ("steps", True, "be a valid integer, got True"),
        ("steps", "5", "be a valid integer, got '5'"),
        ("steps", 2.0, "be a valid integer, got 2.0"),
        ("steps", 2**32, "be less than 4294967296, got 4294967296"),
        ("envs", 0, "be greater than 0, got 0"),
        ("rollout", -1, "be greater than 0, got -1"),
        ("minibatches", 0, "be greater than 0, got 0"),
        ("epochs", 0, "be greater than 0, got 0"),
        ("learning_rate", 0.0, "be greater than 0, got 0.0"),
        ("learning_rate", float("inf"), "be a finite number, got inf"),
        ("learning_rate", "fast", "be a valid number, got 'fast'"),
        ("discount", 2, "be less than or equal to 1, got 2"),
        ("discount", float("nan"), "be a finite number, got nan"),
        ("trace", -0.1, "be greater than or equal to 0, got -0.1"),
        ("clip", -1, "be greater than 0, got -1"),
        ("clip", True, "be a valid number, got True"),
        ("products", 1, "be a valid boolean, got 1"),
        ("log_std", 1000.0, "be less than or equal to 5, got 1000.0"),
        ("seed", -1, "be greater than or equal to 0, got -1"),
        ("validation_episodes", 0, "be greater than 0, got 0"),
        ("checkpoint_rollouts", 0, "be greater than 0, got 0"),
        ("interface", "lokal", "be 'physical', 'local', 'learner' or 'full', got 'lokal'"),
        ("hidden", 64, "be a list, got 64"),
        ("scenarios", [], "have at least 1 item after validation, not 0, got ()"),
    ],
)
def test_a_wrong_value_is_refused_with_name_value_and_range(name, value, expected, tmp_path):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole message follows
        Arguments(**{"scenarios": "random-energy", name: value})
    assert str(caught.value) == f"{name} must {expected}"
    good = Arguments("random-energy")
    with pytest.raises(ValueError, match=f"^{name} must "):
        dataclasses.replace(good, **{name: value})


def test_every_wrong_value_of_a_file_is_named_in_one_line(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('hidden = [64, -1]\nlearning_rat = 1.0\nsteps = "many"\nenv = 3\n', encoding="utf-8")
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole message follows
        Arguments.from_toml(path)
    assert str(caught.value) == (
        "mine.toml: scenarios is missing; steps must be a valid integer, got 'many'; "
        "hidden.1 must be greater than 0, got -1; unknown argument 'env'; did you mean 'envs'?; "
        "unknown argument 'learning_rat'; did you mean 'learning_rate'?"
    )


def test_positions_are_named_too():
    with pytest.raises(ValueError, match="^interface must be .*, got 'random-energy'$"):
        Arguments("random-energy", "random-energy")
    with pytest.raises(ValueError, match="^unknown argument '18'; choose from action_mode, "):
        Arguments(*dataclasses.astuple(Arguments("random-energy")), 1)


def test_lists_single_names_and_whole_numbers_are_taken():
    arguments = Arguments("random-energy", hidden=[32], learning_rate=1, discount=0)
    assert arguments.scenarios == ("random-energy",)
    assert arguments.hidden == (32,)
    assert isinstance(arguments.learning_rate, float)
    with pytest.raises(dataclasses.FrozenInstanceError):
        arguments.steps = 1


def test_the_seed_of_a_file_counts_unless_another_is_given(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('scenarios = ["random-energy"]\nseed = 7\n', encoding="utf-8")
    assert Arguments.from_toml(path).seed == 7
    assert Arguments.from_toml(path, seed=0).seed == 0


def test_configurations_name_scenarios_of_the_catalogue():
    assert configurations()
    for name in configurations():
        arguments = Arguments.from_toml(name, seed=3)
        assert all(find_scenario(name) for name in arguments.scenarios)
        assert arguments.seed == 3


def test_the_file_in_the_document_is_a_configuration(tmp_path):
    document = Path(__file__).parents[2] / "docs" / "learning.md"
    (text,) = re.findall(r"```toml\n(.*?)```", document.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    expected = Arguments("random-energy", "learner", steps=2_000_000, epochs=1, learning_rate=1.5e-3)
    assert Arguments.from_toml(tmp_path / "mine.toml") == expected


@pytest.mark.parametrize("name", ["robots", "ptne-v1/delay", "nowhere:scenario", "nowhere:suite/track"])
def test_a_scenario_or_track_is_a_configuration_with_defaults(name):
    assert Arguments.from_toml(name, seed=2) == Arguments(name, seed=2)  # nothing is imported


def test_an_unknown_configuration_or_another_file_is_refused(tmp_path):
    with pytest.raises(
        ValueError, match="unknown configuration 'nope'; choose from .*random-energy, .* or a .toml file"
    ):
        Arguments.from_toml("nope")
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xff")
    with pytest.raises(ValueError, match="mine.toml is not a TOML file"):
        Arguments.from_toml(path)
