import copy
import pickle

import numpy as np
import pytest
from extras import need_numba
from test_parallel import arrays_in, same
from worlds import BLOCKS_SWITCHING, make_env

import ptne_env
from ptne_env import FactorySpec, VectorParallelEnv, get_scenario, laws
from ptne_env.envs import vector as vector_module
from ptne_env.envs.vector import VectorBuffers, VectorStep
from ptne_env.world import fused
from ptne_env.world.distances import estimate_distance
from ptne_env.world.world import World

SHORT = {"steps": 6, "start": "random", "input_limit": 5.0}


@pytest.fixture(params=[1024, 2], ids=["one block", "blocks of two"])
def block_size(request, monkeypatch):
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", request.param)
    return request.param


def make(name="random-energy", num_envs=5, **arguments):
    return VectorParallelEnv(name, num_envs, **{**SHORT, **arguments})


def random_actions(env, generator):
    bound = 1.2 * env.layout.action_bound
    shape = (env.num_envs, env.num_players, env.layout.action_size)
    return generator.uniform(-bound, bound, shape).astype(np.float32)


def go_on(env, steps, seed=1):
    """All that is returned in ``steps`` steps, with a reset after each end."""
    generator, record = np.random.default_rng(seed), []
    for _ in range(steps):
        outcome = env.step(random_actions(env, generator))
        record.append(tuple(outcome))
        over = outcome.terminated | outcome.truncated
        if over.any():
            record.append(env.reset(mask=over))
    return record


# --- what is returned -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("name", ["energy", "energy-switching-transformed", "random-energy", BLOCKS_SWITCHING])
def test_shapes_dtypes_and_memory_order_are_as_documented(name, interface, mode, block_size):
    env = make(name, steps=400, interface=interface, action_mode=mode, reward={"digits": 1.0, "payoff": 1e-3})
    batch, players, size = 5, env.num_players, env.layout.size
    observations = env.reset(seed=0)
    outcome = env.step(random_actions(env, np.random.default_rng(0)))
    assert type(outcome) is VectorStep
    expected = {
        "first observations": (observations, (batch, players, size), np.float32),
        "observations": (outcome.observations, (batch, players, size), np.float32),
        "rewards": (outcome.rewards, (batch, players), np.float64),
        "terminated": (outcome.terminated, (batch,), np.bool_),
        "truncated": (outcome.truncated, (batch,), np.bool_),
        "diverged": (outcome.infos["diverged"], (batch,), np.bool_),
        "is_success": (outcome.infos["is_success"], (batch,), np.bool_),
        "clipped": (outcome.infos["clipped"], (batch, players), np.int64),
        "digits": (outcome.infos["reward_digits"], (batch, players), np.float64),
        "payoff": (outcome.infos["reward_payoff"], (batch, players), np.float64),
    }
    assert list(outcome.infos) == ["diverged", "clipped", "is_success", "reward_digits", "reward_payoff"]
    for what, (array, shape, dtype) in expected.items():
        assert array.shape == shape, what
        assert array.dtype == dtype, what
        assert array.flags.c_contiguous, what
        assert array.flags.writeable, what
    assert env.single_observation_space.shape == (size,)
    assert env.single_action_space.shape == (env.layout.action_size,)
    assert all(env.single_observation_space.contains(row) for row in outcome.observations.reshape(-1, size))


@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("name", ["energy", "energy-switching-transformed", "random-energy"])
def test_returned_arrays_never_change_and_are_not_shared(name, interface, block_size):
    env = make(name, steps=400, max_cycles=7, interface=interface, reward={"digits": 1.0, "tracking": 0.1})
    record = [env.reset(seed=0)]
    kept = copy.deepcopy(record)
    generator = np.random.default_rng(0)
    for _ in range(20):
        outcome = env.step(random_actions(env, generator))
        record.append(tuple(outcome))
        kept.append(copy.deepcopy(tuple(outcome)))
        over = outcome.terminated | outcome.truncated
        if over.any():
            record.append(env.reset(mask=over))
            kept.append(record[-1].copy())
    assert same(record, kept)
    arrays = list(arrays_in(record))
    inside = [array for block in env._blocks for array in (block.state.estimates, block.state.diverged)]
    for index, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in [*arrays[index + 1 : index + 30], *inside])


