"""The joint view as Gymnasium's users meet it: by id, alone, in a vector, under every autoreset mode."""

import copy
import warnings

import gymnasium
import numpy as np
import pytest
from extras import need_sb3
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from test_parallel import arrays_in, same
from worlds import BLOCKS, make_env

import ptne_env
from ptne_env import CATALOGUE, laws
from ptne_env.envs.gymnasium import JointEnv, JointVectorEnv, PlayerVectorEnv
from ptne_env.envs.registration import register_environments
from ptne_env.world.world import World

BATCH = 4
MODES = {"NEXT_STEP": AutoresetMode.NEXT_STEP, "SAME_STEP": AutoresetMode.SAME_STEP, "DISABLED": AutoresetMode.DISABLED}


# --- one environment --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CATALOGUE)
def test_make_finds_every_scenario_by_module_and_id(name):
    env = gymnasium.make(f"ptne_env:ptne/{name}-joint-v0", hold_steps=3, interface="scaled", reward="tracking")
    assert isinstance(env.unwrapped, JointEnv)
    assert env.unwrapped.parallel.scenario == ptne_env.get_scenario(name, hold_steps=3)
    assert env.unwrapped.layout.interface == ptne_env.Interface("scaled")
    assert env.spec.id == f"ptne/{name}-joint-v0"
    game = World(env.unwrapped.parallel.scenario).game
    assert env.observation_space.shape == (game.num_players * env.unwrapped.layout.size,)
    assert env.action_space.shape == (game.num_players * game.dimension,)


@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("name", ["energy", "energy-switching", "random-energy-switching-transformed"])
def test_checkers_of_gymnasium_and_sb3_pass_without_a_warning(name, mode):
    env = gymnasium.make(f"ptne_env:ptne/{name}-joint-v0", interface="scaled", action_mode=mode, steps=150)
    check_env(env.unwrapped)  # a warning would be an error
    check_env_of_sb3(env.unwrapped)


def check_env_of_sb3(env):
    need_sb3("stable_baselines3.common.env_checker").check_env(env)


@pytest.mark.parametrize("check", [check_env, check_env_of_sb3])
def test_checkers_warn_only_about_the_action_space_of_physical(check):
    env = gymnasium.make("ptne_env:ptne/energy-joint-v0")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        check(env.unwrapped)
    assert len(told) == 1
    assert "recommend" in str(told[0].message)
    assert "symmetric and normalized" in str(told[0].message)


def test_registration_is_idempotent():
    before = dict(gymnasium.registry)
    register_environments()
    assert dict(gymnasium.registry) == before
    assert {name for name in before if name.startswith("ptne/")} == {f"ptne/{name}-joint-v0" for name in CATALOGUE}


def test_players_parts_follow_each_other_and_rewards_are_averaged():
    env, parallel = JointEnv(BLOCKS), make_env(BLOCKS)
    first, _ = env.reset(seed=4)
    observations, _ = parallel.reset(seed=4)
    size, players = parallel.layout.size, ["player_0", "player_1", "player_2"]
    assert np.array_equal(first.reshape(3, size), np.stack([observations[agent] for agent in players]))
    action = np.random.default_rng(0).uniform(-1100, 1100, 18).astype(np.float32)
    observation, reward, _, _, info = env.step(action)
    observations, rewards, _, _, infos = parallel.step(dict(zip(players, action.reshape(3, 6), strict=True)))
    assert np.array_equal(observation.reshape(3, size), np.stack([observations[agent] for agent in players]))
    assert reward == pytest.approx(np.mean([rewards[agent] for agent in players]), rel=1e-15)
    assert info["clipped"] == sum(infos[agent]["clipped"] for agent in players) > 0
    assert info["reward_digits"] == reward
    assert type(reward) is float


def test_options_reach_the_environment():
    env = JointEnv("energy")
    env.reset(options={"estimates": np.full((5, 5), 3.0)})
    assert np.all(env.parallel.estimates == 3)


