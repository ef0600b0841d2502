"""What every adapter promises: shapes, seeds, ends, memory, copies, refusals; then one against the other."""

import copy
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from worlds import BLOCKS, BLOCKS_SWITCHING, FAULTY

import ptne_env
from ptne_env import NashSeekingEnv, VectorParallelEnv
from ptne_env.envs import vector as vector_module
from ptne_env.envs.gymnasium import JointEnv, JointVectorEnv

try:
    from ptne_env.envs.sb3 import PlayerVecEnv
except ImportError:  # without the extra 'sb3' the others keep their promises all the same
    PlayerVecEnv = None


class Parallel:
    """How a test drives an adapter: actions are arrays of :meth:`shape`, results are tuples."""

    @staticmethod
    def make(name="random-energy", **arguments):
        return NashSeekingEnv(name, **arguments)

    @staticmethod
    def shape(env):
        return len(env.possible_agents), env.layout.action_size

    @staticmethod
    def reset(env, seed=None):
        return env.reset(seed=seed)

    @staticmethod
    def step(env, actions):
        return env.step(dict(zip(env.possible_agents, actions, strict=True)))

    @staticmethod
    def ends(result):
        return result[2]["player_0"], result[3]["player_0"]

    @staticmethod
    def shown(env, result):
        return env.observation_space("player_0"), list(result[0].values())


class Vector(Parallel):
    @staticmethod
    def make(name="random-energy", **arguments):
        return VectorParallelEnv(name, 3, **arguments)

    @staticmethod
    def shape(env):
        return env.num_envs, env.num_players, env.layout.action_size

    @staticmethod
    def reset(env, seed=None):
        return env.reset(seed)

    @staticmethod
    def step(env, actions):
        return tuple(env.step(actions))

    @staticmethod
    def ends(result):
        return result[2].all(), result[3].all()

    @staticmethod
    def shown(env, result):
        return env.single_observation_space, result[0].reshape(-1, env.layout.size)


class Joint(Parallel):
    make = staticmethod(lambda name="random-energy", **arguments: JointEnv(name, **arguments))
    shape = staticmethod(lambda env: env.action_space.shape)
    step = staticmethod(lambda env, actions: env.step(actions))
    ends = staticmethod(lambda result: result[2:4])
    shown = staticmethod(lambda env, result: (env.observation_space, [result[0]]))


class JointVector(Joint):
    @staticmethod
    def make(name="random-energy", **arguments):
        return JointVectorEnv(name, 3, autoreset_mode="Disabled", **arguments)

    ends = Vector.ends
    shown = staticmethod(lambda env, result: (env.single_observation_space, result[0]))


class Players(Joint):
    make = staticmethod(lambda name="random-energy", **arguments: PlayerVecEnv(name, 3, **arguments))
    shape = staticmethod(lambda env: (env.num_envs, *env.action_space.shape))
    shown = staticmethod(lambda env, result: (env.observation_space, result[0]))

    @staticmethod
    def reset(env, seed=None):
        if seed is not None:
            env.seed(seed)
        return (env.reset(),)

    @staticmethod
    def ends(result):
        cut = [info.get("TimeLimit.truncated", False) for info in result[3]]
        return result[2].all() and not any(cut), all(cut)


ADAPTERS = {"parallel": Parallel, "vector": Vector, "joint": Joint, "joint vector": JointVector}
ADAPTERS |= {"players": Players} if PlayerVecEnv else {}


@pytest.fixture(params=ADAPTERS)
def adapter(request):
    return ADAPTERS[request.param]


def actions_of(adapter, env, generator, scale=1.2):
    """Random actions, some of them outside of the box."""
    return (generator.uniform(-scale, scale, adapter.shape(env)) * env.layout.action_bound).astype(np.float32)


def go_on(adapter, env, steps, seed=0):
    generator = np.random.default_rng(seed)
    return [adapter.step(env, actions_of(adapter, env, generator)) for _ in range(steps)]


def same(first, second):
    """Equality of nested records, bit for bit and type for type; seconds of episodes may differ."""
    if isinstance(first, dict):
        return list(first) == list(second) and all(same(first[key], second[key]) for key in first if key != "episode")
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and np.array_equal(first, second)
    return type(first) is type(second) and first == second