def test_writing_into_returned_or_passed_arrays_changes_nothing(block_size):
    env, undisturbed = make(max_cycles=4), make(max_cycles=4)
    mask = np.ones(5, dtype=np.bool_)
    vandalised, record = env.reset(seed=0, mask=mask), undisturbed.reset(seed=0)
    mask[:] = False
    generators = [np.random.default_rng(0) for _ in range(2)]
    for _ in range(15):
        assert same(vandalised, record)
        for array in list(arrays_in(vandalised)):
            array[...] = 1
        actions = random_actions(env, generators[0])
        outcome = env.step(actions)
        actions[:] = 77
        record = tuple(undisturbed.step(random_actions(undisturbed, generators[1])))
        vandalised = tuple(outcome)
        over = record[2] | record[3]
        if over.any():
            assert same(vandalised, record)
            mask = over.copy()
            vandalised, record = env.reset(mask=mask), undisturbed.reset(mask=over)
            mask[:] = False


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_continues_identically_and_independently(duplicate, block_size):
    env = make("random-energy-switching-transformed", steps=400, max_cycles=9, interface="scaled")
    env.reset(seed=0)
    go_on(env, 5)
    twin = duplicate(env)
    assert same(go_on(env, 30, seed=2), go_on(twin, 30, seed=2))


# --- seeds, masks and restarts ----------------------------------------------------------------------------------------


def test_a_seed_is_counted_up_and_a_list_is_taken_as_it_is(block_size):
    env = make(num_envs=4)
    counted = env.reset(seed=20)
    assert np.array_equal(env.reset(seed=[20, 21, 22, 23]), counted)
    assert np.array_equal(env.reset(seed=np.int64(20)), counted)
    assert np.array_equal(env.reset(seed=np.arange(20, 24)), counted)
    assert np.array_equal(env.reset(seed=[23, 22, 21, 20]), counted[::-1])
    assert len({row.tobytes() for row in counted}) == 4
    alone = make_env("random-energy", **SHORT)
    for index in range(4):
        observations, _ = alone.reset(seed=20 + index)
        assert np.array_equal(np.stack(list(observations.values())), counted[index])


def test_without_a_seed_the_generators_continue(block_size):
    env, other = make(), make()
    first = env.reset(seed=1)
    second = env.reset()
    assert not np.any(np.all(first == second, axis=(1, 2)))
    other.reset(seed=1)
    assert np.array_equal(other.reset(), second)
    mixed = other.reset(seed=[1, None, None, 4, None])
    assert np.array_equal(mixed[[0, 3]], first[[0, 3]])
    assert np.array_equal(mixed[[1, 2, 4]], env.reset()[[1, 2, 4]])
    assert not np.array_equal(make().reset(), make().reset())


def test_a_mask_restarts_only_its_environments(block_size):
    env = make(steps=60)
    env.reset(seed=0)
    before = go_on(env, 3)[-1][0]
    mask = np.array([False, True, True, False, False])
    observations = env.reset(mask=mask)
    assert np.array_equal(observations[~mask], before[~mask])
    assert not np.any(np.all(observations[mask] == before[mask], axis=(1, 2)))
    clock = env.layout.select(observations, "clock")[:, 0, 0]
    assert np.array_equal(clock == 0, mask)
    seeded = env.reset(seed=[50, 51, 52, 53, 54], mask=mask)
    assert np.array_equal(seeded[mask], make(steps=60).reset(seed=50)[mask])
    assert np.array_equal(seeded[~mask], before[~mask])
    assert np.array_equal(env.reset(mask=[False] * 5), seeded)
    undisturbed = make(steps=60)
    undisturbed.reset(seed=0)
    assert np.array_equal(env.reset()[~mask], undisturbed.reset()[~mask])  # the seeds of others did not count


