"""Stable-Baselines3 as its users use it: vectors, wrappers, evaluation, callbacks, training."""

import copy

import numpy as np
import pytest
from extras import need_sb3

torch, supersuit = need_sb3(), need_sb3("supersuit")

from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from test_parallel import arrays_in, pickled, same
from worlds import BLOCKS, make_env

from ptne_env import FactorySpec, Interface, PolicySpec, VectorParallelEnv, evaluate, get_scenario, laws
from ptne_env.envs import vector as vector_module
from ptne_env.envs.gymnasium import JointEnv
from ptne_env.envs.sb3 import MixedPlayerVecEnv, PlayerVecEnv
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


# --- the vector -------------------------------------------------------------------------------------------------------


def test_members_are_the_players_environment_by_environment():
    slots, vector = PlayerVecEnv(BLOCKS, 4, seed=3), VectorParallelEnv(BLOCKS, 4, interface="scaled")
    assert slots.num_envs == 12
    assert slots.observation_space == vector.single_observation_space
    assert slots.action_space == vector.single_action_space
    assert slots.layout == vector.layout
    observations = slots.reset()
    assert np.array_equal(observations, vector.reset(seed=3).reshape(12, -1))
    players = slots.layout.select(observations, "player").argmax(axis=1)
    assert players.tolist() == [0, 1, 2] * 4
    actions = random_actions(slots, np.random.default_rng(0))
    _, rewards, _, _ = slots.step(actions)
    expected = vector.step(actions.reshape(4, 3, -1)).rewards
    assert rewards.dtype == np.float32
    assert np.array_equal(rewards, expected.reshape(12).astype(np.float32))


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


@pytest.mark.parametrize(
    ("arguments", "truncated"),
    [({"steps": 4}, False), ({"steps": 4, "max_cycles": 4}, False), ({"max_cycles": 4}, True)],
)
def test_the_end_returns_the_last_observation_and_its_kind(arguments, truncated):
    env, vector = (
        PlayerVecEnv("random-energy", 2, seed=1, **arguments),
        VectorParallelEnv("random-energy", 2, interface="scaled", **arguments),
    )
    env.reset()
    vector.reset(seed=1)
    generator = np.random.default_rng(0)
    for k in range(4):
        actions = random_actions(env, generator) * np.float32(1e-2)
        observations, _, dones, infos = env.step(actions)
        last = vector.step(actions.reshape(2, 5, 5)).observations.reshape(10, -1)
        assert dones.dtype == np.bool_
        assert dones.tolist() == [k == 3] * 10
        if k < 3:
            assert np.array_equal(observations, last)
            assert infos == [{}] * 10
    assert np.array_equal(observations, vector.reset().reshape(10, -1))
    assert np.array_equal(np.stack([info["terminal_observation"] for info in infos]), last)
    for info in infos:
        assert info["TimeLimit.truncated"] is truncated
        assert not info["is_success"]
        assert not info["diverged"]
        assert set(info) == {
            *("terminal_observation", "TimeLimit.truncated", "episode"),
            *("diverged", "clipped", "is_success", "reward_digits"),
        }
    assert len({id(info) for info in infos}) == 10


def test_entries_that_a_caller_writes_into_an_info_are_gone_in_the_next_step():
    env = PlayerVecEnv("energy", 2, seed=0)
    env.reset()
    actions = np.zeros((10, 5), dtype=np.float32)
    written = env.step(actions)[3]
    written[3]["note"] = 1
    following = env.step(actions)[3]
    assert (written[3], following) == ({"note": 1}, [{}] * 10)
    assert len({id(info) for info in following}) == 10


def test_divergence_of_one_environment_ends_only_its_members():
    env = PlayerVecEnv("random-energy", 3, interface="physical", seed=0, input_limit=1e9)
    env.reset()
    actions = np.zeros((15, 5), dtype=np.float32)
    actions[7] = 1e9  # the third player of the second environment
    observations, rewards, dones, infos = env.step(actions)
    assert dones.tolist() == [False] * 5 + [True] * 5 + [False] * 5
    assert all(info == {} for info in infos[:5] + infos[10:])
    assert all(info["diverged"] and not info["TimeLimit.truncated"] for info in infos[5:10])
    assert rewards[5:10].max() < 0
    assert not rewards[[*range(5), *range(10, 15)]].any()
    clock = env.layout.select(observations, "clock")[:, 0]
    assert np.array_equal(clock == 0, dones)


