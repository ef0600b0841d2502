"""Entries: policies by name, file, address and pattern, and what a spec may declare."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_suite import BASE

import ptne_env
from ptne_env import FactorySpec, Interface, PolicySpec, evaluate, get_scenario, laws, theory
from ptne_env.evaluation import COMPARED, POLICIES, get_policy_spec
from ptne_env.evaluation.comparison import as_list
from ptne_env.learn import shipped_path
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.policy import PolicyError
from ptne_env.world.world import World


def test_every_named_policy_can_be_made_and_is_its_own_dict_and_back():
    assert {*COMPARED} < {*POLICIES}
    for name, spec in POLICIES.items():
        assert spec.name == name
        assert spec.description.endswith(".")
        assert PolicySpec.from_dict(spec.to_dict()) == spec
        assert not spec.is_own
    assert {name for name, spec in POLICIES.items() if spec.is_oracle} == {"oracle"}


def test_several_training_seeds_are_their_own_dict_and_back_and_objects_are_not():
    several = PolicySpec("several", (FactorySpec.of("law:static", kappa=1.0), FactorySpec.of("law:static", kappa=2.0)))
    assert PolicySpec.from_dict(several.to_dict()) == several
    with pytest.raises(ValueError, match="was an object"):
        PolicySpec.from_dict(PolicySpec("mine", laws.Static(ptne_env.parallel_env("energy").layout)).to_dict())
    with pytest.raises(ValueError, match="no training seed"):
        PolicySpec("none", ())


def test_what_a_policy_declares_cannot_be_overridden():
    assert PolicySpec("mine", object).interface == Interface("scaled")  # declares none
    assert PolicySpec("named", type("Mine", (), {"interface": "physical"})).interface == Interface("physical")
    assert PolicySpec("oracle-2", FactorySpec.of("law:oracle")).interface == Interface("full")
    for policy in (laws.Oracle, FactorySpec.of("law:oracle")):
        with pytest.raises(ValueError, match="declares the interface .*'full'.*cannot act through .*'physical'"):
            PolicySpec("honest", policy, Interface("physical"))
    data = POLICIES["oracle"].to_dict() | {"interface": {"kind": "physical"}}
    with pytest.raises(ValueError, match="declares the interface"):
        PolicySpec.from_dict(data)
    with pytest.raises(ValueError, match="different interfaces"):
        PolicySpec("both", (laws.Static, laws.Oracle))


def test_a_pattern_names_the_training_seeds_of_one_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("lr=0.1", "runs/lr=0.1", "runs/lr=0.2"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "policy.npz").write_bytes(shipped_path("ppo-nominal").read_bytes())
    for path in ("lr=0.1/policy.npz", "runs/lr=0.1/policy.npz"):  # a path with an equals sign is a file
        assert get_policy_spec(path).policy == FactorySpec.of("policy:file", path_or_name=path)
        assert as_list(Path(path)) == [Path(path)]
        assert get_policy_spec(path) == get_policy_spec(Path(path))
        assert get_policy_spec(path).is_own
    assert len(get_policy_spec("mine=runs/lr=*/policy.npz").training_seeds) == 2
    with pytest.raises(FileNotFoundError, match=r"there is no file 'none-\*.npz', which 'mine=none-\*.npz' asks for"):
        get_policy_spec("mine=none-*.npz")
    (tmp_path / "evil.py").touch()
    with pytest.raises(ValueError, match="policy files end in .npz or .zip"):
        get_policy_spec("mine=*.py")


def test_a_policy_may_have_one_file_per_track(tmp_path):
    name, other = "random-energy", "random-energy-switching"
    for scenario, shipped in ((name, "ppo-nominal"), ("energy", "ppo-liar")):
        (tmp_path / f"{scenario}.npz").write_bytes(shipped_path(shipped).read_bytes())
    several = get_policy_spec(f"mine={tmp_path}/{{track}}.npz")
    assert PolicySpec.from_dict(several.to_dict()) == several
    alone = get_policy_spec(tmp_path / f"{name}.npz")
    assert alone.on_scenario(name) is alone  # no file is read again for each job
    results = evaluate([several, alone], [get_scenario(each, slots=4) for each in (name, other)], episodes=3)
    assert np.array_equal(results.samples[name, "mine"]["digits"], results.samples[name, name]["digits"])
    assert results.not_applicable == {
        (
            other,
            "mine",
        ): "it has one file per track, for energy, random-energy, and none for this one: choose one of those"
    }
    known = several.to_dict()
    (tmp_path / "energy.npz").unlink()
    assert several.to_dict() != known  # the hash is of all files
    (tmp_path / f"{name}.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"there is no file '.*{track}.npz'"):
        get_policy_spec(f"mine={tmp_path}/{{track}}.npz")


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("static(kappa=4)", FactorySpec.of("law:static", kappa=4)),
        ("static-tuned(kappa=4, )", FactorySpec.of("law:static", kappa=4, gradient_gain=2.94)),
        ("relay()", FactorySpec.of("law:relay")),
        ("law:static(kappa=4.5)", FactorySpec.of("law:static", kappa=4.5)),
        (
            "law:coded(policy={'target': 'law:static'})",
            FactorySpec.of("law:coded", policy=FactorySpec.of("law:static")),
        ),
    ],
)
def test_arguments_follow_a_name_in_parentheses(text, spec):
    assert get_policy_spec(text) == PolicySpec(text, spec)


@pytest.mark.parametrize("law", ["static", "static-tuned", "gadjov-pavel", "adaptive", "fixed-time"])
def test_the_law_that_a_certificate_prints_is_the_name_of_the_same_policy(law):
    printed = theory.certify("energy", law).law
    assert get_policy_spec(printed).policy == POLICIES[law].policy
    assert get_policy_spec(POLICIES[law].policy).name == printed


def test_a_dictionary_names_policies_and_archives_are_trusted_by_an_argument(tmp_path):
    policies = {"mine": laws.Static, "paper": "static", "other": PolicySpec("grounded", laws.Grounded)}
    results = evaluate(policies, BASE, episodes=1)
    assert list(results.policies) == ["mine", "paper", "other"]
    mine, paper = (results.samples[BASE.name, name]["digits"] for name in ("mine", "paper"))
    np.testing.assert_array_equal(mine, paper)
    (tmp_path / "model.zip").touch()
    with pytest.raises(ValueError, match="say trust=True"):
        evaluate({"mine": tmp_path / "model.zip"}, BASE)
    with pytest.raises((ValueError, ImportError), match=r"not an archive|ptne-env\[sb3\]"):
        evaluate({"mine": tmp_path / "model.zip"}, BASE, trust=True)


@pytest.mark.parametrize(
    "change",
    [
        {"training_seeds": 3},
        {"training_seeds": [{"target": 3, "arguments": {}}]},
        {"training_seeds": [3]},
        {"training_seeds": []},
        {"interface": {"kind": "scaled", "colour": "red"}},
        {"interface": None},
    ],
)
def test_data_of_another_form_are_no_policy(change):
    with pytest.raises(ValueError, match="policy|part|training seed"):
        PolicySpec.from_dict(POLICIES["static"].to_dict() | change)


def test_a_model_with_another_interface_is_refused_with_advice():
    layout = Encoder(World(BASE), Interface("physical")).layout
    model = SimpleNamespace(
        observation_space=layout.observation_space(),
        predict=lambda rows, *_, **__: (np.zeros((len(rows), layout.action_size), np.float32), None),
    )
    with pytest.raises(ValueError, match=r"shape \(28,\).*'scaled'\) has \(24,\).*PolicySpec\(name, model, "):
        evaluate(PolicySpec("mine", model), BASE, episodes=1)
    assert evaluate(PolicySpec("mine", model, Interface("physical")), BASE, episodes=1).samples


def test_a_dictionary_may_name_a_pattern_of_files(tmp_path):
    for seed in range(2):
        (tmp_path / f"seed-{seed}.npz").write_bytes(shipped_path("recurrent-random-worlds").read_bytes())
    policies = {"mine": f"{tmp_path}/seed-*.npz", "same": f"other={tmp_path}/seed-*.npz"}
    results = evaluate(policies, BASE, episodes=3)
    for name in policies:
        assert results.samples[BASE.name, name]["digits"].shape == (2, 3)


def test_a_law_acts_through_its_interface_or_not_at_all():
    """Through another one, its inputs would be clipped to the box of actions without a word."""
    partly = evaluate({"mine": partial(laws.Static, kappa=4.0)}, BASE, episodes=2)
    by_name = evaluate({"mine": "static(kappa=4)"}, BASE, episodes=2)
    assert (partly.values(BASE.name, "mine", "digits") == by_name.values(BASE.name, "mine", "digits")).all()
    results = evaluate({"mine": lambda layout: laws.Static(layout, kappa=4.0), "static": "static"}, BASE, episodes=2)
    assert "returned a Static, which acts through Interface('physical')" in results.failures[BASE.name, "mine"]


def test_a_function_says_that_its_policy_sends_code():
    """Otherwise tables would rank it among policies whose messages are their estimates."""

    def make(layout):
        return laws.Coded(layout, laws.Static)

    layout = Encoder(World(BASE), Interface("physical")).layout
    with pytest.raises(PolicyError, match="returned a Coded, whose messages are no estimates: .* sends_code = True"):
        PolicySpec("mine", make, Interface("physical")).build(layout)
    make.sends_code = True
    spec = PolicySpec("mine", make, Interface("physical"))
    assert spec.build(layout).sends_code
    assert spec.mark == "‡"


class Broken(laws.Static):
    """A law with a mistake of its own."""

    def __init__(self, layout):
        raise ValueError("a mistake of my own")


def test_only_a_layout_error_makes_a_policy_not_applicable():
    broken = [
        PolicySpec("broken", Broken),
        PolicySpec("nothing", lambda layout: object()),
        PolicySpec("uncalled", object),
        PolicySpec("alone", SimpleNamespace(predict=lambda rows, *_, **__: np.zeros((len(rows), 5)))),
        PolicySpec("short", SimpleNamespace(predict=lambda rows, memory: (np.zeros((len(rows), 5)), memory))),
    ]
    results = evaluate(["static", *broken], [BASE], episodes=1)
    failures = {policy: reason for (_, policy), reason in results.failures.items()}
    assert failures["broken"].startswith("it cannot be built: ValueError: a mistake of my own")
    assert failures["nothing"].startswith("called with the layout, it returned a object without predict(")
    assert "; it is called with the layout" in failures["uncalled"]
    assert failures["alone"] == "step 0: predict returns (actions, state), got a ndarray alone"
    assert "expected predict(observation, state, episode_start, deterministic): too many" in failures["short"]
    assert not results.not_applicable