def test_masked_environments_continue_their_own_generators(block_size):
    env, all_together = make(), make()
    env.reset(seed=0)
    all_together.reset(seed=0)
    together = all_together.reset()
    for index in (3, 0, 4):
        observations = env.reset(mask=np.arange(5) == index)
        assert np.array_equal(observations[index], together[index])


@pytest.mark.parametrize("reward", ["digits", {"tracking": 1.0, "payoff": 1e-3}])
def test_restarting_within_a_step_is_a_reset_without_a_step(reward, block_size):
    env, by_hand = (make(steps=60, reward=reward) for _ in range(2))
    env.reset(seed=0)
    by_hand.reset(seed=0)
    generator = np.random.default_rng(0)
    for restart in np.array([[0, 1, 0, 0, 1], [0, 0, 0, 0, 0], [1, 1, 1, 1, 1], [0, 0, 1, 1, 0]], dtype=np.bool_):
        actions = random_actions(env, generator)
        kept = restart.copy()
        ours, theirs = env.step(actions, restart), by_hand.step(actions)
        observations = by_hand.reset(mask=restart)
        assert np.array_equal(restart, kept)
        assert np.array_equal(ours.observations, observations)
        assert np.array_equal(ours.rewards, np.where(restart[:, None], 0.0, theirs.rewards))
        for name in env.reward_names:
            assert np.array_equal(ours.infos[name], np.where(restart[:, None], 0.0, theirs.infos[name]))
        assert np.array_equal(ours.infos["clipped"], np.where(restart[:, None], 0, theirs.infos["clipped"]))
        assert theirs.infos["clipped"].any(axis=1).all()


def test_an_environment_that_is_over_may_restart_within_a_step(block_size):
    env = make(steps=3)
    env.reset(seed=0)
    for _ in range(3):
        outcome = env.step(np.zeros((5, 5, 5)))
    assert outcome.terminated.all()
    outcome = env.step(np.full((5, 5, 5), 9.0), np.ones(5, dtype=np.bool_))
    assert not (outcome.terminated | outcome.truncated | outcome.infos["is_success"]).any()
    assert not outcome.rewards.any()
    assert not outcome.infos["clipped"].any()
    clock = env.layout.select(outcome.observations, "clock")
    assert not clock[..., 0].any()
    env.step(np.zeros((5, 5, 5)))


# --- ends -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("max_cycles", "length", "terminates"), [(None, 8, True), (9, 8, True), (8, 8, True), (7, 7, False)]
)
def test_reaching_the_end_is_termination_and_an_earlier_cut_is_truncation(max_cycles, length, terminates, block_size):
    env = make(steps=6, hold_steps=2, max_cycles=max_cycles)
    env.reset(seed=0)
    for k in range(length):
        outcome = env.step(np.zeros((5, 5, 5)))
        last = k == length - 1
        assert outcome.terminated.tolist() == [last and terminates] * 5
        assert outcome.truncated.tolist() == [last and not terminates] * 5


def test_success_is_reported_per_environment_at_every_instant(block_size):
    env = make("random-energy", steps=400, s_end=8.0, hold_steps=100, input_limit=1000.0)
    law = laws.Grounded(env.layout, kappa=3.0)
    observations = env.reset(seed=0)
    still = np.arange(5) % 2 == 1
    for k in range(500):
        actions = law.predict(observations.reshape(25, -1))[0].reshape(5, 5, 5)
        actions[still] = 0
        outcome = env.step(actions)
        observations = outcome.observations
        distances = [estimate_distance(block.current.estimates, block.current.game) for block in env._blocks]
        near = np.concatenate(distances) <= 0.005
        assert outcome.infos["is_success"].tolist() == near.tolist()
        assert k < 450 or near.tolist() == (~still).tolist()


