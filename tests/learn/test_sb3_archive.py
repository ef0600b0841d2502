"""Models of Stable-Baselines3: what an archive plays, and the statistics of its normalisation."""

import numpy as np
import pytest
from extras import need_sb3
from small_suite import BASE

import ptne_env
from ptne_env import Interface, PolicySpec
from ptne_env.evaluation import EpisodeSet, Track, get_policy_spec
from ptne_env.evaluation.comparison import Job
from ptne_env.execution.runner import content_of
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.parts import is_part

need_sb3()

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

from ptne_env.envs.sb3 import PlayerVecEnv


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An untrained model, saved as Stable-Baselines3 does."""
    path = tmp_path_factory.mktemp("archive") / "model.zip"
    PPO("MlpPolicy", PlayerVecEnv(BASE, 2), n_steps=20, batch_size=20, device="cpu", seed=0).save(path)
    return str(path)


def test_an_archive_acts_as_its_model_does_once_it_is_trusted(archive):
    with pytest.raises(ValueError, match=r"executes code .* if you trust it, say trust=True \(--trust"):
        get_policy_spec(archive)
    with pytest.raises(ValueError, match="trust must be True or False, got 'no'"):
        get_policy_spec(archive, trust="no")
    policy = get_policy_spec(archive, trust=True)
    assert policy.interface == Interface("scaled")
    assert policy.is_own
    assert not is_part(policy.policy.target)
    job = Job(Track("ring", BASE, "The base."), policy, 0, EpisodeSet(1))
    assert {"stable_baselines3", "torch"} < content_of(job)["versions"].keys()
    env = ptne_env.parallel_env(BASE)
    observations, _ = env.reset(seed=0)
    rows = np.stack(list(observations.values()))
    ours, _ = policy.build(env.layout).predict(rows, deterministic=True)
    theirs, _ = PPO.load(archive, device="cpu").predict(rows, deterministic=True)
    np.testing.assert_array_equal(ours, theirs)


def test_a_model_is_played_with_the_statistics_of_its_normalisation_or_refused(tmp_path):
    env = VecNormalize(PlayerVecEnv(BASE, 2, seed=0))
    model = PPO("MlpPolicy", env, n_steps=20, batch_size=20, n_epochs=1, device="cpu", seed=0).learn(200)
    layout = ptne_env.parallel_env(BASE).layout
    rows = env.get_original_obs()
    actions, _ = PolicySpec("mine", model).build(layout).predict(rows, deterministic=True)
    expected, _ = model.predict(env.normalize_obs(rows), deterministic=True)
    np.testing.assert_allclose(actions, expected, rtol=1e-5, atol=1e-7)
    assert np.abs(actions - model.predict(rows, deterministic=True)[0]).max() > 0.01

    path, statistics = str(tmp_path / "model.zip"), str(tmp_path / "statistics.pkl")
    model.save(path)
    env.save(statistics)
    for make in (lambda: get_policy_spec(path, trust=True), lambda: PolicySpec("mine", PPO.load(path)).build(layout)):
        with pytest.raises(LayoutError, match=r"such as VecNormalize.*env=VecNormalize\.load\("):
            make()
    loaded = PPO.load(path, env=VecNormalize.load(statistics, PlayerVecEnv(BASE)))
    again, _ = PolicySpec("mine", loaded).build(layout).predict(rows, deterministic=True)
    np.testing.assert_array_equal(again, actions)

    stacked = PPO("MlpPolicy", VecFrameStack(PlayerVecEnv(BASE, 2), 2), n_steps=20, batch_size=20, device="cpu")
    stacked.save(path)
    for spec in (PolicySpec("mine", stacked), get_policy_spec(path, trust=True)):
        with pytest.raises(LayoutError, match=r"on several observations at once.*of several steps \(VecFrameStack\)"):
            spec.build(layout)
