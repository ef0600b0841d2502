"""Policies by name, file, address and pattern."""

from types import SimpleNamespace

import numpy as np
import pytest
from extras import need_sb3
from ptne_env.evaluation.policy_specs import ARCHIVE, foreign_code
from ptne_env.evaluation.suite import REFERENCES
from small_suite import BASE, SMALL

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.evaluation import COMPARED, default_policies, get_policy_spec, run_suite, suite_policies
from ptne_env.learn import shipped_path
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.world.world import World


def test_the_default_policies_leave_out_those_trained_on_no_scenario_of_the_catalogue():
    names = {policy.name for policy in default_policies()}
    assert names >= {*COMPARED, "ppo-random-energy"}


def test_a_spec_is_its_own_dict_and_back():
    for policy in [*suite_policies(), *default_policies()]:
        assert PolicySpec.from_dict(policy.to_dict()) == policy
    seeds = (FactorySpec.of("ptne_env.laws:Static", kappa=1.0), FactorySpec.of("ptne_env.laws:Static", kappa=2.0))
    several = PolicySpec("several", seeds)
    assert PolicySpec.from_dict(several.to_dict()) == several
    with pytest.raises(ValueError, match="was an object"):
        PolicySpec.from_dict(PolicySpec("mine", laws.Static).to_dict())
    with pytest.raises(ValueError, match="no training seed"):
        PolicySpec("none", ())


def test_patterns_match_policy_files_and_nothing_else(tmp_path):
    (tmp_path / "evil:make").touch()
    for read in (get_policy_spec, foreign_code):
        with pytest.raises(FileNotFoundError, match=r"there is no file '.*none-\*.onnx', which 'mine=.*' asks for"):
            read(f"mine={tmp_path}/none-*.onnx")
        with pytest.raises(ValueError, match="policy files end in .onnx or .zip"):
            read(f"mine={tmp_path}/*")


def test_a_path_with_an_equals_sign_is_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = shipped_path("ppo-random-energy").read_bytes()
    for folder in ("lr=0.1", "runs/lr=0.1", "runs/lr=0.2"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "policy.onnx").write_bytes(shipped)
    for path in ("lr=0.1/policy.onnx", "runs/lr=0.1/policy.onnx"):
        assert get_policy_spec(path).policy == FactorySpec.of("ptne_env.learn:load", path_or_name=path)
    assert len(get_policy_spec("mine=runs/lr=*/policy.onnx").training_seeds) == 2
    with pytest.raises(FileNotFoundError, match="runs/lr=0.3/policy.onnx"):
        get_policy_spec("runs/lr=0.3/policy.onnx")


@pytest.mark.parametrize("policy", [laws.Static, 5, None, FactorySpec.of("ptne_env.laws:Static")])
def test_an_object_that_is_no_spec_is_refused_with_the_way_to_wrap_it(policy):
    with pytest.raises(ValueError, match=r"a policy is a string or a PolicySpec, got .*PolicySpec\(name, policy\)"):
        evaluate([policy], ["energy"], episodes=1)