def test_a_diverged_environment_reports_no_success(block_size):
    at_rest = np.tile(World(get_scenario("energy")).game.nash_equilibrium, (5, 1)).tolist()
    start = FactorySpec.of("ptne_env.world.starts:FixedStart", estimates=at_rest)
    env = make("energy", num_envs=4, steps=5, start=start, input_limit=1e9)
    env.reset()
    actions = np.zeros((4, 5, 5))
    actions[1] = 1e9
    outcome = env.step(actions)
    assert outcome.terminated.tolist() == [False, True, False, False]
    assert outcome.infos["is_success"].tolist() == [True, False, True, True]
    env.reset(mask=outcome.terminated)
    assert env.first_infos()["is_success"].all()


def test_divergence_ends_one_environment_and_no_other(block_size):
    env, calm = (make(steps=60, input_limit=1e9) for _ in range(2))
    env.reset(seed=0)
    calm.reset(seed=0)
    actions = np.zeros((5, 5, 5))
    calm.step(actions)
    actions[2] = 1e9
    outcome = env.step(actions)
    crashed = np.arange(5) == 2
    assert np.array_equal(outcome.infos["diverged"], crashed)
    assert np.array_equal(outcome.terminated, crashed)
    assert not outcome.truncated.any()
    assert np.isfinite(outcome.observations).all()
    assert outcome.rewards[2].max() < 0
    assert not outcome.rewards[~crashed].any()
    observations = env.reset(mask=crashed)
    actions[2] = 0
    outcome = env.step(actions)
    assert not outcome.infos["diverged"].any()
    assert np.array_equal(outcome.observations[~crashed], calm.step(actions).observations[~crashed])
    assert not np.array_equal(outcome.observations[2], observations[2])


# --- errors -----------------------------------------------------------------------------------------------------------


def spoiled(value, index=3):
    actions = np.zeros((5, 5, 5), dtype=np.float32)
    actions[index, 4, 2] = value
    return actions


BAD_ACTIONS = {
    "NaN": (spoiled(np.nan), "without NaN or infinity"),
    "NaN in the first environment": (spoiled(np.nan, 0), "without NaN or infinity"),
    "infinite": (spoiled(np.inf, 4), "without NaN or infinity"),
    "masked": (np.ma.masked_array(spoiled(0.0), mask=True), "actions must be a plain array, got a masked array"),
    "one environment too few": (
        np.zeros((4, 5, 5)),
        r"actions are numbers of shape \(5, 5, 5\), got float64 of shape \(4",
    ),
    "flat": (np.zeros((25, 5)), r"of shape \(5, 5, 5\), got float64 of shape \(25, 5\)"),
    "one number": (0.0, r"of shape \(5, 5, 5\), got float64 of shape \(\)"),
    "booleans": (np.zeros((5, 5, 5), dtype=np.bool_), "got bool"),
    "nothing": (None, "got object"),
    "complex": (np.zeros((5, 5, 5), dtype=np.complex64), "got complex64"),
}


@pytest.mark.parametrize("name", BAD_ACTIONS)
def test_bad_actions_are_refused_and_no_environment_moves(name, block_size):
    actions, message = BAD_ACTIONS[name]
    env, undisturbed = make(steps=20, max_cycles=9), make(steps=20, max_cycles=9)
    for each in (env, undisturbed):
        each.reset(seed=0)
        go_on(each, 4)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert same(go_on(env, 15, seed=3), go_on(undisturbed, 15, seed=3))


