"""The vector environment's own facts: seeds, masks, restarts; what all adapters promise is in test_adapters.py."""

import pickle

import numpy as np
import pytest
from test_adapters import same
from worlds import BLOCKS, FAULTY, SHORT, make_env, random_actions

from ptne_env import VectorParallelEnv
from ptne_env.envs import vector as vector_module
from ptne_env.envs.vector import VectorStep
from ptne_env.games import EnergyGame, NonQuadraticGame
from ptne_env.world import distances, dynamics
from ptne_env.world.rewards import measure_distances


@pytest.fixture(params=[1024, 2], ids=["one block", "blocks of two"])
def block_size(request, monkeypatch):
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", request.param)
    return request.param


def make(name="random-energy", num_envs=5, **arguments):
    return VectorParallelEnv(name, num_envs, **{"interface": "physical", **SHORT, **arguments})


def first(env, **arguments):
    """The observations of a reset."""
    return env.reset(**arguments)[0]


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


def test_shapes_and_dtypes_are_as_documented(block_size):
    env = make(reward={"digits": 1.0, "payoff": 1e-3})
    observations, infos = env.reset(seed=0)
    outcome = env.step(random_actions(env, np.random.default_rng(0)))
    assert type(outcome) is VectorStep
    returned = {
        "first observations": observations,
        **{name: value for name, value in outcome._asdict().items() if name != "infos"},
        **outcome.infos,
    }
    assert {name: (array.shape, array.dtype) for name, array in returned.items()} == {
        "first observations": ((5, 5, env.layout.size), np.float32),
        "observations": ((5, 5, env.layout.size), np.float32),
        "rewards": ((5, 5), np.float64),
        "terminated": ((5,), np.bool_),
        "truncated": ((5,), np.bool_),
        "diverged": ((5,), np.bool_),
        "clipped": ((5, 5), np.int64),
        "is_success": ((5,), np.bool_),
        "reward_digits": ((5, 5), np.float64),
        "reward_payoff": ((5, 5), np.float64),
    }
    assert {name: (array.shape, array.dtype) for name, array in infos.items()} == {
        name: (array.shape, array.dtype) for name, array in outcome.infos.items()
    }
    assert env.single_observation_space.shape == (env.layout.size,)
    assert env.single_action_space.shape == (env.layout.action_size,)


def test_a_seed_is_counted_up_and_a_list_is_taken_as_it_is(block_size):
    env = make(num_envs=4)
    counted = first(env, seed=20)
    assert np.array_equal(first(env, seed=[20, 21, 22, 23]), counted)
    assert np.array_equal(first(env, seed=np.int64(20)), counted)
    assert np.array_equal(first(env, seed=np.arange(20, 24)), counted)
    assert np.array_equal(first(env, seed=[23, 22, 21, 20]), counted[::-1])
    assert len({row.tobytes() for row in counted}) == 4
    alone = make_env("random-energy", **SHORT)
    for index in range(4):
        observations, _ = alone.reset(seed=20 + index)
        assert np.array_equal(np.stack(list(observations.values())), counted[index])


def test_without_a_seed_the_generators_continue(block_size):
    env, other = make(), make()
    one = first(env, seed=1)
    second = first(env)
    assert not np.any(np.all(one == second, axis=(1, 2)))
    other.reset(seed=1)
    assert np.array_equal(first(other), second)
    mixed = first(other, seed=[1, None, None, 4, None])
    assert np.array_equal(mixed[[0, 3]], one[[0, 3]])
    assert np.array_equal(mixed[[1, 2, 4]], first(env)[[1, 2, 4]])
    assert not np.array_equal(first(make()), first(make()))