def arrays_in(value):
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict | list | tuple):
        for item in value.values() if isinstance(value, dict) else value:
            yield from arrays_in(item)


@pytest.mark.parametrize("interface", ["scaled", "physical"])
@pytest.mark.parametrize("name", ["random-energy", BLOCKS], ids=str)
def test_observations_are_float32_in_their_space_from_reset_to_end(adapter, name, interface):
    env = adapter.make(name, steps=30, hold_steps=3, input_limit=20.0, interface=interface)
    result, generator = adapter.reset(env, 0), np.random.default_rng(0)
    for _ in range(33):
        result = adapter.step(env, actions_of(adapter, env, generator))
        space, rows = adapter.shown(env, result)
        assert all(row.dtype == np.float32 and space.contains(row) for row in rows)
    assert adapter.ends(result) == (True, False)


def test_the_default_interface_is_scaled_and_full_is_refused(adapter):
    env = adapter.make()
    assert env.layout.interface == ptne_env.Interface("scaled")
    assert env.layout.action_space().high.max() == 1
    with pytest.raises(
        ValueError, match=r"'full'\) shows information that players lack.*choose 'scaled' or 'physical'"
    ):
        adapter.make(interface="full")


@pytest.mark.parametrize("name", ["random-energy", "random-energy-switching-transformed"])
def test_a_seed_repeats_episodes_bit_for_bit_and_without_one_new_ones_are_drawn(adapter, name):
    records = []
    for seed in (4, 4, 5):
        env = adapter.make(name, max_cycles=10)
        records.append([adapter.reset(env, seed), go_on(adapter, env, 9), adapter.reset(env), go_on(adapter, env, 3)])
    assert same(records[0], records[1])
    assert not same(records[0], records[2])
    assert not same(records[0][0], records[0][2])
    assert not same(adapter.reset(adapter.make(name)), adapter.reset(adapter.make(name)))


@pytest.mark.parametrize(
    ("max_cycles", "length", "ends"), [(None, 8, (True, False)), (8, 8, (True, False)), (7, 7, (False, True))]
)
def test_reaching_the_end_is_termination_and_an_earlier_cut_is_truncation(adapter, max_cycles, length, ends):
    env = adapter.make(steps=6, hold_steps=2, max_cycles=max_cycles)
    adapter.reset(env, 0)
    results = go_on(adapter, env, length)
    assert [adapter.ends(result) for result in results] == [(False, False)] * (length - 1) + [ends]


def test_returned_arrays_never_change_and_share_no_memory(adapter):
    env = adapter.make("random-energy-switching", reward={"digits": 1.0, "tracking": 0.1})
    record = [adapter.reset(env, 0)]
    kept = copy.deepcopy(record)
    generator = np.random.default_rng(0)
    for _ in range(12):
        record.append(adapter.step(env, actions_of(adapter, env, generator)))
        kept.append(copy.deepcopy(record[-1]))
    assert same(record, kept)
    arrays = list(arrays_in(record))
    assert all(array.flags.c_contiguous and array.flags.writeable for array in arrays)
    for index, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[index + 1 : index + 30])


def test_writing_into_returned_and_passed_arrays_changes_nothing(adapter):
    env, undisturbed = (adapter.make("random-energy-switching") for _ in range(2))
    vandalised, record = adapter.reset(env, 0), adapter.reset(undisturbed, 0)
    generators = [np.random.default_rng(0) for _ in range(2)]
    for _ in range(8):
        assert same(vandalised, record)
        for array in arrays_in(vandalised):
            array[...] = 1
        actions = actions_of(adapter, env, generators[0])
        vandalised = adapter.step(env, actions)
        actions[:] = 77
        record = adapter.step(undisturbed, actions_of(adapter, undisturbed, generators[1]))