BAD_RESETS = {
    "too few seeds": ({"seed": [1, 2, 3]}, "5 environments need as many seeds, got 3"),
    "a negative seed": ({"seed": [0, 1, 2, 3, -4]}, "a seed is a whole number of at least 0 or None, got -4"),
    "a negative first seed": ({"seed": -3}, "a seed is a whole number of at least 0 or None, got -3"),
    "a fractional seed": ({"seed": 1.5}, "a seed is a whole number of at least 0 or None, got 1.5"),
    "a fractional seed among others": ({"seed": [1, 2, 3, 4.5, 5]}, "a seed is a whole number.*got 4.5"),
    "bytes as seeds": ({"seed": b"12345"}, "seeds are a whole number or 5 of them, got bytes"),
    "a text as seeds": ({"seed": "12345"}, "seeds are a whole number or 5 of them, got str"),
    "a masked mask": (
        {"mask": np.ma.masked_array([True] * 5)},
        "a reset mask must be a plain array, got a masked array",
    ),
    "masked estimates": ({"estimates": np.ma.zeros((5, 5))}, "initial estimates must be a plain array"),
    "a short mask": ({"mask": np.ones(4, dtype=np.bool_)}, r"a reset mask is 5 booleans, got bool of shape \(4,\)"),
    "a mask of numbers": ({"mask": [0, 1, 0, 1, 1]}, r"a reset mask is 5 booleans, got int64 of shape \(5,\)"),
    "a mask of indices": ({"mask": np.array([1, 3])}, r"got int64 of shape \(2,\)"),
    "one boolean": ({"mask": True}, r"got bool of shape \(\)"),
    "one start too far out": (
        {"estimates": np.repeat([0.0] * 4 + [4e5], 25).reshape(5, 5, 5)},
        "own gradients at the initial estimates must be within",
    ),
}


@pytest.mark.parametrize("name", BAD_RESETS)
def test_bad_reset_is_refused_and_no_environment_is_touched(name, block_size):
    arguments, message = BAD_RESETS[name]
    env, undisturbed = make(steps=20, max_cycles=9), make(steps=20, max_cycles=9)
    for each in (env, undisturbed):
        each.reset(seed=0)
        go_on(each, 4)
    with pytest.raises(ValueError, match=message):
        env.reset(**arguments)
    assert same(go_on(env, 15, seed=3), go_on(undisturbed, 15, seed=3))


def test_the_first_reset_starts_every_environment(block_size):
    env = make()
    with pytest.raises(ValueError, match=r"the first reset\(\) starts every environment: leave out the mask"):
        env.reset(seed=0, mask=[True, True, False, False, False])
    with pytest.raises(RuntimeError, match="5 of 5 environments are over or not started"):
        env.step(np.zeros((5, 5, 5)))
    assert np.array_equal(env.reset(seed=0), make().reset(seed=0))


def test_step_of_environments_that_are_over_or_not_started_names_the_first(block_size):
    env = make(steps=30, input_limit=1e9)
    actions = np.zeros((5, 5, 5))
    with pytest.raises(RuntimeError, match=r"5 of 5 environments .* \(the first is 0\): call reset\(mask=...\) before"):
        env.step(actions)
    env.reset(seed=0)
    actions[[2, 4]] = 1e9
    over = env.step(actions).terminated
    assert over.tolist() == [False, False, True, False, True]
    with pytest.raises(RuntimeError, match=r"2 of 5 environments are over or not started \(the first is 2\)"):
        env.step(actions)
    with pytest.raises(RuntimeError, match=r"1 of 5 environments are over or not started \(the first is 4\)"):
        env.step(actions, np.array([False, False, True, False, False]))
    env.reset(mask=np.array([False, False, True, False, False]))
    with pytest.raises(RuntimeError, match=r"1 of 5 environments are over or not started \(the first is 4\)"):
        env.step(actions)
    env.reset(mask=over)
    env.step(np.zeros((5, 5, 5)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs must be a whole number of at least 1, got 0"),
        ({"num_envs": 2.0}, "num_envs must be a whole number"),
        ({"interface": "full"}, "for oracles in evaluations only"),
        ({"interface": "global"}, "unknown interface 'global'"),
        ({"reward": "score"}, "unknown reward 'score'"),
        ({"max_cycles": 0}, "max_cycles must be a whole number of at least 1"),
        ({"name": "enrgy"}, "unknown scenario 'enrgy'"),
    ],
)
def test_invalid_arguments_are_refused_with_advice(arguments, message):
    with pytest.raises(ValueError, match=message):
        make(**arguments)