@pytest.mark.parametrize(("max_cycles", "length", "ended"), [(None, 6, (True, False)), (4, 4, (False, True))])
def test_the_end_is_termination_and_a_cut_is_truncation(max_cycles, length, ended):
    env = JointEnv("energy", steps=6, max_cycles=max_cycles)
    env.reset(seed=0)
    for k in range(length):
        _, _, *flags, info = env.step(np.zeros(25, dtype=np.float32))
        assert tuple(flags) == (ended if k == length - 1 else (False, False))
        assert info["is_success"].shape == ()
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        env.step(np.zeros(25, dtype=np.float32))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(24, dtype=np.float32), r"a joint action has the shape \(25,\), got \(24,\)"),
        (np.zeros((5, 5), dtype=np.float32), r"shape \(25,\), got \(5, 5\)"),
        (np.ma.zeros(25), "a joint action must be a plain array, got a masked array"),
        (np.zeros(25, dtype=np.bool_), "player_0 has the dtype bool; expected numbers, such as float32"),
        (np.array([0.0] * 13 + [np.nan] + [0.0] * 11), "action of player_2 is not finite"),
    ],
)
def test_bad_actions_are_refused_and_change_nothing(action, message):
    env, undisturbed = JointEnv("random-energy"), JointEnv("random-energy")
    good = np.ones(25, dtype=np.float32)
    for each in (env, undisturbed):
        each.reset(seed=0)
        each.step(good)
    with pytest.raises(ValueError, match=message):
        env.step(action)
    assert same(env.step(good), undisturbed.step(good))


def test_a_step_before_reset_asks_for_reset():
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step\(\)"):
        JointEnv("energy").step(np.zeros(25, dtype=np.float32))


def test_pictures_come_from_the_parallel_environment():
    env = gymnasium.make("ptne_env:ptne/energy-joint-v0", render_mode="rgb_array")
    parallel = make_env("energy", render_mode="rgb_array")
    for each in (env, parallel):
        each.reset(seed=0)
    assert np.array_equal(env.render(), parallel.render())
    env.close()
    parallel.close()


# --- the habits of Gymnasium -----------------------------------------------------------------------------------------


def test_infos_have_the_same_keys_and_dtypes_from_reset_to_end():
    env = gymnasium.make("ptne_env:ptne/random-energy-joint-v0", steps=3, reward={"digits": 1.0, "payoff": 1e-3})
    infos = [env.reset(seed=0)[1], *(env.step(np.zeros(25, dtype=np.float32))[4] for _ in range(3))]
    kinds = {"diverged": bool, "clipped": np.int64, "is_success": bool, "reward_digits": float, "reward_payoff": float}
    assert all({name: value.dtype for name, value in info.items()} == kinds for info in infos)
    assert all(value.shape == () for info in infos for value in info.values())


def test_a_time_limit_of_gymnasium_ends_with_success_or_without():
    env = gymnasium.wrappers.TimeLimit(JointEnv("energy"), 2)
    near = np.tile(env.unwrapped.nash_equilibrium, (5, 1))
    for shift, success in ((0.0, True), (1.0, False)):
        env.reset(options={"estimates": near + shift})
        for _ in range(2):
            *_, truncated, info = env.step(np.zeros(25, dtype=np.float32))
        assert truncated
        assert info["is_success"] == success


def test_an_assigned_generator_seeds_the_next_episodes():
    env = gymnasium.make("ptne_env:ptne/random-energy-joint-v0")
    starts = []
    for seed in (1, 1, 2):
        env.reset(seed=0)
        env.unwrapped.np_random = np.random.default_rng(seed)
        starts.append([env.reset()[0].tobytes() for _ in range(2)])
    assert starts[0] == starts[1]
    assert starts[0] != starts[2]
    assert starts[0][0] != starts[0][1]
    assert env.reset(seed=0)[0].tobytes() == JointEnv("random-energy").reset(seed=0)[0].tobytes()


def test_the_joint_environment_has_the_views_of_the_parallel_one():
    env = gymnasium.make("ptne_env:ptne/random-energy-joint-v0").unwrapped
    env.reset(seed=2)
    env.step(np.ones(25, dtype=np.float32))
    for name in ("strategies", "estimates", "nash_equilibrium", "time"):
        assert np.array_equal(getattr(env, name), getattr(env.parallel, name))
    assert np.array_equal(env.state(), env.parallel.state())