def test_returned_arrays_never_change_later():
    env = PlayerVecEnv("random-energy-switching", 3, seed=0, max_cycles=4)
    record = [env.reset()]
    kept = copy.deepcopy(record)
    generator = np.random.default_rng(0)
    for _ in range(10):
        step = env.step(random_actions(env, generator))
        record.append(step)
        kept.append(copy.deepcopy(step))
    assert same(record, kept)
    assert all(array.flags.c_contiguous for step in record for array in arrays_in(step))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
@pytest.mark.parametrize("make", [PlayerVecEnv, lambda name: MixedPlayerVecEnv([PlayerVecEnv(name)])])
def test_a_copy_steps_on_its_own(make, copied):
    env, undisturbed = make("energy"), make("energy")
    for each in (env, undisturbed):
        each.seed(0)
        each.reset()
    twin, actions = copied(env), np.ones((5, 5), dtype=np.float32)
    expected = undisturbed.step(actions)
    assert same(twin.step(actions), expected)
    assert same(env.step(actions), expected)
    assert twin.get_attr("scenario") == env.get_attr("scenario")


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
    assert np.array_equal(answers[0], VectorParallelEnv("random-energy", 2, interface="scaled").reset(seed=5))
    assert env.env_is_wrapped(Monitor) == [False] * 10
    assert env.env_is_wrapped(Monitor, indices=[1, 2]) == [False] * 2
    env.close()


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 5, 5)), r"actions of 10 members have the shape \(10, 5\), got \(2, 5, 5\)"),
        (np.zeros((5, 10)), r"have the shape \(10, 5\), got \(5, 10\)"),
        (np.zeros(50), r"have the shape \(10, 5\), got \(50,\)"),
        (np.zeros((10, 5), dtype=np.bool_), "got bool"),
        (np.full((10, 5), np.nan), "without NaN or infinity"),
        (np.ma.zeros((10, 5)), "actions must be a plain array, got a masked array"),
    ],
)
def test_bad_actions_are_refused_and_change_nothing(actions, message):
    env, undisturbed = (PlayerVecEnv("random-energy", 2, seed=0) for _ in range(2))
    for each in (env, undisturbed):
        each.reset()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    good = np.ones((10, 5), dtype=np.float32)
    assert same(env.step(good), undisturbed.step(good))


def test_a_step_before_reset_asks_for_reset():
    with pytest.raises(RuntimeError, match=r"call reset\(mask=...\) before step\(\)"):
        PlayerVecEnv("energy", 2).step(np.zeros((10, 5), dtype=np.float32))


def test_limit_of_an_episode_may_be_set_afterwards():
    env = PlayerVecEnv("random-energy", 2, seed=0)
    env.set_attr("max_cycles", 2)
    assert env.get_attr("max_cycles") == [2] * 10
    env.reset()
    actions = np.zeros((10, 5), dtype=np.float32)
    assert not env.step(actions)[2].any()
    assert env.step(actions)[2].all()


# --- several scenarios side by side -----------------------------------------------------------------------------------


def mixture():
    return [PlayerVecEnv(name, 2, max_cycles=3) for name in ("random-energy", "random-energy-switching")]


def test_a_mixture_lists_its_parts_in_order():
    together, apart = MixedPlayerVecEnv(mixture()), mixture()
    assert together.num_envs == 20
    together.seed(5)
    for part, seed in zip(apart, np.random.SeedSequence(5).generate_state(2).tolist(), strict=True):
        part.seed(seed)
    assert np.array_equal(together.reset(), np.concatenate([part.reset() for part in apart]))
    generator = np.random.default_rng(1)
    for _ in range(7):
        actions = random_actions(together, generator)
        observations, rewards, dones, infos = together.step(actions)
        expected = [part.step(own) for part, own in zip(apart, np.split(actions, 2), strict=True)]
        assert np.array_equal(observations, np.concatenate([outcome[0] for outcome in expected]))
        assert np.array_equal(rewards, np.concatenate([outcome[1] for outcome in expected]))
        assert np.array_equal(dones, np.concatenate([outcome[2] for outcome in expected]))
        assert [sorted(info) for info in infos] == [sorted(info) for part in expected for info in part[3]]