def test_blocks_are_filled_in_order(monkeypatch):
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", 4)
    assert [block.num_envs for block in make(num_envs=10)._blocks] == [4, 4, 2]
    assert [block.num_envs for block in make(num_envs=8)._blocks] == [4, 4]
    assert [block.num_envs for block in make(num_envs=3)._blocks] == [3]


def test_player_vec_env_is_a_public_name():
    assert ptne_env.VectorParallelEnv is VectorParallelEnv


@pytest.mark.parametrize(
    ("restart", "message"),
    [
        (np.ones(5, dtype=np.int64), "a restart mask is 5 booleans, got int64"),
        (np.ma.masked_array([True] * 5), "a restart mask must be a plain array, got a masked array"),
        (np.ones(4, dtype=np.bool_), r"a restart mask is 5 booleans, got bool of shape \(4,\)"),
    ],
)
def test_a_bad_restart_mask_is_refused_and_no_environment_moves(restart, message):
    env, undisturbed = make(steps=20), make(steps=20)
    for each in (env, undisturbed):
        each.reset(seed=0)
    actions = np.zeros((5, 5, 5))
    with pytest.raises(ValueError, match=message):
        env.step(actions, restart)
    assert np.array_equal(env.step(actions).observations, undisturbed.step(actions).observations)


# --- buffers of the caller --------------------------------------------------------------------------------------------


@pytest.fixture(params=["numpy", "compiled"])
def path(request, monkeypatch):
    """Numpy's steps, or compiled steps from the first on."""
    if request.param == "compiled":
        need_numba()
    monkeypatch.setattr(fused, "_spent", np.inf if request.param == "compiled" else -np.inf)


def buffers_of(env, rewards=np.float64, fill=7):
    batch, players, size = env.num_envs, env.num_players, env.layout.size
    return VectorBuffers(
        np.full((batch, players, size), fill, dtype=np.float32),
        np.full((batch, players), fill, dtype=rewards),
        np.ones(batch, dtype=np.bool_),
        np.ones(batch, dtype=np.bool_),
    )


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("interface", ["physical", "scaled"])
def test_steps_and_resets_write_into_the_buffers_of_the_caller(interface, threads, block_size, path):
    env, fresh = make(max_cycles=4, interface=interface, threads=threads), make(max_cycles=4, interface=interface)
    generators, out = [np.random.default_rng(0) for _ in range(2)], buffers_of(env)
    assert env.reset(seed=0, out=out) is out.observations
    assert np.array_equal(out.observations, fresh.reset(seed=0))
    assert out.rewards.min() == 7
    for _ in range(14):
        outcome = env.step(random_actions(env, generators[0]), out=out)
        expected = fresh.step(random_actions(fresh, generators[1]))
        assert all(found is given for found, given in zip(outcome, out, strict=False))
        assert same(tuple(outcome), tuple(expected))
        over = expected.terminated | expected.truncated
        if over.any():
            assert np.array_equal(env.reset(mask=out.truncated | out.terminated, out=out), fresh.reset(mask=over))


def test_rewards_may_be_single_and_missing_buffers_are_made(path):
    env, fresh = make(), make()
    env.reset(seed=0), fresh.reset(seed=0)
    actions = random_actions(env, np.random.default_rng(0))
    rewards = np.empty((5, 5), dtype=np.float32)
    outcome, expected = env.step(actions, out=VectorBuffers(rewards=rewards)), fresh.step(actions)
    assert outcome.rewards is rewards
    assert np.array_equal(rewards, expected.rewards.astype(np.float32))
    assert same(outcome.infos, expected.infos)
    assert np.array_equal(outcome.observations, expected.observations)


