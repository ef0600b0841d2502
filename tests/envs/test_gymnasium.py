"""The joint view as Gymnasium's users meet it: by id, alone, in a vector, under every autoreset mode."""

import gymnasium
import networkx as nx
import numpy as np
import pytest
from extras import need_matplotlib, need_sb3
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from worlds import BLOCKS, make_env

import ptne_env
from ptne_env import CATALOGUE, Interface, get_scenario
from ptne_env.envs.gymnasium import JointEnv, JointVectorEnv
from ptne_env.games import RandomEnergy
from ptne_env.world.channels import Loss
from ptne_env.world.world import World

BATCH = 4

MODES = {"NEXT_STEP": AutoresetMode.NEXT_STEP, "SAME_STEP": AutoresetMode.SAME_STEP, "DISABLED": AutoresetMode.DISABLED}


class Quiet(Loss):
    """A part of one's own."""


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
@pytest.mark.parametrize(
    "arguments",
    [
        {"channel": Quiet(0.5), "topology": nx.cycle_graph(5), "start": "random"},
        {"topology": nx.to_numpy_array(nx.star_graph(4)), "game": RandomEnergy(players=5), "steps": 30},
        {"scenario": get_scenario("random-energy", steps=30), "interface": Interface("physical"), "players": 6},
        {"interface": Interface("scaled", fields=("own_gradient", "clock"))},
    ],
)
def test_a_spec_in_json_makes_the_environment_again(make, arguments):
    env = make("ptne_env:ptne/energy-joint-v0", **arguments)
    again = make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario
    assert again.unwrapped.layout == env.unwrapped.layout


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


@pytest.mark.parametrize("name", ["energy", "random-energy-switching-transformed"])
def test_checkers_of_gymnasium_and_sb3_pass_without_a_warning(name):
    need_matplotlib()  # they render
    env = gymnasium.make(f"ptne_env:ptne/{name}-joint-v0", steps=150)
    check_env(env.unwrapped)  # a warning would be an error
    check_env_of_sb3(env.unwrapped)


def check_env_of_sb3(env):
    need_sb3("stable_baselines3.common.env_checker").check_env(env)


def test_players_parts_follow_each_other_and_rewards_are_averaged():
    env, parallel = JointEnv(BLOCKS, interface="physical"), make_env(BLOCKS)
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


def test_infos_have_the_same_keys_and_dtypes_from_reset_to_end():
    env = gymnasium.make("ptne_env:ptne/random-energy-joint-v0", steps=3, reward={"digits": 1.0, "payoff": 1e-3})
    infos = [env.reset(seed=0)[1], *(env.step(np.zeros(25, dtype=np.float32))[4] for _ in range(3))]
    kinds = {"diverged": bool, "clipped": np.int64, "is_success": bool, "reward_digits": float, "reward_payoff": float}
    assert all({name: value.dtype for name, value in info.items()} == kinds for info in infos)
    assert all(value.shape == () for info in infos for value in info.values())


CASES = {
    "ends together": {"steps": 5},
    "cut": {"steps": 60, "max_cycles": 6},
    "crashing": {"max_cycles": 9, "input_limit": 1e9, "interface": "physical"},
    "mixture": {"steps": 7, "reward": {"digits": 1.0, "payoff": 1e-3, "regret": 0.1}},
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


def test_invalid_vectors_and_masks_are_refused():
    env = JointVectorEnv("random-energy", 2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="must name at least one environment to reset"):
        env.reset(options={"reset_mask": np.zeros(2, dtype=np.bool_)})
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


def test_the_true_state_is_that_of_the_wrapped_environment():
    env, envs = JointEnv("energy"), JointVectorEnv("energy", 2)
    env.reset(seed=0), envs.reset(seed=0)
    saved, together = env.get_state(), envs.get_state()
    env.step(env.action_space.sample()), envs.step(envs.action_space.sample())
    assert env.time > 0
    env.set_state(saved), envs.set_state(together)
    assert env.time == 0
    assert np.array_equal(env.estimates, envs.estimates[0])
    assert np.array_equal(env.strategies, envs.strategies[0])
    assert np.array_equal(env.nash_equilibrium, envs.nash_equilibria[1])
    assert np.array_equal(envs.time, [0.0, 0.0])
    assert np.array_equal(env.state(), env.parallel.state())