def test_a_mask_restarts_only_its_environments(block_size):
    env = make(steps=60)
    env.reset(seed=0)
    before = go_on(env, 3)[-1][0]
    mask = np.array([False, True, True, False, False])
    observations = first(env, mask=mask)
    assert np.array_equal(observations[~mask], before[~mask])
    assert not np.any(np.all(observations[mask] == before[mask], axis=(1, 2)))
    clock = env.layout.select(observations, "clock")[:, 0, 0]
    assert np.array_equal(clock == 0, mask)
    seeded = first(env, seed=[50, 51, 52, 53, 54], mask=mask)
    assert np.array_equal(seeded[mask], first(make(steps=60), seed=50)[mask])
    assert np.array_equal(seeded[~mask], before[~mask])
    assert np.array_equal(first(env, mask=[False] * 5), seeded)
    undisturbed = make(steps=60)
    undisturbed.reset(seed=0)
    assert np.array_equal(first(env)[~mask], first(undisturbed)[~mask])  # the seeds of others did not count


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
        observations = first(by_hand, mask=restart)
        assert np.array_equal(restart, kept)
        assert np.array_equal(ours.observations, observations)
        assert np.array_equal(ours.rewards, np.where(restart[:, None], 0.0, theirs.rewards))
        for name in env.reward_names:
            assert np.array_equal(ours.infos[name], np.where(restart[:, None], 0.0, theirs.infos[name]))
        assert np.array_equal(ours.infos["clipped"], np.where(restart[:, None], 0, theirs.infos["clipped"]))
        assert theirs.infos["clipped"].any(axis=1).all()