def test_rows_of_a_rollout_buffer_are_written_whole_each_time_round(path):
    env, fresh = make(max_cycles=100, steps=400), make(max_cycles=100, steps=400)
    env.reset(seed=0), fresh.reset(seed=0)
    rollout, generators = np.full((3, 5, 5, env.layout.size), np.nan, np.float32), [np.random.default_rng(0), None]
    for step in range(7):
        actions = random_actions(env, generators[0])
        env.step(actions, out=VectorBuffers(rollout[step % 3]))
        assert np.array_equal(rollout[step % 3], fresh.step(actions).observations)
    memory = rollout.__array_interface__["data"][0]
    del rollout
    for _ in range(50):  # another array, perhaps at the same address, has not been written yet
        other = np.full((3, 5, 5, env.layout.size), np.nan, np.float32)
        actions = random_actions(env, generators[0])
        env.step(actions, out=VectorBuffers(other[0]))
        assert np.array_equal(other[0], fresh.step(actions).observations)
        if other.__array_interface__["data"][0] == memory:
            break


def test_restarts_may_be_the_flags_that_the_step_overwrites(path):
    env, fresh = make(max_cycles=3), make(max_cycles=3)
    out, over, generator = buffers_of(env), np.zeros(5, dtype=np.bool_), np.random.default_rng(0)
    env.reset(seed=0), fresh.reset(seed=0)
    out.truncated[:] = False
    for _ in range(9):
        actions = random_actions(env, generator)
        outcome, expected = env.step(actions, restart=out.truncated, out=out), fresh.step(actions, restart=over)
        assert same(tuple(outcome), tuple(expected))
        over = expected.truncated


def test_actions_that_lie_in_a_buffer_are_read_before_it_is_written(path):
    env, fresh = make(), make()
    env.reset(seed=0), fresh.reset(seed=0)
    out = buffers_of(env)
    actions = out.observations.reshape(-1)[:125].reshape(5, 5, 5)
    actions[...] = random_actions(env, np.random.default_rng(0))
    expected = fresh.step(actions.copy())
    assert same(tuple(env.step(actions, out=out)), tuple(expected))


SIZE = make().layout.size
SHARED = np.zeros(5 * 5 * SIZE * 4 + 100, dtype=np.uint8)
WRONG_BUFFERS = {
    "a tuple": ((None, None, None, None), "out is a VectorBuffers, got a tuple"),
    "shape": (
        VectorBuffers(np.zeros((5, 5, SIZE + 1), np.float32)),
        r"out.observations is a C-contiguous array of float",
    ),
    "dtype": (VectorBuffers(np.zeros((5, 5, SIZE))), r"float32 of shape .* got float64 of shape"),
    "order": (VectorBuffers(np.zeros((SIZE, 5, 5), np.float32).T), "not contiguous"),
    "rewards": (
        VectorBuffers(rewards=np.zeros((5, 5), np.float16)),
        "out.rewards .* of float64 or float32 .* got float16",
    ),
    "flags": (VectorBuffers(truncated=np.zeros(5, np.uint8)), "out.truncated .* of bool .* got uint8"),
    "list": (VectorBuffers(terminated=[False] * 5), "out.terminated .* got a list"),
    "masked": (VectorBuffers(rewards=np.ma.zeros((5, 5))), "got a MaskedArray"),
    "read-only": (VectorBuffers(rewards=np.broadcast_to(np.zeros((5, 5)), (5, 5))), "read-only"),
    "overlap with itself": (
        VectorBuffers(rewards=np.lib.stride_tricks.as_strided(np.zeros(9), (5, 5), (8, 8))),
        "out.rewards .* not contiguous",
    ),
    "overlap of two": (
        VectorBuffers(SHARED[: 100 * SIZE].view(np.float32).reshape(5, 5, SIZE), truncated=SHARED[9:14].view(np.bool_)),
        "out.observations and out.truncated share memory: each needs its own",
    ),
}