@pytest.mark.parametrize("interface", ["scaled", "physical"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_continues_identically_and_on_its_own(adapter, copied, interface):
    env = adapter.make("random-energy-switching-transformed", interface=interface)
    adapter.reset(env, 0)
    go_on(adapter, env, 5)
    twin = copied(env)
    ours = [go_on(adapter, env, 5, seed=2), adapter.reset(env), go_on(adapter, env, 2)]
    assert same(ours, [go_on(adapter, twin, 5, seed=2), adapter.reset(twin), go_on(adapter, twin, 2)])


BAD_ACTIONS = {
    "NaN": (lambda good: good * np.nan, "not finite|NaN"),
    "infinite": (lambda good: good + np.inf, "not finite|NaN"),
    "one short": (lambda good: good[..., :-1], "shape"),
    "booleans": (lambda good: good > 0, "dtype bool|got bool"),
    "complex": (lambda good: good.astype(complex), "complex"),
    "masked": (np.ma.masked_array, "masked array"),
}


@pytest.mark.parametrize("fault", BAD_ACTIONS)
def test_bad_actions_are_refused_and_change_nothing(adapter, fault):
    spoil, message = BAD_ACTIONS[fault]
    env, undisturbed = (adapter.make() for _ in range(2))
    good = np.ones(adapter.shape(env), dtype=np.float32)
    for each in (env, undisturbed):
        adapter.reset(each, 0)
        adapter.step(each, good)
    with pytest.raises(ValueError, match=message):
        adapter.step(env, spoil(good))
    assert same(adapter.step(env, good), adapter.step(undisturbed, good))


@pytest.mark.parametrize("dtype", [np.float64, np.int64, np.uint8])
def test_other_numbers_act_as_floats_of_32_bits(adapter, dtype):
    env, other = (adapter.make(interface="physical") for _ in range(2))
    actions = np.random.default_rng(0).uniform(0, 9, adapter.shape(env)).astype(dtype)
    for each in (env, other):
        adapter.reset(each, 0)
    assert same(adapter.step(env, actions), adapter.step(other, actions.astype(np.float32)))


def test_a_step_before_reset_asks_for_one(adapter):
    env = adapter.make()
    with pytest.raises(RuntimeError, match=r"call reset\("):
        adapter.step(env, np.zeros(adapter.shape(env), dtype=np.float32))


def test_invalid_arguments_are_refused_with_advice(adapter):
    with pytest.raises(ValueError, match="unknown reward 'score'; choose from digits, tracking, payoff, regret"):
        adapter.make(reward="score")
    with pytest.raises(ValueError, match="max_cycles must be a whole number of at least 1"):
        adapter.make(max_cycles=0)


def test_an_unknown_keyword_is_a_type_error_that_names_similar_ones_or_all(adapter):
    with pytest.raises(TypeError, match="unexpected keyword argument 'stps'; did you mean 'steps'"):
        adapter.make(stps=3)
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'; choose from scenario, .*interface"):
        adapter.make(frameskip=1)


# --- vectors step as single environments do, bit for bit, through resets; JointVectorEnv: see test_gymnasium.py -------

BATCH, STEPS, SEED, CRASHING = 5, 27, 11, 1
WORLDS = {
    "switching": ("energy-switching", {"start": "random", "steps": 17}),
    "cut": ("random-energy-switching", {"steps": 17, "max_cycles": 11}),
    "non-quadratic": ("non-quadratic-switching", {"start": "random", "steps": 17}),
    "blocks": (BLOCKS_SWITCHING, {"gain": 0.0, "steps": 30, "max_cycles": 8}),
    "faulty": (FAULTY, {"max_cycles": 8}),
    "crashing": ("random-energy", {"max_cycles": 14, "input_limit": 1e9}),
}


def scripted_actions(env, world):
    """Actions for every step and environment, some outside the box; shape (STEPS, B, N, action size)."""
    shape = (STEPS, BATCH, env.layout.num_players, env.layout.action_size)
    unit = np.random.default_rng(0).uniform(-1.2, 1.2, shape)
    if world == "crashing":
        unit *= 1e-9
        unit[::5, CRASHING] = 1.0
    return (env.layout.action_bound * unit).astype(np.float32)


def play_alone(env, seed, actions):
    """An environment of its own: its first observation, and a record of each step, with a reset after each end."""
    first, steps = np.stack(list(env.reset(seed=seed)[0].values())), []
    for rows in actions:
        agents = env.agents
        observations, rewards, terminations, truncations, infos = env.step(dict(zip(agents, rows, strict=True)))
        shown = np.stack(list(observations.values()))
        following = np.stack(list(env.reset()[0].values())) if not env.agents else shown
        info = {name: np.array([infos[agent][name] for agent in agents]) for name in infos[agents[0]]}
        ends = terminations[agents[0]], truncations[agents[0]]
        steps.append((shown, following, np.array(list(rewards.values())), *ends, info))
    return first, steps


def together(records):
    """The records of the environments, stacked: environments first."""
    firsts, columns = zip(*records, strict=True)
    steps = []
    for row in zip(*columns, strict=True):
        parts = [np.stack([each[part] for each in row]) for part in range(5)]
        step = SimpleNamespace(
            **dict(zip(("shown", "following", "rewards", "terminated", "truncated"), parts, strict=True))
        )
        step.infos = {name: np.stack([each[5][name] for each in row]) for name in row[0][5]}
        step.over = step.terminated | step.truncated
        steps.append(step)
    return np.stack(firsts), steps


def check_vector(env, first, steps, actions):
    np.testing.assert_array_equal(env.reset(seed=SEED)[0], first, strict=True)
    for step, rows in zip(steps, actions, strict=True):
        outcome = env.step(rows)
        for name, values in step.infos.items():
            found = outcome.infos[name] if name in ("diverged", "is_success") else outcome.infos[name].T
            np.testing.assert_array_equal(found, values[:, 0] if found.ndim == 1 else values.T, strict=True)
        np.testing.assert_array_equal(outcome.observations, step.shown, strict=True)
        np.testing.assert_array_equal(outcome.rewards, step.rewards, strict=True)
        np.testing.assert_array_equal(outcome.terminated, step.terminated, strict=True)
        np.testing.assert_array_equal(outcome.truncated, step.truncated, strict=True)
        if step.over.any():
            np.testing.assert_array_equal(env.reset(mask=step.over)[0], step.following, strict=True)


def check_players(env, first, steps, actions):
    members, players = BATCH * first.shape[1], first.shape[1]
    env.seed(SEED)
    np.testing.assert_array_equal(env.reset(), first.reshape(members, -1), strict=True)
    for step, rows in zip(steps, actions, strict=True):
        observations, rewards, dones, infos = env.step(rows.reshape(members, -1))
        np.testing.assert_array_equal(observations, step.following.reshape(members, -1), strict=True)
        np.testing.assert_array_equal(rewards, step.rewards.reshape(members).astype(np.float32), strict=True)
        np.testing.assert_array_equal(dones, np.repeat(step.over, players), strict=True)
        for member, info in enumerate(infos):
            index, player = divmod(member, players)
            if not dones[member]:
                assert info == {}
                continue
            np.testing.assert_array_equal(info.pop("terminal_observation"), step.shown[index, player], strict=True)
            assert info.pop("episode")["l"] > 0
            expected = {name: values[index, player] for name, values in step.infos.items()}
            assert info == {"TimeLimit.truncated": step.truncated[index], **expected}


@pytest.mark.parametrize(
    ("interface", "reward"),
    [("physical", "digits"), ("scaled", {"digits": 1.0, "payoff": 1e-3, "tracking": 0.5})],
    ids=["physical", "scaled"],
)
@pytest.mark.parametrize("world", WORLDS)
def test_vectors_agree_with_single_environments_bit_for_bit_through_resets(world, reward, interface, monkeypatch):
    scenario, fields = WORLDS[world]
    arguments = {"input_limit": 5.0, **fields, "reward": reward, "interface": interface}
    envs = [NashSeekingEnv(scenario, **arguments) for _ in range(BATCH)]
    actions = scripted_actions(envs[0], world)
    first, steps = together([play_alone(env, SEED + index, actions[:, index]) for index, env in enumerate(envs)])

    check_vector(VectorParallelEnv(scenario, BATCH, **arguments), first, steps, actions)
    if PlayerVecEnv is not None:
        check_players(PlayerVecEnv(scenario, BATCH, **arguments), first, steps, actions)
    monkeypatch.setattr(vector_module, "BLOCK_SIZE", 2)
    check_vector(VectorParallelEnv(scenario, BATCH, **arguments), first, steps, actions)

    assert sum(step.over.sum() for step in steps) >= BATCH
    diverged = np.stack([step.infos["diverged"][:, 0] for step in steps])
    if world == "crashing" and interface == "physical":
        assert diverged[:, CRASHING].any()
        assert not np.delete(diverged, CRASHING, axis=1).any()
        assert any(0 < step.over.sum() < BATCH for step in steps)
    elif world != "crashing":
        assert any(step.infos["clipped"].any() for step in steps)