BAD_RESETS = {
    "too few seeds": ({"seed": [1, 2, 3]}, "5 environments need as many seeds, got 3"),
    "a negative seed": ({"seed": [0, 1, 2, 3, -4]}, "a seed must be a whole number of at least 0, got -4"),
    "a fractional seed among others": ({"seed": [1, 2, 3, 4.5, 5]}, "a seed must be a whole number.*got 4.5"),
    "a text as seeds": ({"seed": "12345"}, "seeds are a whole number or 5 of them, got str"),
    "a masked mask": (
        {"mask": np.ma.masked_array([True] * 5)},
        "a reset mask must be a plain array, got a masked array",
    ),
    "a short mask": ({"mask": np.ones(4, dtype=np.bool_)}, r"a reset mask is 5 booleans, got bool of shape \(4,\)"),
    "a mask of numbers": ({"mask": [0, 1, 0, 1, 1]}, r"a reset mask is 5 booleans, got int64 of shape \(5,\)"),
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
    assert np.array_equal(first(env, seed=0), first(make(), seed=0))


def test_step_of_environments_that_are_over_or_not_started_names_the_first(block_size):
    env = make(steps=30, input_limit=1e9)
    actions = np.zeros((5, 5, 5))
    with pytest.raises(RuntimeError, match=r"5 of 5 environments .* \(the first is 0\): call reset\(\) for them"):
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


def test_a_bad_restart_mask_is_refused_and_no_environment_moves():
    env, undisturbed = make(steps=20), make(steps=20)
    for each in (env, undisturbed):
        each.reset(seed=0)
    actions = np.zeros((5, 5, 5))
    with pytest.raises(ValueError, match="a restart mask is 5 booleans, got int64"):
        env.step(actions, np.ones(5, dtype=np.int64))
    assert np.array_equal(env.step(actions).observations, undisturbed.step(actions).observations)


TRUE_STATE = ("estimates", "strategies", "time", "nash_equilibria")


@pytest.mark.parametrize("name", ["random-energy", BLOCKS], ids=str)
def test_the_true_state_has_a_row_per_environment_in_arrays_of_its_own(name, block_size):
    env, alone = make(name, 3), make_env(name, **SHORT)
    env.reset(seed=4)
    actions = random_actions(env, np.random.default_rng(0))
    env.step(actions)
    shown = {name: getattr(env, name) for name in TRUE_STATE}
    for index in range(3):
        alone.reset(seed=4 + index)
        alone.step(dict(zip(alone.agents, actions[index], strict=True)))
        for array, row in zip(shown.values(), (alone.estimates, alone.strategies, alone.time), strict=False):
            np.testing.assert_array_equal(array[index], row, strict=isinstance(row, np.ndarray))
        np.testing.assert_array_equal(shown["nash_equilibria"][index], alone.nash_equilibrium, strict=True)
    kept = {name: array.copy() for name, array in shown.items()}
    for array in (*shown.values(), env.get_state().estimates):
        array[...] = 7.0
    assert all(np.array_equal(getattr(env, name), kept[name]) for name in TRUE_STATE)


def test_the_true_state_asks_for_a_reset_but_a_known_game_needs_none(block_size):
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        _ = make().nash_equilibria
    for read in (lambda env: env.estimates, lambda env: env.time, lambda env: env.get_state()):
        with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
            read(make("energy"))
    assert np.array_equal(make("energy").nash_equilibria, np.tile(make_env("energy").nash_equilibrium, (5, 1)))


@pytest.mark.parametrize("name", ["random-energy", FAULTY], ids=str)
def test_a_state_is_gone_back_to_bit_for_bit(name, block_size):
    env = make(name, steps=40)
    env.reset(seed=0)
    go_on(env, 4)
    saved, over = env.get_state(), env.over
    first = [env.step(random_actions(env, np.random.default_rng(k))) for k in range(3)]
    env.reset(mask=[True, False, False, True, False])
    env.set_state(pickle.loads(pickle.dumps(saved)))  # noqa: S301
    assert np.array_equal(env.over, over)
    again = [env.step(random_actions(env, np.random.default_rng(k))) for k in range(3)]
    assert same(first, again)
    alone = make_env(name, steps=40)
    alone.reset(seed=9)
    alone.set_state(dynamics.select(saved, slice(3, 4)))
    assert np.array_equal(alone.estimates, saved.estimates[:, :, 3].T)


def test_a_state_with_other_games_plays_them_until_the_next_start(block_size):
    env = make("energy")
    env.reset(seed=0)
    targets = np.random.default_rng(0).uniform(5, 35, (5, 5))
    games = EnergyGame(target=targets, curvature=np.ones((5, 5)), coupling=np.full(5, 0.1))
    env.set_state(env.get_state()._replace(game=games))
    alone = make_env("energy", **SHORT)
    for index in range(5):
        alone.reset(seed=index)
        alone.set_state(alone.get_state()._replace(game=EnergyGame(target=targets[:, index])))
        np.testing.assert_allclose(env.nash_equilibria[index], alone.nash_equilibrium, rtol=1e-14)
        assert np.array_equal(env.get_state().own_gradients[:, index], alone.get_state().own_gradients[:, 0])
    drifted = env.nash_equilibria
    env.reset(mask=[False, True, False, False, False])
    assert np.array_equal(env.nash_equilibria[[0, 2, 3, 4]], drifted[[0, 2, 3, 4]])
    np.testing.assert_allclose(env.nash_equilibria[1], make_env("energy").nash_equilibrium, rtol=1e-14)
    env.reset(mask=[True, True, False, False, False])  # a whole block, where there are several
    shown = env.nash_equilibria
    env.set_state(env.get_state())
    np.testing.assert_allclose(env.nash_equilibria, shown, rtol=1e-14)


@pytest.mark.parametrize(
    "game",
    [
        EnergyGame(target=(1.0, 2.0, 3.0, 4.0, 5.0)),
        EnergyGame(np.ones((5, 5)), np.ones((5, 5)), np.ones(5), base_price=3.0),
        EnergyGame(np.ones((5, 2)), np.ones((5, 2)), np.ones(2)),
        NonQuadraticGame(),
    ],
)
def test_games_that_cannot_take_each_others_place_are_refused_and_no_environment_is_touched(game, block_size):
    env = make("energy")
    env.reset(seed=0)
    before = env.estimates
    with pytest.raises(ValueError, match=r"5 environments play EnergyGame\(\), or .* curvature, target, coupling, got"):
        env.set_state(env.get_state()._replace(game=game, estimates=np.zeros((5, 5, 5))))
    assert np.array_equal(env.estimates, before)


def test_a_reward_function_gets_all_environments_and_pays_nothing_for_a_restart(block_size):
    def progress(before, after, world):
        assert before.estimates.shape == after.estimates.shape
        assert world.scenario.name == "random-energy"
        return distances.player_distances(before.estimates, before.game) - measure_distances(after)

    env, tracking = make(reward=progress, steps=30), make(reward="tracking", steps=30)
    restart, generator = np.array([False, True, False, False, False]), np.random.default_rng(0)
    env.reset(seed=0), tracking.reset(seed=0)
    last = tracking.step(random_actions(env, np.random.default_rng(1))).rewards
    env.step(random_actions(env, np.random.default_rng(1)))
    actions = random_actions(env, generator)
    ours, theirs = env.step(actions, restart), tracking.step(actions, restart)
    np.testing.assert_allclose(ours.rewards[~restart], (theirs.rewards - last)[~restart], rtol=1e-9, atol=1e-9)
    assert not ours.rewards[restart].any()
    assert np.array_equal(ours.infos["reward_function"], ours.rewards)


def test_the_number_of_cycles_is_shown_and_set_once():
    env = VectorParallelEnv("random-energy", 2, max_cycles=7)
    assert env.max_cycles == 7
    with pytest.raises(AttributeError):
        env.max_cycles = 9