def test_integer_actions_are_the_same_as_floats():
    env, other = JointEnv("energy"), JointEnv("energy")
    for each in (env, other):
        each.reset(seed=0)
    assert same(env.step(np.arange(25)), other.step(np.arange(25, dtype=np.float32)))


@pytest.mark.parametrize("make", [JointEnv, JointVectorEnv, PlayerVectorEnv])
def test_a_shallow_copy_steps_on_its_own(make):
    env, undisturbed = make("random-energy"), make("random-energy")
    for each in (env, undisturbed):
        each.reset(seed=0)
    twin = copy.copy(env)
    actions = np.ones(env.action_space.shape, dtype=np.float32)
    expected = undisturbed.step(actions)
    assert same(twin.step(actions), expected)
    assert same(env.step(actions), expected)


def test_single_environments_in_a_vector_render():
    env = gymnasium.make_vec("ptne_env:ptne/energy-joint-v0", 2, vectorization_mode="sync", render_mode="rgb_array")
    env.reset(seed=0)
    assert [picture.shape[2] for picture in env.render()] == [3, 3]
    env.close()


# --- vectors ----------------------------------------------------------------------------------------------------------

CASES = {
    "ends together": {"steps": 5},
    "cut": {"steps": 60, "max_cycles": 6},
    "crashing": {"max_cycles": 9, "input_limit": 1e9, "action_scale": 1e9},
    "crashing, local": {"max_cycles": 9, "input_limit": 1e9, "action_scale": 1e9, "interface": "local"},
    "gains, mixture": {"steps": 7, "action_mode": "gains", "reward": {"digits": 1.0, "payoff": 1e-3, "regret": 0.1}},
}


def make_pair(mode, **arguments):
    """Ours by ``make_vec``, and Gymnasium's vector of single environments."""
    identifier = "ptne_env:ptne/random-energy-joint-v0"
    ours = gymnasium.make_vec(identifier, num_envs=BATCH, autoreset_mode=MODES[mode], **arguments)
    singles = [lambda: JointEnv("random-energy", **arguments)] * BATCH
    return ours, SyncVectorEnv(singles, autoreset_mode=MODES[mode])


def scripted_actions(env, case, steps):
    unit = np.random.default_rng(0).uniform(-1.1, 1.1, (steps, *env.action_space.shape))
    if case.startswith("crashing"):
        unit *= 1e-9
        unit[::4, 1] = 1.0  # the second environment leaves the range now and then
        unit[::7, 3] = 1.0
    return (env.single_action_space.high * unit).astype(np.float32)


def assert_same_infos(ours, theirs):
    """Equal masks, and equal values where the mask says that there is one."""
    names = {name for name in (*ours, *theirs) if not name.startswith("_")}
    for name in names:
        masks = [infos.get(f"_{name}", np.zeros(BATCH, dtype=np.bool_)) for infos in (ours, theirs)]
        np.testing.assert_array_equal(*masks, err_msg=name)
        if not masks[0].any():
            continue
        found, expected = ours[name], theirs[name]
        if isinstance(expected, dict):
            assert_same_infos(found, expected)
            continue
        assert found.dtype == expected.dtype, name
        for index in np.flatnonzero(masks[0]):
            np.testing.assert_array_equal(found[index], expected[index], err_msg=name)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("mode", MODES)