def test_attributes_of_a_mixture_are_those_of_its_parts():
    env = MixedPlayerVecEnv(mixture())
    names = [scenario.name for scenario in env.get_attr("scenario")]
    assert names == ["random-energy"] * 10 + ["random-energy-switching"] * 10
    assert [scenario.name for scenario in env.get_attr("scenario", [0, 15])] == [names[0], names[15]]
    assert env.env_is_wrapped(VecMonitor) == [False] * 20
    with pytest.raises(ValueError, match="all of them or none"):
        env.set_attr("render_mode", None, [0])


def test_mixture_of_scenarios_that_no_policy_can_share_is_refused():
    with pytest.raises(ValueError, match="layouts differ"):
        MixedPlayerVecEnv([PlayerVecEnv("random-energy", 1), PlayerVecEnv(BLOCKS, 1)])
    with pytest.raises(ValueError, match="at least one part"):
        MixedPlayerVecEnv([])


# --- SB3's wrappers ---------------------------------------------------------------------------------------------------


def episodes_of_slots(env, count, **arguments):
    """Return and length of every episode, slot by slot, from the vector environment itself."""
    vector = VectorParallelEnv("random-energy", 3, interface="scaled", **arguments)
    vector.reset(seed=2)
    generator = np.random.default_rng(0)
    total, length, found = np.zeros((3, 5)), np.zeros(3, dtype=int), []
    for _ in range(count):
        actions = random_actions(env, generator)
        outcome = vector.step(actions.reshape(3, 5, -1))
        total += outcome.rewards
        length += 1
        over = outcome.terminated | outcome.truncated
        for index in np.flatnonzero(over):
            found += [(total[index, player], length[index]) for player in range(5)]
        total[over], length[over] = 0, 0
        if over.any():
            vector.reset(mask=over)
    return found


@pytest.mark.parametrize("arguments", [{"steps": 7}, {"max_cycles": 9, "action_mode": "gains"}])
def test_the_monitor_reports_returns_and_lengths(arguments, tmp_path):
    env = VecMonitor(PlayerVecEnv("random-energy", 3, seed=2, **arguments), str(tmp_path / "log"), ("is_success",))
    env.reset()
    generator, told = np.random.default_rng(0), []
    for _ in range(30):
        _, _, _, infos = env.step(random_actions(env, generator))
        told += [info["episode"] for info in infos if "episode" in info]
    expected = episodes_of_slots(env, 30, **arguments)
    assert len(told) == len(expected) >= 30
    for episode, (total, length) in zip(told, expected, strict=True):
        assert episode["r"] == pytest.approx(total, rel=1e-5, abs=1e-4)
        assert episode["l"] == length
        assert not episode["is_success"]
    env.close()


def test_normalisation_changes_observations_only():
    plain = PlayerVecEnv("random-energy", 3, seed=2, max_cycles=5)
    env = VecNormalize(PlayerVecEnv("random-energy", 3, seed=2, max_cycles=5), gamma=0.9)
    env.reset()
    plain.reset()
    generator, ends = np.random.default_rng(0), 0
    for _ in range(40):
        actions = random_actions(env, generator)
        observations, rewards, dones, infos = env.step(actions)
        raw, raw_rewards, raw_dones, raw_infos = plain.step(actions)
        assert np.array_equal(env.get_original_obs(), raw)
        assert np.array_equal(env.get_original_reward(), raw_rewards)
        assert np.array_equal(dones, raw_dones)
        assert np.array_equal(observations, env.normalize_obs(raw))
        assert not np.array_equal(rewards, raw_rewards)
        for slot in np.flatnonzero(dones):
            ends += 1
            expected = env.normalize_obs(raw_infos[slot]["terminal_observation"])
            assert np.array_equal(infos[slot]["terminal_observation"], expected)
    assert ends == 8 * 15
    own = env.obs_rms.mean[env.venv.layout.slices["player"]]
    assert own == pytest.approx(np.full(5, 0.2), abs=1e-3)


