"""Stable-Baselines3 as its users use it; what all adapters promise is in test_adapters.py."""

import numpy as np
import pytest
from extras import need_sb3

torch = need_sb3()

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize

from ptne_env import FactorySpec, PolicySpec, VectorParallelEnv, evaluate, get_scenario, laws
from ptne_env.envs.sb3 import TRUE_STATE, PlayerVecEnv
from ptne_env.evaluation import episode_seed
from ptne_env.world.world import World


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def random_actions(env, generator):
    bound = env.action_space.high
    return (bound * generator.uniform(-1.1, 1.1, (env.num_envs, *env.action_space.shape))).astype(np.float32)


def test_seed_counts_up_by_environment_and_holds_for_one_reset():
    env = PlayerVecEnv("random-energy", 3, seed=8)
    first, second = env.reset(), env.reset()
    assert not np.array_equal(first, second)
    assert env.seed(8) == [8] * 5 + [9] * 5 + [10] * 5
    assert np.array_equal(env.reset(), first)
    assert np.array_equal(env.reset(), second)
    env.seed(9)
    assert np.array_equal(env.reset()[:10], first[5:])
    drawn = env.seed()
    assert drawn == [drawn[0] + slot // 5 for slot in range(15)]
    assert env.seed()[0] != drawn[0]
    unseeded = [PlayerVecEnv("random-energy", 1).reset() for _ in range(2)]
    assert not np.array_equal(*unseeded)


def test_attributes_and_methods_are_those_of_the_environments():
    env = PlayerVecEnv("random-energy", 2, seed=0, max_cycles=9)
    env.reset()
    assert env.get_attr("scenario") == [get_scenario("random-energy")] * 10
    assert env.get_attr("num_players", indices=[0, 7]) == [5, 5]
    assert env.get_attr("render_mode", indices=3) == [None]
    assert env.has_attr("layout")
    assert not env.has_attr("colour")
    with pytest.raises(AttributeError, match="colour"):
        env.get_attr("colour")
    env.set_attr("colour", "red")
    assert env.get_attr("colour") == ["red"] * 10
    env.set_attr("colour", "blue", indices=range(10))
    assert env.get_attr("colour", indices=[4]) == ["blue"]
    with pytest.raises(ValueError, match="set for all of them or none"):
        env.set_attr("colour", "green", indices=[0, 1])
    assert env.get_attr("colour", indices=[0]) == ["blue"]
    answers = env.env_method("reset", seed=5, indices=[2, 3])
    assert len(answers) == 2
    assert np.array_equal(answers[0][0], VectorParallelEnv("random-energy", 2).reset(seed=5)[0])
    assert env.env_is_wrapped(Monitor) == [True] * 10
    assert env.env_is_wrapped(VecNormalize, indices=[1, 2]) == [False] * 2
    env.close()


def test_evaluate_policy_takes_a_law_and_returns_its_digits_gained():
    episodes, seed = 3, 6
    env = PlayerVecEnv("random-energy", episodes, seed=episode_seed(seed, 0), interface="physical")
    # Members fill whole episodes: one episode for each of the 3 · 5 members is each player's share of 3 episodes.
    mean, _ = evaluate_policy(laws.Static(env.layout), env, n_eval_episodes=episodes * 5)
    results = evaluate([PolicySpec("law", laws.Static)], [get_scenario("random-energy")], episodes=episodes, seed=seed)
    assert mean == pytest.approx(results.record("random-energy", "law", "digits_gained")["mean"], abs=1e-4)


def test_members_report_episodes_and_rewards_to_the_wrappers_of_sb3():
    plain, env = (PlayerVecEnv("random-energy", 2, seed=1, max_cycles=5) for _ in range(2))
    normal = VecNormalize(env, gamma=0.9)
    plain.reset(), normal.reset()
    total = np.zeros(10)
    for _ in range(5):
        actions = random_actions(plain, np.random.default_rng(0))
        _, rewards, _, infos = plain.step(actions)
        total += rewards
        normal.step(actions)
        assert np.array_equal(normal.get_original_reward(), rewards)
    assert [info["episode"]["l"] for info in infos] == [5] * 10
    assert [info["episode"]["r"] for info in infos] == pytest.approx(total, rel=1e-6)


def start_at(distance):
    """Everybody's estimates so far from the equilibrium, relatively, in the scenario ``energy``."""
    equilibrium = World(get_scenario("energy")).game.nash_equilibrium
    shift = distance * np.linalg.norm(equilibrium) / np.sqrt(5)
    return FactorySpec.of("ptne_env.world.starts:FixedStart", estimates=np.tile(equilibrium + shift, (5, 1)).tolist())


@pytest.mark.parametrize(("distance", "success"), [(0.004, True), (0.006, False)])
def test_eval_callback_reads_success(distance, success, tmp_path):
    still = {"steps": 3, "input_limit": 1e-6, "interface": "physical"}
    env = PlayerVecEnv("energy", 2, start=start_at(distance), **still)
    callback = EvalCallback(env, n_eval_episodes=20, eval_freq=8, log_path=str(tmp_path), verbose=0)
    model = PPO("MlpPolicy", PlayerVecEnv("energy", 1, **still), n_steps=8, batch_size=40, n_epochs=1)
    model.learn(40, callback=callback)
    assert callback.evaluations_successes == [[success] * 20]
    assert callback.evaluations_length == [[3] * 20]


def parameters_of(model):
    return np.concatenate([parameter.detach().numpy().ravel() for parameter in model.policy.parameters()])


TRAINERS = {
    "PPO": lambda env: PPO("MlpPolicy", env, n_steps=40, batch_size=40, n_epochs=2, seed=0),
    "SAC": lambda env: SAC("MlpPolicy", env, learning_starts=50, batch_size=16, buffer_size=400, train_freq=8, seed=0),
}


@pytest.mark.parametrize("algorithm", TRAINERS)
def test_algorithms_learn_without_a_warning_and_reproducibly(algorithm):
    trained = []
    for _ in range(2):
        env = PlayerVecEnv("random-energy", 2, steps=25)
        model = TRAINERS[algorithm](env)
        before = parameters_of(model)
        model.learn(400)
        assert model.num_timesteps == 400
        assert [episode["l"] for episode in model.ep_info_buffer] == [25] * 10
        trained.append(parameters_of(model))
        assert np.isfinite(trained[-1]).all()
        assert not np.array_equal(before, trained[-1])
    assert np.array_equal(*trained)


def test_options_start_the_next_episodes_and_unknown_ones_are_refused():
    env, expected = PlayerVecEnv("energy", 2, seed=3), VectorParallelEnv("energy", 2)
    tables = np.arange(50.0).reshape(2, 5, 5)
    for table in (tables[0], tables):
        env.set_options({"estimates": table})
        assert np.array_equal(env.reset(), expected.reset(estimates=table)[0].reshape(10, -1))
    assert not np.array_equal(env.reset(), expected.reset(estimates=tables)[0].reshape(10, -1))
    with pytest.raises(ValueError, match="unknown reset option 'estimate'; choose from estimates"):
        env.set_options({"estimate": tables})
    with pytest.raises(TypeError, match="reset options are a dictionary"):
        env.set_options([{"estimates": tables[0]}] * 10)


def test_members_show_the_true_state_of_their_environment_in_arrays_of_their_own():
    env = PlayerVecEnv("random-energy", 2, seed=3)
    env.reset()
    for name in TRUE_STATE:
        rows = env.get_attr(name)
        assert len(rows) == 10
        assert all(np.array_equal(row, getattr(env.vector, name)[member // 5]) for member, row in enumerate(rows))
    first, second = env.get_attr("estimates", [0, 1])
    first[...] = 0
    assert second.any()
    saved = env.env_method("get_state", indices=0)[0]
    env.step(np.ones((10, 5), dtype=np.float32))
    env.env_method("set_state", saved)
    assert np.array_equal(env.vector.estimates, saved.estimates.T)