def test_vector_is_gymnasiums_own_vector_of_single_environments(mode, case):
    ours, theirs = make_pair(mode, **CASES[case])
    assert isinstance(ours.unwrapped, JointVectorEnv)
    for name in ("observation_space", "action_space", "single_observation_space", "single_action_space", "num_envs"):
        assert getattr(ours, name) == getattr(theirs, name)
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is MODES[mode]

    first, infos = ours.reset(seed=5)
    expected, expected_infos = theirs.reset(seed=5)
    np.testing.assert_array_equal(first, expected, strict=True)
    assert_same_infos(infos, expected_infos)
    ends = restarts = 0
    for actions in scripted_actions(ours, case, 40):
        step, expected = ours.step(actions), theirs.step(actions)
        for array, other in zip(step[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(array, other, strict=True)
        assert_same_infos(step[4], expected[4])
        over = step[2] | step[3]
        ends += over.sum()
        if mode == "DISABLED" and over.any():
            observations, infos = ours.reset(options={"reset_mask": over.copy()})
            expected, expected_infos = theirs.reset(options={"reset_mask": over.copy()})
            np.testing.assert_array_equal(observations, expected, strict=True)
            assert_same_infos(infos, expected_infos)
        restarts += 0 < over.sum() < BATCH
    assert ends >= 3 * BATCH
    if case.startswith("crashing"):
        assert restarts > 5  # some ended while others went on


def test_seeds_are_counted_up_or_taken_from_a_list():
    ours, theirs = make_pair("SAME_STEP")
    for seed in (7, [3, 1, 4, 1], [None, 2, None, 3]):
        observations, expected = (envs.reset(seed=seed)[0] for envs in (ours, theirs))
        rows = (
            [index for index, each in enumerate(seed) if each is not None] if isinstance(seed, list) else [0, 1, 2, 3]
        )
        assert np.array_equal(observations[rows], expected[rows])


def test_next_step_ignores_the_action_and_starts_with_reward_zero():
    env = JointVectorEnv("random-energy", 2, steps=2)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP  # Gymnasium's default
    env.reset(seed=0)
    env.step(np.ones((2, 25)))
    last, _, terminated, truncated, infos = env.step(np.ones((2, 25)))
    assert terminated.all()
    assert not truncated.any()
    assert infos["_is_success"].all()
    first, rewards, terminated, truncated, infos = env.step(np.full((2, 25), 5000.0))
    assert not np.array_equal(first, last)
    assert rewards.tolist() == [0, 0]
    assert not (terminated | truncated).any()
    assert not any(infos[name].any() for name in infos if not name.startswith("_"))
    clock = env.layout.select(first.reshape(2, 5, -1), "clock")
    assert not clock[..., 0].any()


def test_same_step_mode_returns_the_last_observation_and_info():
    env, plain = (JointVectorEnv("random-energy", 2, steps=2, autoreset_mode=mode) for mode in ("SameStep", "Disabled"))
    for each in (env, plain):
        each.reset(seed=0)
        _, *_, infos = each.step(np.ones((2, 25)))
        assert "final_obs" not in infos
    observations, rewards, terminated, _, infos = env.step(np.full((2, 25), 2000.0))
    last, expected, _, _, last_infos = plain.step(np.full((2, 25), 2000.0))
    assert terminated.all()
    assert np.array_equal(rewards, expected)
    assert infos["final_obs"].dtype == object
    assert np.array_equal(np.stack(infos["final_obs"]), last)
    assert same(infos["final_info"], last_infos)
    assert infos["final_info"]["clipped"].tolist() == [25, 25]
    assert infos["_final_obs"].all()
    assert infos["_final_info"].all()
    assert not any(infos[name].any() for name in ("clipped", "is_success", "reward_digits"))
    assert not np.array_equal(observations, last)
    assert np.array_equal(observations, plain.reset()[0])


def test_disabled_waits_for_a_reset_mask():
    env = JointVectorEnv("random-energy", 3, autoreset_mode="Disabled", input_limit=1e9)
    env.reset(seed=0)
    actions = np.zeros((3, 25))
    actions[1] = 1e9
    before, _, terminated, _, _ = env.step(actions)
    assert terminated.tolist() == [False, True, False]
    with pytest.raises(RuntimeError, match=r"1 of 3 environments are over .*\(the first is 1\)"):
        env.step(np.zeros((3, 25)))
    observations, _ = env.reset(options={"reset_mask": terminated})
    assert np.array_equal(observations[~terminated], before[~terminated])
    assert not np.array_equal(observations[1], before[1])
    env.step(np.zeros((3, 25)))


@pytest.mark.parametrize("mode", MODES)
def test_a_reset_mask_restarts_running_episodes_in_every_mode(mode):
    ours, theirs = make_pair(mode, steps=6)
    for envs in (ours, theirs):
        envs.reset(seed=1)
    actions = scripted_actions(ours, "", 12)
    for k in range(12):
        step, expected = ours.step(actions[k]), theirs.step(actions[k])
        assert all(np.array_equal(a, b) for a, b in zip(step[:4], expected[:4], strict=True)), k
        over = step[2] | step[3]
        mask = np.array([True, False, k % 2 == 0, False]) if k in (1, 2) else over
        if (mode == "DISABLED" and mask.any()) or k in (1, 2):
            found, wanted = (envs.reset(options={"reset_mask": mask.copy()})[0] for envs in (ours, theirs))
            assert np.array_equal(found, wanted)


@pytest.mark.parametrize("mode", MODES)
def test_returned_arrays_never_change_later(mode):
    env = JointVectorEnv("random-energy", 3, autoreset_mode=MODES[mode], steps=4)
    record = [env.reset(seed=0)]
    kept = copy.deepcopy(record)
    generator = np.random.default_rng(0)
    for _ in range(11):
        step = env.step(generator.uniform(-1, 1, (3, 25)))
        record.append(step)
        kept.append(copy.deepcopy(step))
        if mode == "DISABLED" and (step[2] | step[3]).any():
            record.append(env.reset(options={"reset_mask": step[2] | step[3]}))
            kept.append(copy.deepcopy(record[-1]))
    for found, expected in zip(record, kept, strict=True):
        assert all(
            np.array_equal(a, b)
            for a, b in zip(arrays_in(found), arrays_in(expected), strict=True)
            if a.dtype != object
        )
        for infos, before in ((found[-1], expected[-1]),):
            for array, other in zip(infos.get("final_obs", ()), before.get("final_obs", ()), strict=True):
                assert np.array_equal(array, other)


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_gymnasiums_statistics_give_the_digits_gained(mode):
    env = RecordEpisodeStatistics(JointVectorEnv("random-energy", 2, autoreset_mode=MODES[mode]))
    law = laws.Static(env.unwrapped.layout)
    observations, _ = env.reset(seed=[8, 9])
    parallel = make_env("random-energy")
    gained = []
    for seed in (8, 9):
        seen, _ = parallel.reset(seed=seed)
        total = 0.0
        while parallel.agents:
            agents = parallel.agents
            actions = law.predict(np.stack([seen[agent] for agent in agents]))[0]
            seen, rewards, *_ = parallel.step(dict(zip(agents, actions, strict=True)))
            total += np.mean(list(rewards.values()))
        gained.append(total)
    for _ in range(400):
        actions = law.predict(observations.reshape(10, -1))[0].reshape(2, -1)
        observations, _, _, _, infos = env.step(actions)
    episode = infos["episode"]
    assert episode["r"] == pytest.approx(gained, abs=1e-9)
    assert episode["l"].tolist() == [400, 400]
    assert min(gained) > 2


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 24)), r"joint actions have the shape \(2, 25\), got \(2, 24\)"),
        (np.zeros((25, 2)), r"shape \(2, 25\), got \(25, 2\)"),
        (np.zeros(50), r"shape \(2, 25\), got \(50,\)"),
        (np.zeros((2, 25), dtype=np.bool_), "got bool"),
        (np.full((2, 25), np.nan), "without NaN or infinity"),
        (np.ma.zeros((2, 25)), "joint actions must be a plain array, got a masked array"),
    ],
)
def test_bad_actions_of_a_vector_are_refused_and_change_nothing(actions, message):
    env, undisturbed = JointVectorEnv("random-energy", 2), JointVectorEnv("random-energy", 2)
    for each in (env, undisturbed):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert same(env.step(np.ones((2, 25))), undisturbed.step(np.ones((2, 25))))


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros(2, dtype=np.bool_), "must name at least one environment to reset"),
        (np.ones(3, dtype=np.bool_), r"a reset mask is 2 booleans, got bool of shape \(3,\)"),
        (np.ones(2, dtype=np.int64), "a reset mask is 2 booleans, got int64"),
    ],
)
def test_bad_masks_are_refused(mask, message):
    env = JointVectorEnv("random-energy", 2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.reset(options={"reset_mask": mask})


def test_invalid_vectors_are_refused():
    with pytest.raises(ValueError, match="'Sometimes' is not a valid AutoresetMode"):
        JointVectorEnv("energy", 2, autoreset_mode="Sometimes")
    with pytest.raises(ValueError, match=r"do not render, got render_mode='rgb_array': .*vectorization_mode='sync'"):
        gymnasium.make_vec("ptne_env:ptne/energy-joint-v0", num_envs=2, render_mode="rgb_array")


def test_given_estimates_start_all_or_only_the_masked_environments():
    env = JointVectorEnv("energy", 3, autoreset_mode="Disabled")
    env.reset(seed=0, options={"estimates": np.full((5, 5), 3.0)})
    one = JointEnv("energy")
    expected, _ = one.reset(seed=0, options={"estimates": np.full((5, 5), 3.0)})
    table = np.arange(75.0).reshape(3, 5, 5)
    observations, _ = env.reset(options={"estimates": table, "reset_mask": np.array([False, True, False])})
    assert np.array_equal(observations[0], expected)
    assert np.array_equal(observations[2], expected)
    expected, _ = one.reset(options={"estimates": table[1]})
    assert np.array_equal(observations[1], expected)


@pytest.mark.parametrize("table", [np.zeros((5, 4)), np.full((5, 5), np.nan), [["a"] * 5] * 5])
def test_wrong_estimates_are_refused_before_anything_starts(table):
    env = JointVectorEnv("energy", 2)
    observations, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match="initial estimates"):
        env.reset(seed=1, options={"estimates": table})
    actions = np.zeros(env.action_space.shape, dtype=np.float32)
    twin = JointVectorEnv("energy", 2)
    twin.reset(seed=0)
    assert np.array_equal(env.step(actions)[0], twin.step(actions)[0])
    assert observations.shape == env.observation_space.shape