@pytest.mark.parametrize(
    "make", [lambda: PlayerVecEnv("random-energy", 2, seed=1, steps=7), lambda: MixedPlayerVecEnv(mixture())]
)
def test_members_report_episodes_as_a_monitor_does(make):
    plain, monitored = make(), VecMonitor(make())
    for env in (plain, monitored):
        env.seed(1)
        env.reset()
    generators, ends = [np.random.default_rng(0) for _ in range(2)], 0
    for _ in range(20):
        infos, expected = (
            env.step(random_actions(env, each))[3] for env, each in zip((plain, monitored), generators, strict=True)
        )
        for info, other in zip(infos, expected, strict=True):
            assert info.keys() == other.keys()
            if "episode" in info:
                ends += 1
                assert {key: info["episode"][key] for key in "rl"} == {key: other["episode"][key] for key in "rl"}
    assert ends >= 20


def test_evaluation_without_another_monitor_brings_no_warning():
    env = PlayerVecEnv("energy", 1, steps=3)
    evaluate_policy(laws.Static(env.layout), env, n_eval_episodes=5)  # a warning would be an error
    model = A2C("MlpPolicy", PlayerVecEnv("energy", 1, steps=3), n_steps=3)
    model.learn(30)
    assert [episode["l"] for episode in model.ep_info_buffer] == [3] * 10


# --- evaluation -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrap", [VecMonitor, lambda env: env], ids=["monitored", "plain"])
@pytest.mark.parametrize("law", [laws.Static, laws.Adaptive, laws.Grounded])
@pytest.mark.parametrize(("name", "interface"), [("random-energy", "physical"), ("random-energy-switching", "local")])
def test_evaluate_policy_takes_a_law_and_returns_its_digits_gained(name, interface, law, wrap, monkeypatch):
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", 3)
    episodes, seed = 4, 6
    # Slots fill whole episodes: one episode for each of the 4 · 5 slots is each player's share of 4 episodes.
    env = PlayerVecEnv(name, episodes, seed=episode_seed(seed, 0), interface=interface)
    model = law(env.layout)
    mean, _ = evaluate_policy(model, wrap(env), n_eval_episodes=episodes * 5, warn=False)
    entry = PolicySpec("law", law, Interface(interface))
    results = evaluate([entry], [get_scenario(name)], episodes=episodes, seed=seed)
    expected = results.record(name, "law", "digits_gained")["mean"]
    assert mean == pytest.approx(expected, abs=1e-4)
    assert expected > 0.5


def test_the_memory_of_a_law_restarts_with_each_episode():
    env = PlayerVecEnv("energy", 2, interface="physical")
    rewards, lengths = evaluate_policy(
        laws.Adaptive(env.layout), VecMonitor(env), n_eval_episodes=3 * 10, return_episode_rewards=True
    )
    expected = evaluate(["adaptive"], [get_scenario("energy")]).record("energy", "adaptive", "digits_gained")["mean"]
    assert np.mean(rewards) == pytest.approx(expected, abs=1e-4)
    assert np.array_equal(rewards[:10], rewards[20:])
    assert lengths == [400] * 30


def start_at(distance):
    """Everybody's estimates so far from the equilibrium, relatively, in the scenario ``energy``."""
    equilibrium = World(get_scenario("energy")).game.nash_equilibrium
    shift = distance * np.linalg.norm(equilibrium) / np.sqrt(5)
    return FactorySpec.of("ptne_env.world.starts:FixedStart", estimates=np.tile(equilibrium + shift, (5, 1)).tolist())


@pytest.mark.parametrize(("distance", "success"), [(0.004, True), (0.006, False)])
def test_eval_callback_reads_success(distance, success, tmp_path):
    still = {"steps": 3, "input_limit": 1e-6}
    env = VecMonitor(PlayerVecEnv("energy", 2, start=start_at(distance), **still))
    callback = EvalCallback(env, n_eval_episodes=20, eval_freq=8, log_path=str(tmp_path), verbose=0)
    model = PPO("MlpPolicy", VecMonitor(PlayerVecEnv("energy", 1, **still)), n_steps=8, batch_size=40, n_epochs=1)
    model.learn(40, callback=callback)
    assert callback.evaluations_successes == [[success] * 20]
    assert callback.evaluations_length == [[3] * 20]


# --- training ---------------------------------------------------------------------------------------------------------


def parameters_of(model):
    return np.concatenate([parameter.detach().numpy().ravel() for parameter in model.policy.parameters()])


TRAINERS = {
    "PPO": lambda env: PPO("MlpPolicy", env, n_steps=40, batch_size=40, n_epochs=2, seed=0),
    "A2C": lambda env: A2C("MlpPolicy", env, n_steps=20, seed=0),
    "SAC": lambda env: SAC("MlpPolicy", env, learning_starts=50, batch_size=16, buffer_size=400, train_freq=8, seed=0),
}


