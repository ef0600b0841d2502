"""Policies by name, file, address and pattern."""

import numpy as np
import pytest
from extras import need_sb3
from small_suite import BASE, SMALL

import ptne_env
from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.experiments import COMPARED, default_policies, get_policy_spec, run_suite, suite_policies
from ptne_env.policies import PolicyFileError


def test_the_default_policies_leave_out_those_trained_on_no_scenario_of_the_catalogue():
    names = {policy.name for policy in default_policies()}
    assert names >= {*COMPARED, "ppo-random-energy", "ppo-ptne-v1-generalist"}
    assert not names & {"ppo-ptne-v1-noise", "ppo-ptne-v1-markov", "ppo-ptne-v1-unseen-graphs"}


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


def test_a_pattern_without_files_is_refused(tmp_path):
    with pytest.raises(ValueError, match="pattern that matches files"):
        get_policy_spec(f"mine={tmp_path}/none-*.onnx")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An untrained model, saved as Stable-Baselines3 does."""
    need_sb3()
    from stable_baselines3 import PPO

    from ptne_env.envs.sb3 import PlayerVecEnv

    path = tmp_path_factory.mktemp("archive") / "model.zip"
    env = PlayerVecEnv(BASE, 2, interface="local")
    PPO("MlpPolicy", env, n_steps=20, batch_size=20, device="cpu", seed=0).save(path)
    return str(path)


def test_an_archive_is_not_loaded_unless_it_is_trusted(archive, tmp_path):
    with pytest.raises(ValueError, match="executes code"):
        run_suite(SMALL, [archive], folder=tmp_path)
    assert not (tmp_path / "jobs").exists()


def test_an_archive_acts_as_its_model_does(archive):
    from stable_baselines3 import PPO

    policy = get_policy_spec(archive, trust=True)
    assert policy.interface == ptne_env.Interface("local")
    env = ptne_env.parallel_env(BASE, interface="local")
    observations, _ = env.reset(seed=0)
    rows = np.stack(list(observations.values()))
    ours, _ = policy.build(env.layout).predict(rows, deterministic=True)
    theirs, _ = PPO.load(archive, device="cpu").predict(rows, deterministic=True)
    np.testing.assert_array_equal(ours, theirs)
    results = run_suite(SMALL, [policy])
    assert ("ring", "model") in results.samples
    assert "observations of length 24" in results.not_applicable["complete", "model"]


def test_files_that_are_no_archives_are_refused(tmp_path):
    need_sb3()
    (tmp_path / "bad.zip").write_bytes(b"no archive")
    with pytest.raises(PolicyFileError, match="not an archive"):
        get_policy_spec(str(tmp_path / "bad.zip"), trust=True)
    with pytest.raises(FileNotFoundError, match="no file"):
        get_policy_spec(str(tmp_path / "none.zip"), trust=True)