# --- players as members -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_members_are_the_players_of_the_joint_vector(case):
    members = PlayerVectorEnv("random-energy", BATCH, **CASES[case])
    joint = JointVectorEnv("random-energy", BATCH, **CASES[case])
    count = 5 * BATCH
    assert members.num_envs == count
    assert members.observation_space.shape == (count, members.layout.size)
    assert members.single_action_space == joint.vector.single_action_space
    assert members.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, infos = members.reset(seed=5)
    np.testing.assert_array_equal(observations, joint.reset(seed=5)[0].reshape(count, -1), strict=True)
    assert all(infos[f"_{name}"].all() for name in infos if not name.startswith("_"))
    kinds = {name: (values.shape, values.dtype) for name, values in infos.items()}
    ends = 0
    for actions in scripted_actions(joint, case, 40):
        observations, rewards, *flags, infos = members.step(actions.reshape(count, -1))
        expected, means, *expected_flags, expected_infos = joint.step(actions)
        np.testing.assert_array_equal(observations, expected.reshape(count, -1), strict=True)
        np.testing.assert_allclose(rewards.reshape(BATCH, 5).mean(axis=1), means, rtol=1e-12, atol=1e-300)
        for flag, expected_flag in zip(flags, expected_flags, strict=True):
            np.testing.assert_array_equal(flag, np.repeat(expected_flag, 5), strict=True)
        over = flags[0] | flags[1]
        ends += over.any()
        assert {name: (values.shape, values.dtype) for name, values in infos.items()} == kinds
        for name in ("diverged", "is_success"):
            np.testing.assert_array_equal(infos[name], np.repeat(expected_infos[name], 5), strict=True)
    assert ends > 1


def test_a_second_reset_of_members_starts_all_episodes():
    members = PlayerVectorEnv("random-energy", 2, steps=5)
    actions = np.zeros(members.action_space.shape, dtype=np.float32)
    first, _ = members.reset(seed=[3, 8])
    for _ in range(5):
        members.step(actions)
    np.testing.assert_array_equal(members.reset(seed=[3, 8])[0], first)
    assert not np.array_equal(members.step(actions)[0], first)  # it moves, although episodes had ended before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda good: good[:9], r"actions of 10 members have the shape \(10, 5\), got \(9, 5\)"),
        (lambda good: good > 0, "actions are numbers of shape"),
        (lambda good: good * np.nan, "without NaN or infinity"),
        (np.ma.masked_array, "actions must be a plain array"),
    ],
)
def test_bad_actions_of_members_are_refused_and_change_nothing(change, message):
    members, undisturbed = (PlayerVectorEnv("random-energy", 2) for _ in range(2))
    good = np.ones((10, 5), dtype=np.float32)
    for each in (members, undisturbed):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        members.step(change(good))
    assert same(members.step(good), undisturbed.step(good))