@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("algorithm", TRAINERS)
def test_algorithms_learn_on_the_joint_environment_without_a_warning(algorithm, interface):
    env = JointEnv("random-energy", interface=interface, steps=25)
    model = TRAINERS[algorithm](env)
    before = parameters_of(model)
    model.learn(240)
    assert model.num_timesteps == 240
    assert [episode["l"] for episode in model.ep_info_buffer] == [25] * 9
    after = parameters_of(model)
    assert np.isfinite(after).all()
    assert not np.array_equal(before, after)
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation, deterministic=True)
    assert env.action_space.contains(action)


@pytest.mark.parametrize("algorithm", TRAINERS)
def test_algorithms_learn_without_a_warning_and_reproducibly(algorithm):
    trained = []
    for _ in range(2):
        env = VecMonitor(PlayerVecEnv("random-energy", 2, interface="scaled", steps=25))
        model = TRAINERS[algorithm](env)
        before = parameters_of(model)
        model.learn(400)
        assert model.num_timesteps == 400
        assert [episode["l"] for episode in model.ep_info_buffer] == [25] * 10
        trained.append(parameters_of(model))
        assert np.isfinite(trained[-1]).all()
        assert not np.array_equal(before, trained[-1])
    assert np.array_equal(*trained)


def test_only_truncated_episodes_are_bootstrapped():
    def run(**arguments):
        env = PlayerVecEnv("random-energy", 1, interface="scaled", **arguments)
        model = A2C("MlpPolicy", env, n_steps=3, gamma=0.5, learning_rate=0.0, seed=0)
        model.learn(15)
        return model, model.rollout_buffer.rewards

    (_, cut), (going_on, plain) = run(max_cycles=3), run()
    last, _ = going_on.policy.obs_to_tensor(going_on._last_obs)
    values = going_on.policy.predict_values(last).detach().numpy()[:, 0]
    assert np.array_equal(cut[:2], plain[:2])
    assert cut[2] == pytest.approx(plain[2] + 0.5 * values, abs=1e-6)
    assert np.abs(values).min() > 1e-3


# --- the way through SuperSuit ----------------------------------------------------------------------------------------


def through_supersuit(copies, **arguments):
    env = supersuit.pettingzoo_env_to_vec_env_v1(make_env("random-energy", **arguments))
    return supersuit.concat_vec_envs_v1(env, copies, num_cpus=1, base_class="stable_baselines3")


@pytest.mark.parametrize("interface", ["physical", "scaled"])
def test_supersuit_gives_the_same_steps(interface):
    arguments = {"interface": interface, "max_cycles": 6, "input_limit": 5.0}
    theirs, ours = through_supersuit(3, **arguments), PlayerVecEnv("random-energy", 3, seed=4, **arguments)
    assert theirs.num_envs == ours.num_envs
    assert (theirs.observation_space, theirs.action_space) == (ours.observation_space, ours.action_space)
    first, _ = theirs.venv.reset(seed=4)  # SuperSuit's wrapper has no seed() of its own
    assert np.array_equal(first, ours.reset())
    generator = np.random.default_rng(0)
    for _ in range(20):
        actions = random_actions(ours, generator)
        observations, rewards, dones, infos = theirs.step(actions)
        expected, expected_rewards, expected_dones, expected_infos = ours.step(actions)
        assert np.array_equal(observations, expected)
        assert np.array_equal(rewards, expected_rewards)
        assert np.array_equal(dones, expected_dones)
        for slot in np.flatnonzero(dones):
            assert infos[slot]["is_success"] == expected_infos[slot]["is_success"]
            assert np.array_equal(infos[slot]["terminal_observation"], expected_infos[slot]["terminal_observation"])


def test_an_algorithm_learns_through_supersuit():
    env = through_supersuit(2, interface="scaled", steps=25)
    with pytest.warns(UserWarning, match="The `render_mode` attribute is not defined"):  # SuperSuit's wrapper lacks it
        model = PPO("MlpPolicy", VecMonitor(env), n_steps=40, batch_size=40, n_epochs=1)
    before = parameters_of(model)
    model.learn(400)
    assert [episode["l"] for episode in model.ep_info_buffer] == [25] * 10
    assert not np.array_equal(before, parameters_of(model))