def test_foreign_code_of_a_string_is_listed_without_an_import(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("evil-1.zip", "evil-2.zip", "fine.onnx", "lr=1.zip"):
        (tmp_path / name).touch()
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')", encoding="utf-8")
    expected = {
        "evil:make": ["evil:make"],
        "ptne_env.shared.files:write_atomically": ["ptne_env.shared.files:write_atomically"],
        "mine=*.zip": ["evil-1.zip", "evil-2.zip", "lr=1.zip"],
        "mine=*.onnx": [],
        "evil-1.zip": ["evil-1.zip"],
        "lr=1.zip": ["lr=1.zip"],
        "static": [],
        "ppo-random-energy": [],
        "fine.onnx": [],
        "ptne_env.laws:Static": [],
        "no-such-policy": [],
    }
    assert {policy: foreign_code(policy) for policy in expected} == expected


def test_a_spec_lists_its_foreign_code():
    bad = FactorySpec.of("os:system", command="ls")
    archive = FactorySpec.of(ARCHIVE, path="model.zip")
    law = FactorySpec.of("ptne_env.laws:Static", kappa=bad)
    spec = PolicySpec("several", (REFERENCES[1].policy, archive, law), Interface("physical"))
    assert spec.foreign_code == ["model.zip", "os:system"]
    assert spec.is_foreign
    assert not any(policy.is_foreign for policy in suite_policies())
    assert not PolicySpec("mine", laws.Static).is_foreign


@pytest.mark.parametrize(
    "change",
    [
        {"training_seeds": 3},
        {"training_seeds": [{"target": 3, "arguments": {}}]},
        {"training_seeds": [3]},
        {"training_seeds": []},
        {"interface": {"kind": "scaled", "colour": "red"}},
        {"interface": None},
        {"scenarios": 7},
    ],
)
def test_data_of_another_form_are_no_policy(change):
    with pytest.raises(ValueError, match="policy|part|training seed"):
        PolicySpec.from_dict(PolicySpec("mine", FactorySpec.of("ptne_env.laws:Static")).to_dict() | change)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An untrained model, saved as Stable-Baselines3 does."""
    need_sb3()
    from stable_baselines3 import PPO

    from ptne_env.envs.sb3 import PlayerVecEnv

    path = tmp_path_factory.mktemp("archive") / "model.zip"
    env = PlayerVecEnv(BASE, 2, interface="scaled")
    PPO("MlpPolicy", env, n_steps=20, batch_size=20, device="cpu", seed=0).save(path)
    return str(path)


def test_an_archive_is_not_loaded_unless_it_is_trusted(archive, tmp_path):
    with pytest.raises(ValueError, match=r"executes code .* if you trust it: .*get_policy_spec\('.*', trust=True\)"):
        run_suite(SMALL, [archive], folder=tmp_path)
    assert not (tmp_path / "jobs").exists()


def test_an_archive_acts_as_its_model_does(archive):
    from stable_baselines3 import PPO

    policy = get_policy_spec(archive, trust=True)
    assert policy.interface == ptne_env.Interface("scaled")
    env = ptne_env.parallel_env(BASE, interface="scaled")
    observations, _ = env.reset(seed=0)
    rows = np.stack(list(observations.values()))
    ours, _ = policy.build(env.layout).predict(rows, deterministic=True)
    theirs, _ = PPO.load(archive, device="cpu").predict(rows, deterministic=True)
    np.testing.assert_array_equal(ours, theirs)
    results = run_suite(SMALL, [policy])
    assert ("ring", "model") in results.samples
    assert "observations of length 24" in results.not_applicable["complete", "model"]


@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("kind", ["physical", "local", "learner"])
def test_the_interface_of_an_archive_is_recognised_by_its_spaces(kind, mode, tmp_path):
    need_sb3()
    from stable_baselines3 import PPO

    from ptne_env.envs.sb3 import PlayerVecEnv
    from ptne_env.learn.archive import load_archive

    env = PlayerVecEnv(BASE, interface=kind, action_mode=mode)
    PPO("MlpPolicy", env, device="cpu").save(tmp_path / "model.zip")
    assert load_archive(str(tmp_path / "model.zip")).interface == ptne_env.Interface(kind, mode)


def test_files_that_are_no_archives_are_refused(tmp_path):
    need_sb3()
    (tmp_path / "bad.zip").write_bytes(b"no archive")
    with pytest.raises(ValueError, match="not an archive"):
        get_policy_spec(str(tmp_path / "bad.zip"), trust=True)


def test_a_missing_archive_and_a_scenario_are_no_policies():
    for trust in (False, True):
        with pytest.raises(FileNotFoundError, match="there is no file"):
            get_policy_spec("none.zip", trust=trust)
    with pytest.raises(ValueError, match="'energy' is a scenario, no policy"):
        get_policy_spec("energy")


def trained_model(interface):
    """The spaces of a model of Stable-Baselines3 that was trained with an interface, and actions of zeros."""
    layout = make_encoder(World(ptne_env.get_scenario("energy")), interface).layout
    return SimpleNamespace(
        observation_space=layout.observation_space(),
        action_space=layout.action_space(),
        predict=lambda rows, *_, **__: (np.zeros((len(rows), layout.action_size), np.float32), None),
    )


@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("kind", ["physical", "local", "learner"])
def test_the_interface_of_a_model_is_recognised_by_its_spaces(kind, mode):
    interface = Interface(kind, mode)
    assert PolicySpec("mine", trained_model(interface)).interface == interface


def test_a_model_with_another_interface_is_refused_with_advice():
    spec = PolicySpec("mine", trained_model(Interface("scaled")), Interface("physical"))
    with pytest.raises(ValueError, match=r"shape \(24,\).*'physical' has \(28,\).*PolicySpec\(name, model, "):
        evaluate(spec, ptne_env.get_scenario("energy", steps=120), episodes=1)