@pytest.mark.parametrize("case", WRONG_BUFFERS)
def test_a_wrong_buffer_is_refused_and_nothing_changes(case, path):
    out, message = WRONG_BUFFERS[case]
    env, undisturbed = make(), make()
    env.reset(seed=0), undisturbed.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(random_actions(env, np.random.default_rng(3)), out=out)
    with pytest.raises(ValueError, match=message):
        env.reset(seed=5, out=out)
    assert same(go_on(env, 9), go_on(undisturbed, 9))


# --- threads ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("name", ["random-energy-switching-transformed", "non-quadratic"])
def test_numbers_do_not_depend_on_the_number_of_threads(name, interface, path):
    fields = {"interface": interface, "num_envs": 7, "max_cycles": 5, "steps": 400, "start": "random"}
    one, *others = (make(name, threads=threads, **fields) for threads in (1, 2, 3, 9))
    first = one.reset(seed=0)
    record = go_on(one, 12)
    for env in others:
        assert np.array_equal(env.reset(seed=0), first)
        assert same(go_on(env, 12), record)


def test_rewards_from_a_given_start_do_not_depend_on_the_number_of_threads(path):
    start = np.random.default_rng(0).uniform(-20, 20, (9, 5, 5))
    one, *others = (make(num_envs=9, threads=threads) for threads in (1, 2, 9))
    one.reset(seed=0, estimates=start)
    record = go_on(one, 2)
    for env in others:
        env.reset(seed=0, estimates=start)
        assert same(go_on(env, 2), record)


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2", None])
def test_a_wrong_number_of_threads_is_refused(threads):
    with pytest.raises(ValueError, match="threads must be a whole number of at least 1"):
        make(threads=threads)


def test_copies_and_pickles_of_an_environment_have_threads_of_their_own(path):
    env = make(threads=2)
    env.reset(seed=0)
    go_on(env, 2)
    twins = copy.deepcopy(env), pickle.loads(pickle.dumps(env))  # noqa: S301
    expected = go_on(env, 4)
    assert all(same(go_on(twin, 4), expected) for twin in twins)


def test_an_error_on_a_thread_reaches_the_caller(monkeypatch):
    env = make(threads=2)
    env.reset(seed=0)

    def fail(*_, **__):
        raise MemoryError

    monkeypatch.setattr(env._blocks[1], "step", fail)
    with pytest.raises(MemoryError):
        env.step(random_actions(env, np.random.default_rng(0)))


@pytest.mark.parametrize("dtype", [np.int64, np.int8, np.uint16])
def test_integer_actions_are_the_same_as_floats(dtype):
    env, other = make(), make()
    actions = np.random.default_rng(0).integers(0, 100, (5, 5, 5)).astype(dtype)
    for each in (env, other):
        each.reset(seed=0)
    assert same(tuple(env.step(actions)), tuple(other.step(actions.astype(np.float64))))


def test_an_unknown_keyword_is_a_type_error_that_names_similar_ones():
    with pytest.raises(TypeError, match="VectorParallelEnv.* unexpected keyword argument 'rewrd'; .* 'reward'.$"):
        VectorParallelEnv("energy", 2, rewrd="digits")


def test_a_shallow_copy_steps_on_its_own():
    env, undisturbed = make(), make()
    for each in (env, undisturbed):
        each.reset(seed=0)
    twin = copy.copy(env)
    actions = np.ones((5, 5, 5), dtype=np.float32)
    expected = tuple(undisturbed.step(actions))
    assert same(tuple(twin.step(actions)), expected)
    assert same(tuple(env.step(actions)), expected)


def test_first_infos_have_the_keys_shapes_and_dtypes_of_steps():
    env = make(reward={"digits": 1.0, "payoff": 0.1})
    env.reset(seed=0)
    first, later = env.first_infos(), env.step(np.zeros((5, 5, 5))).infos
    assert [(name, each.shape, each.dtype) for name, each in first.items()] == [
        (name, each.shape, each.dtype) for name, each in later.items()
    ]
