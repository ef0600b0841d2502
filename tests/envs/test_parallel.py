import copy
import pickle

import numpy as np
import pytest
from extras import need_sb3
from worlds import BLOCKS, PAPER_START, constant_actions, make_env, play, while_running

import ptne_env
from ptne_env import CATALOGUE, get_scenario, laws
from ptne_env.bench import get_suite
from ptne_env.envs.turn_based import aec_env
from ptne_env.world import dynamics

INTERFACES = [
    {"interface": interface, "action_mode": mode} for interface in ("physical", "scaled") for mode in ("input", "gains")
]


def name_of(scenario):
    return getattr(scenario, "name", scenario)


def random_actions(env, generator):
    """Float32 actions, some of them outside the box."""
    bound, size = 1.2 * env.layout.action_bound, env.layout.action_size
    return {agent: generator.uniform(-bound, bound, size).astype(np.float32) for agent in env.agents}


def go_on(env, steps, generator):
    """All that ``steps`` random steps return, and the views of the whole after each."""
    return [
        (*env.step(random_actions(env, generator)), env.state(), env.estimates, env.time)
        for _ in range(steps)
        if env.agents
    ]


def same(first, second):
    """Equality of nested records, bit for bit and type for type."""
    if isinstance(first, dict):
        return list(first) == list(second) and all(same(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(same(a, b) for a, b in zip(first, second, strict=True))
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and np.array_equal(first, second)
    return type(first) is type(second) and first == second


def arrays_in(value):
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from arrays_in(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from arrays_in(item)


# --- determinism ------------------------------------------------------------------------------------------------------


def seeded_episode(name, seed, **arguments):
    env = make_env(name, start="random", steps=150, input_limit=5.0, **arguments)
    first = env.reset(seed=seed)
    episode = go_on(env, 150, np.random.default_rng(0))
    following = env.reset()
    return [first, episode, following, go_on(env, 5, np.random.default_rng(1))]


@pytest.mark.parametrize("arguments", INTERFACES, ids=lambda arguments: "-".join(arguments.values()))
@pytest.mark.parametrize("name", CATALOGUE)
def test_same_seed_and_actions_repeat_whole_episodes_bit_for_bit(name, arguments):
    record = seeded_episode(name, 4, **arguments)
    assert same(record, seeded_episode(name, 4, **arguments))
    assert not same(record, seeded_episode(name, 5, **arguments))
    assert len(record[1]) > 1


def test_a_reset_without_seed_draws_new_starts():
    env = make_env("energy", start="random")
    env.reset(seed=0)
    starts = [env.estimates]
    for _ in range(3):
        env.reset()
        starts.append(env.estimates)
    assert len({start.tobytes() for start in starts}) == 4
    env.reset(seed=0)
    assert np.array_equal(env.estimates, starts[0])


def test_environments_without_seed_differ():
    first, second = make_env("energy", start="random"), make_env("energy", start="random")
    first.reset()
    second.reset()
    assert not np.array_equal(first.estimates, second.estimates)


def test_paper_start_needs_no_seed():
    env = make_env("energy")
    env.reset()
    assert np.array_equal(env.estimates, PAPER_START)
    env.reset(seed=99)
    assert np.array_equal(env.estimates, PAPER_START)


def test_options_set_the_start():
    env = make_env(BLOCKS)
    table = np.arange(18.0).reshape(3, 6)
    env.reset(options={"estimates": table})
    assert np.array_equal(env.estimates, table)
    table[:] = 0
    assert env.estimates[2, 5] == 17.0
    env.reset(options={"estimates": (np.ones((3, 6))).tolist()})
    assert np.all(env.estimates == 1)
    env.reset(seed=0, options={"colour": "red"})  # PettingZoo lets callers pass options of other environments


def test_given_estimates_draw_no_random_numbers():
    env, undisturbed = make_env("energy", start="random"), make_env("energy", start="random")
    for each in (env, undisturbed):
        each.reset(seed=0)
    env.reset(options={"estimates": np.zeros((5, 5))})
    env.reset()
    undisturbed.reset()
    assert np.array_equal(env.estimates, undisturbed.estimates)


# --- the end of an episode --------------------------------------------------------------------------------------------


def ends(env, **reset):
    """Length, terminated, truncated and infos of an episode of zeros."""
    env.reset(**reset)
    length = 0
    for _ in while_running(env):
        _, _, terminations, truncations, infos = env.step(constant_actions(env, 0.0))
        length += 1
        assert len(set(terminations.values())) == len(set(truncations.values())) == 1
        assert terminations.keys() == truncations.keys() == infos.keys() == set(env.possible_agents)
    return length, terminations["player_0"], truncations["player_0"], infos["player_0"]


@pytest.mark.parametrize(
    ("max_cycles", "length", "terminated", "truncated"),
    [(None, 12, True, False), (13, 12, True, False), (12, 12, True, False), (11, 11, False, True), (1, 1, False, True)],
)
def test_reaching_the_end_is_termination_and_an_earlier_cut_is_truncation(max_cycles, length, terminated, truncated):
    env = make_env("energy", steps=8, hold_steps=4, max_cycles=max_cycles)
    assert ends(env)[:3] == (length, terminated, truncated)
    assert ends(env)[:3] == (length, terminated, truncated)  # the count starts afresh


def test_nothing_ends_before_the_last_step():
    env = make_env("energy", steps=5)
    env.reset()
    for _ in range(4):
        _, _, terminations, truncations, infos = env.step(constant_actions(env, 0.0))
        assert not any(terminations.values())
        assert not any(truncations.values())
        assert not any(info["is_success"] for info in infos.values())
        assert env.agents == env.possible_agents


@pytest.mark.parametrize("max_cycles", [None, 3])
def test_success_is_reported_at_every_end(max_cycles):
    env = make_env("energy", max_cycles=max_cycles, steps=4)
    near = np.tile(env.nash_equilibrium, (5, 1))
    direction = np.ones((5, 5)) * np.linalg.norm(env.nash_equilibrium) / np.sqrt(5)
    for distance, success in [(0.0049, True), (0.0051, False), (0.0, True)]:
        info = ends(env, options={"estimates": near + distance * direction})[3]
        assert info["is_success"] == success


def test_success_requires_all_estimates():
    env = make_env("energy", steps=1)
    table = np.where(np.eye(5, dtype=bool), env.nash_equilibrium, 0.0)
    info = ends(env, options={"estimates": table})[3]
    assert np.array_equal(env.strategies, env.nash_equilibrium)
    assert not info["is_success"]


def crash(env):
    """The result of the step that leaves the range."""
    env.reset(seed=0)
    return env.step(constant_actions(env, env.layout.action_bound))


@pytest.mark.parametrize("interface", ["physical", "scaled"])
def test_divergence_ends_the_episode_with_finite_values(interface):
    env = make_env("non-quadratic", input_limit=1e7, interface=interface, action_scale=1e7)
    observations, rewards, terminations, truncations, infos = crash(env)
    assert all(terminations.values())
    assert not any(truncations.values())
    assert env.agents == []
    for agent in env.possible_agents:
        assert infos[agent]["diverged"]
        assert not infos[agent]["is_success"]
        assert env.observation_space(agent).contains(observations[agent])
        assert np.isfinite(rewards[agent])
        assert rewards[agent] < 0
    assert env.state_space.contains(env.state())
    assert np.all(np.isfinite(env.estimates))
    observations, _ = env.reset()
    assert np.array_equal(env.estimates, PAPER_START)
    _, _, _, _, infos = env.step(constant_actions(env, 0.0))
    assert not infos["player_0"]["diverged"]


# --- observations, infos and spaces -----------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", INTERFACES, ids=lambda arguments: "-".join(arguments.values()))
@pytest.mark.parametrize("name", [*CATALOGUE, "blocks"])
def test_spaces_contain_all_that_an_episode_returns(name, arguments):
    scenario = BLOCKS if name == "blocks" else name
    env = make_env(scenario, start="random", steps=150, hold_steps=5, input_limit=20.0, **arguments)
    generator = np.random.default_rng(0)
    observations, infos = env.reset(seed=0)
    assert list(infos) == env.possible_agents
    for _ in range(env.world.clock.total_steps + 1):
        for agent in env.possible_agents:
            assert observations[agent].dtype == np.float32
            assert env.observation_space(agent).contains(observations[agent])
        assert env.state().dtype == np.float32
        assert env.state_space.contains(env.state())
        if not env.agents:
            break
        observations, rewards, terminations, truncations, infos = env.step(random_actions(env, generator))
        for agent in env.possible_agents:
            assert type(rewards[agent]) is float
            assert type(terminations[agent]) is type(truncations[agent]) is bool
            assert all(np.isfinite(value) for value in infos[agent].values())


def test_spaces_belong_to_one_agent_of_one_environment_and_stay_the_same():
    first, second = make_env("energy"), make_env("energy")
    agents = first.possible_agents
    for name in ("observation_space", "action_space"):
        spaces = [getattr(env, name)(agent) for env in (first, second) for agent in agents]
        assert len({id(space) for space in spaces}) == 10
        again = [getattr(env, name)(agent) for env in (first, second) for agent in agents]
        assert all(space is other for space, other in zip(spaces, again, strict=True))
        assert all(space == spaces[0] for space in spaces)
        first.reset(seed=0)
        assert getattr(first, name)("player_0") is spaces[0]


def test_agents_are_players_numbered_from_zero():
    env = make_env(BLOCKS)
    assert env.agents == []
    assert env.possible_agents == ["player_0", "player_1", "player_2"]
    env.reset()
    assert env.agents == env.possible_agents
    assert env.num_agents == env.max_num_agents == 3


def test_the_global_state_holds_estimates_links_and_clock():
    env = make_env("energy-switching", start="random")
    env.reset(seed=0)
    for _ in range(70):
        env.step(constant_actions(env, 1.0))
    clock = env.world.clock
    active = env.world.topology.graphs[int(env.world.modes[70])].adjacency
    times = [clock.t[70] / 1.2, clock.s[70], clock.theta[70], clock.dt[70] / 1.2]
    expected = np.concatenate([env.estimates.ravel(), active.ravel(), times]).astype(np.float32)
    assert np.array_equal(env.state(), expected)
    assert env.state_space.shape == expected.shape
    assert env.time == clock.t[70]


def test_clipped_entries_are_counted_per_agent():
    env = make_env("energy", input_limit=10.0)
    env.reset()
    actions = constant_actions(env, 10.0)
    actions["player_1"][:3] = 10.5
    actions["player_3"][4] = -11
    infos = env.step(actions)[4]
    assert [infos[agent]["clipped"] for agent in env.possible_agents] == [0, 3, 0, 1, 0]
    moved = env.estimates - PAPER_START
    assert np.abs(moved).max() == pytest.approx(10 * env.world.clock.theta[0])


def test_the_hold_phase_starts_at_the_deadline_with_constant_s():
    env = make_env("energy", hold_steps=3)
    observations, _ = env.reset()
    seen = []
    for _ in while_running(env):
        observations = env.step(constant_actions(env, 0.0))[0]
        seen.append(env.layout.select(observations["player_0"], "clock"))
    mean = env.world.clock.theta[:400].mean()
    at_deadline, first_hold, second_hold, terminal = seen[-4], seen[-3], seen[-2], seen[-1]
    assert at_deadline[0] == 1.0
    assert at_deadline[1] == first_hold[1] == second_hold[1] == terminal[1] == 8.0
    for clock in (at_deadline, first_hold, second_hold):
        assert clock[2] == pytest.approx(mean, rel=1e-6)
        assert clock[3] == pytest.approx(mean / 20 / 1.2, rel=1e-6)
    assert terminal[2:].tolist() == [0, 0]
    assert terminal[0] == pytest.approx(1 + 3 * mean / 20 / 1.2, rel=1e-6)


def test_estimates_at_the_deadline_are_those_of_the_last_step():
    plain, held = make_env("energy"), make_env("energy", hold_steps=40)
    arrived, _ = play(plain, laws.Static(plain.layout))
    states, _ = play(held, laws.Static(held.layout))
    assert np.array_equal(states[:401], arrived)
    equilibrium = held.nash_equilibrium
    assert np.linalg.norm(states[-1] - equilibrium) < 0.5 * np.linalg.norm(states[400] - equilibrium)


# --- aliasing ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("name", ["energy", "energy-switching", BLOCKS], ids=name_of)
def test_returned_arrays_never_change_and_are_not_shared(name, interface):
    env = make_env(name, interface=interface, steps=30, start="random", input_limit=5.0)
    record = [env.reset(seed=0)]
    kept = [copy.deepcopy(record[0])]
    generator = np.random.default_rng(0)
    for _ in while_running(env):
        result = (*env.step(random_actions(env, generator)), env.state(), env.estimates, env.strategies)
        record.append(result)
        kept.append(copy.deepcopy(result))
    env.reset()
    assert same(record, kept)
    arrays = list(arrays_in(record))
    for index, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[index + 1 : index + 40])
        assert not np.shares_memory(array, env._simulation.state.estimates)


@pytest.mark.parametrize("name", ["energy", "energy-switching"])
def test_writing_into_returned_arrays_changes_nothing(name):
    env, undisturbed = (make_env(name, steps=30, start="random", input_limit=5.0) for _ in range(2))
    generators = [np.random.default_rng(0) for _ in range(2)]
    record = undisturbed.reset(seed=0)
    vandalised = env.reset(seed=0)
    for _ in while_running(undisturbed):
        assert same(record, vandalised)
        for array in [*arrays_in(vandalised), env.state(), env.estimates, env.strategies, env.nash_equilibrium]:
            array[...] = np.float32(77)
        for value in vandalised:
            value.clear()
        actions = random_actions(env, generators[0])
        vandalised = env.step(actions)
        for action in actions.values():
            action[:] = 55
        record = undisturbed.step(random_actions(undisturbed, generators[1]))
    assert same(record, vandalised)


def pickled(env):
    return pickle.loads(pickle.dumps(env))  # noqa: S301 - our own bytes


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickled], ids=["copy", "deepcopy", "pickle"])
@pytest.mark.parametrize("name", ["energy", "energy-switching-transformed", BLOCKS], ids=name_of)
def test_a_copy_continues_identically_and_independently(name, duplicate):
    env = make_env(name, steps=150, start="random", input_limit=5.0, reward={"digits": 1.0, "payoff": 0.1})
    env.reset(seed=0)
    go_on(env, 25, np.random.default_rng(1))
    twin = duplicate(env)
    ours = [go_on(env, 150, np.random.default_rng(2)), env.reset(), go_on(env, 3, np.random.default_rng(3))]
    theirs = [go_on(twin, 150, np.random.default_rng(2)), twin.reset(), go_on(twin, 3, np.random.default_rng(3))]
    assert len(ours[0]) == 125
    assert same(ours, theirs)


# --- bad input --------------------------------------------------------------------------------------------------------


def changed(agent, action):
    def change(actions):
        return {**actions, agent: action}

    return change


def without(agent):
    return lambda actions: {name: action for name, action in actions.items() if name != agent}


def spoiled(value):
    action = np.zeros(5, dtype=np.float32)
    action[3] = value
    return action


BAD_ACTIONS = {
    "NaN": (changed("player_2", spoiled(np.nan)), "action of player_2 is not finite; expected numbers without NaN"),
    "infinite": (changed("player_4", spoiled(np.inf)), "action of player_4 is not finite"),
    "minus infinite": (changed("player_0", spoiled(-np.inf)), "action of player_0 is not finite"),
    "too short": (
        changed("player_1", np.zeros(4, dtype=np.float32)),
        r"action of player_1 has the shape \(4,\); expected \(5,\)",
    ),
    "too deep": (changed("player_1", np.zeros((1, 5), dtype=np.float32)), r"shape \(1, 5\); expected \(5,\)"),
    "scalar": (changed("player_1", np.float32(0)), r"shape \(\); expected \(5,\)"),
    "masked": (
        changed("player_3", np.ma.masked_array(np.zeros(5, dtype=np.float32), mask=[1, 0, 0, 0, 0])),
        "player_3 is a masked array; expected a plain one",
    ),
    "booleans": (changed("player_3", np.zeros(5, dtype=np.bool_)), "player_3 has the dtype bool; expected numbers"),
    "strings": (changed("player_3", np.array(["a"] * 5)), "player_3 has the dtype <U1; expected numbers"),
    "objects": (changed("player_3", np.array([None] * 5)), "player_3 has the dtype object; expected numbers"),
    "complex": (changed("player_3", np.zeros(5, dtype=np.complex64)), "dtype complex64; expected numbers"),
    "nothing": (changed("player_3", None), "player_3 has the dtype object; expected numbers"),
    "missing agent": (without("player_3"), "one action per live agent; missing: player_3; unknown: none; live: pl"),
    "unknown agent": (changed("player_9", spoiled(0)), "missing: none; unknown: player_9; live: player_0, player_1"),
    "a list": (lambda actions: list(actions.values()), "a dictionary with one action per agent, got a list"),
    "no agents": (lambda actions: {}, "missing: player_0, player_1, player_2, player_3, player_4"),
}


@pytest.mark.parametrize("name", BAD_ACTIONS)
def test_a_bad_action_is_refused_by_agent_and_changes_nothing(name):
    spoil, message = BAD_ACTIONS[name]
    env, undisturbed = (make_env("energy-switching", start="random", steps=60, input_limit=9.0) for _ in range(2))
    for each in (env, undisturbed):
        each.reset(seed=0)
        go_on(each, 20, np.random.default_rng(0))
    with pytest.raises(ValueError, match=message):
        env.step(spoil(constant_actions(env, 0.5)))
    generators = [np.random.default_rng(1) for _ in range(2)]
    ours = [go_on(env, 60, generators[0]), env.reset(), go_on(env, 3, generators[0])]
    theirs = [go_on(undisturbed, 60, generators[1]), undisturbed.reset(), go_on(undisturbed, 3, generators[1])]
    assert len(ours[0]) == 40
    assert same(ours, theirs)


BAD_RESETS = {
    "estimates of another shape": ({"options": {"estimates": np.zeros((5, 4))}}, r"shape \(N, n\) = \(5, 5\), got \(5"),
    "estimates that are NaN": ({"options": {"estimates": np.full((5, 5), np.nan)}}, "must be finite and within"),
    "estimates of unequal rows": ({"options": {"estimates": [[1.0, 2.0], [3.0]]}}, r"\(N, n\) table of numbers"),
    "estimates that are words": ({"options": {"estimates": [["a"]]}}, r"\(N, n\) table of numbers"),
    "estimates that are nothing": ({"options": {"estimates": [[None, {}]]}}, r"\(N, n\) table of numbers"),
    "estimates out of range": ({"options": {"estimates": np.full((5, 5), 1e6)}}, "must be finite and within"),
    "negative seed": ({"seed": -1}, "a seed is a whole number of at least 0 or None"),
    "fractional seed": ({"seed": 1.5}, "a seed is a whole number of at least 0 or None"),
    "good seed, bad estimates": ({"seed": 3, "options": {"estimates": [[1.0]]}}, r"got \(1, 1\)"),
    "good seed, estimates out of range": (
        {"seed": 3, "options": {"estimates": np.full((5, 5), -1e6)}},
        "must be finite and within",
    ),
}


@pytest.mark.parametrize("scenario", ["energy", "random-energy"])
@pytest.mark.parametrize("name", BAD_RESETS)
def test_a_bad_reset_is_refused_and_changes_nothing(name, scenario):
    arguments, message = BAD_RESETS[name]
    env, undisturbed = (make_env(scenario, start="random", steps=30, input_limit=9.0) for _ in range(2))
    for each in (env, undisturbed):
        each.reset(seed=0)
        go_on(each, 10, np.random.default_rng(0))
    with pytest.raises(ValueError, match=message):
        env.reset(**arguments)
    generators = [np.random.default_rng(1) for _ in range(2)]
    ours = [go_on(env, 60, generators[0]), env.reset(), go_on(env, 3, generators[0])]
    theirs = [go_on(undisturbed, 60, generators[1]), undisturbed.reset(), go_on(undisturbed, 3, generators[1])]
    assert len(ours[0]) == 20
    assert same(ours, theirs)


def test_a_step_before_reset_or_after_the_end_asks_for_reset():
    env = make_env("energy", steps=1)
    actions = {agent: np.zeros(5, dtype=np.float32) for agent in env.possible_agents}
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step\(\)"):
        env.step(actions)
    env.reset()
    env.step(actions)
    arrived = env.estimates
    with pytest.raises(RuntimeError, match=r"no episode is running: call reset\(\)"):
        env.step(actions)
    assert np.array_equal(env.estimates, arrived)


@pytest.mark.parametrize(
    "view", [lambda env: env.estimates, lambda env: env.strategies, lambda env: env.time, lambda env: env.state()]
)
def test_properties_before_reset_ask_for_reset(view):
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        view(make_env("energy"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "enrgy"}, "unknown scenario 'enrgy'; did you mean 'energy'"),
        ({"interface": "global"}, "unknown interface 'global'; choose from physical, local, learner, full"),
        ({"interface": "full"}, "for oracles in evaluations only; choose 'physical', 'local' or 'learner'"),
        ({"action_mode": "torque"}, "unknown action mode 'torque'; choose from input, gains"),
        ({"action_scale": -1.0}, "action_scale must be a finite number above 0"),
        ({"reward": "score"}, "unknown reward 'score'; choose from digits, tracking, payoff, regret"),
        ({"max_cycles": 0}, "max_cycles must be a whole number of at least 1"),
        ({"max_cycles": 1.5}, "max_cycles must be a whole number"),
        ({"steps": 0}, r"steps \(K\) must be a whole number of at least 1"),
        ({"deadline": 0.0}, r"deadline must be .* above 0 \(T, in seconds\)"),
    ],
)
def test_invalid_arguments_are_refused_with_advice(arguments, message):
    with pytest.raises(ValueError, match=message):
        ptne_env.parallel_env(**arguments)


def test_float64_actions_are_accepted():
    env, other = make_env("energy"), make_env("energy")
    env.reset()
    other.reset()
    actions = random_actions(env, np.random.default_rng(0))
    env.step(actions)
    other.step({agent: action.astype(np.float64) for agent, action in actions.items()})
    assert np.array_equal(env.estimates, other.estimates)


def test_order_of_the_actions_does_not_matter():
    env, other = make_env("energy"), make_env("energy")
    env.reset()
    other.reset()
    actions = random_actions(env, np.random.default_rng(0))
    env.step(actions)
    other.step(dict(reversed(actions.items())))
    assert np.array_equal(env.estimates, other.estimates)


def test_reward_and_interface_do_not_change_the_physics():
    inputs = np.random.default_rng(0).uniform(-1, 1, (20, 5, 5)).astype(np.float32)
    ends_at = []
    for arguments in ({}, {"reward": "payoff"}, {"reward": {"tracking": 2.0, "regret": 1.0}}, {"max_cycles": 500}):
        env = make_env("energy", **arguments)
        env.reset(seed=0)
        for step in inputs:
            env.step(dict(zip(list(env.agents), step, strict=True)))
        ends_at.append(env.estimates)
    assert all(np.array_equal(ends_at[0], other) for other in ends_at)


def test_custom_scenario_is_an_environment_too():
    scenario = get_scenario("energy", name="my own", steps=7)
    env = ptne_env.parallel_env(scenario, hold_steps=2)
    assert env.scenario == scenario.replace(hold_steps=2)
    assert ends(env)[0] == 9


def test_a_start_with_gradients_out_of_range_is_refused():
    env = ptne_env.parallel_env("non-quadratic")
    env.reset(seed=0)
    before = env.estimates
    with pytest.raises(ValueError, match="start closer"):
        env.reset(options={"estimates": np.full((5, 5), 200.0)})
    np.testing.assert_array_equal(env.estimates, before)


# --- state ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["energy-switching", "random-energy-switching"])
def test_setting_a_state_continues_the_episode_from_it(name):
    env = ptne_env.parallel_env(name)
    env.reset(seed=1)
    law = laws.Static(env.layout)

    def advance(steps):
        seen = []
        for _ in range(steps):
            actions = law.predict(env._simulation.observe()[0])[0]
            observations, rewards, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
            seen.append((np.stack(list(observations.values())).tobytes(), tuple(rewards.values())))
        return seen

    advance(30)
    saved = env.get_state()
    first = advance(5)
    assert env.get_state().step[0] == 35
    env.set_state(saved)
    assert advance(5) == first


def test_setting_a_state_sets_the_live_agents():
    env = ptne_env.parallel_env("energy", steps=3)
    env.reset(seed=1)
    first = env.get_state()
    while env.agents:
        env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})
    last = env.get_state()
    env.set_state(first)
    assert env.agents == env.possible_agents
    env.set_state(last)
    assert env.agents == []


def test_planning_on_a_state_leaves_the_environment_alone():
    env = ptne_env.parallel_env("energy")
    env.reset(seed=1)
    state, estimates = env.get_state(), env.estimates
    for _ in range(3):
        state = dynamics.step(env.world, state, np.ones_like(state.estimates))
    assert np.array_equal(env.estimates, estimates)
    assert env.get_state().step[0] == 0


def test_a_state_of_another_size_is_refused_and_the_state_stays():
    env, other = ptne_env.parallel_env("energy"), ptne_env.parallel_env("robots")
    env.reset(seed=1)
    other.reset(seed=1)
    before = env.get_state()
    with pytest.raises(ValueError, match=r"estimates of shape \(5, 5, 1\), got \(10, 5, 1\)"):
        env.set_state(other.get_state())
    assert env.get_state() is before


@pytest.mark.parametrize(
    ("track", "other", "message"),
    [
        ("nominal", "markov", "random draws, active graphs"),
        ("markov", "unseen-graphs", "active graphs"),
        ("noise", "nominal", "random draws, received messages"),
        ("nominal", "noise", "random draws, received messages"),
    ],
)
def test_a_state_of_another_world_is_refused(track, other, message):
    suite = get_suite("ptne-v1")
    env, foreign = (ptne_env.parallel_env(suite.track(name).scenario) for name in (track, other))
    env.reset(seed=1)
    foreign.reset(seed=1)
    before = env.get_state()
    with pytest.raises(ValueError, match=f"of another world: its {message} are not those of scenario '{track}'"):
        env.set_state(foreign.get_state())
    assert env.get_state() is before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": np.array([10**6])}, r"0 to 400, got \[1000000\]"),
        ({"step": np.array([-5])}, r"0 to 400, got \[-5\]"),
        ({"estimates": np.full((5, 5, 1), np.nan)}, "finite"),
    ],
)
def test_a_damaged_state_is_refused_and_the_state_stays(changes, message):
    env = ptne_env.parallel_env("energy")
    env.reset(seed=1)
    before = env.get_state()
    with pytest.raises(ValueError, match=message):
        env.set_state(before._replace(**changes))
    with pytest.raises(ValueError, match="got NoneType"):
        env.set_state(None)
    assert env.get_state() is before


def reachable(array):
    """The array and all arrays that it is a view of."""
    while isinstance(array, np.ndarray):
        yield array
        array = array.base


@pytest.mark.parametrize("make", [ptne_env.parallel_env, aec_env])
def test_an_agents_observation_leads_to_no_other_array(make):
    env, action = make("energy"), np.zeros(5, dtype=np.float32)
    started = env.reset(seed=0)
    for _ in range(3):
        if make is aec_env:
            observations = [env.observe(agent) for agent in env.agents]
            for _ in env.agents:
                env.step(action)
        else:
            observations = list(started[0].values())
            started = env.step(dict.fromkeys(env.agents, action))
        for observation in observations:
            assert all(array.size == observation.size for array in reachable(observation))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_a_copy_in_mid_episode_observes_on_its_own(copied):
    env, undisturbed = (ptne_env.parallel_env("energy") for _ in range(2))
    for each in (env, undisturbed):
        each.reset(seed=0)
    twin = copied(env)
    actions = {agent: np.ones(5, dtype=np.float32) for agent in env.agents}
    expected = [undisturbed.step(actions)[0] for _ in range(2)]
    for each in (env, twin):
        for observations in expected:
            mine = each.step(actions)[0]
            assert all(np.array_equal(mine[agent], observations[agent]) for agent in mine)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_a_copy_of_the_turn_based_form_steps_on_its_own(copied):
    env, undisturbed = (aec_env("random-energy") for _ in range(2))
    for each in (env, undisturbed):
        each.reset(seed=0)
        each.step(np.ones(5, dtype=np.float32))
    twin = copied(env)
    assert twin.agent_selection == "player_1"
    for each in (undisturbed, env, twin):
        for _ in range(7):
            each.step(np.ones(5, dtype=np.float32))
    expected = undisturbed.last()
    assert same(env.last(), expected)
    assert same(twin.last(), expected)


# --- the habits of other libraries ------------------------------------------------------------------------------------


@pytest.mark.parametrize("reward", ["digits", {"tracking": 1.0, "payoff": 1e-3}])
def test_infos_are_the_same_numpy_scalars_from_reset_to_end(reward):
    env = make_env("random-energy", steps=4, reward=reward)
    infos, seen = env.reset(seed=0)[1], []
    while True:
        seen += [[(name, type(value)) for name, value in infos[agent].items()] for agent in env.possible_agents]
        if not env.agents:
            break
        infos = env.step(constant_actions(env, 1e4))[4]
    weights = [reward] if isinstance(reward, str) else reward
    terms = [(f"reward_{name}", np.float64) for name in weights]
    expected = [("diverged", np.bool_), ("clipped", np.int64), ("is_success", np.bool_), *terms]
    assert seen == [expected] * 25
    assert all(info["clipped"] == 5 for info in infos.values())


def test_an_info_that_a_caller_changes_is_not_that_of_another_agent():
    env = make_env("energy")
    infos = env.reset(seed=0)[1]
    infos["player_0"]["note"] = 1
    assert "note" not in infos["player_1"]


def test_an_unknown_keyword_is_a_type_error_that_names_similar_ones_or_all():
    with pytest.raises(TypeError, match="parallel_env.* unexpected keyword argument 'stps'; did you mean 'steps'"):
        ptne_env.parallel_env("energy", stps=3)
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'; choose from scenario, interface, .*"):
        aec_env("energy", frameskip=1)


def test_the_generator_for_wrappers_is_seeded_and_changes_no_episode():
    env, undisturbed = (make_env("random-energy") for _ in range(2))
    assert isinstance(env.np_random, np.random.Generator)
    drawn = []
    for _ in range(2):
        for each in (env, undisturbed):
            each.reset(seed=3)
        drawn.append(env.np_random.random())
        assert same(env.reset(), undisturbed.reset())
    assert drawn[0] == drawn[1]


def test_no_actions_after_the_end_return_empty_dictionaries():
    env = make_env("energy", steps=1)
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        env.step({})
    env.reset()
    with pytest.raises(ValueError, match="missing: player_0"):
        env.step({})
    env.step(constant_actions(env, 0.0))
    assert env.step({}) == ({}, {}, {}, {}, {})
    assert env.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.parametrize("dtype", [np.int64, np.int8, np.uint16])
def test_integer_actions_are_the_same_as_floats(dtype):
    env, other = make_env("energy"), make_env("energy")
    for each in (env, other):
        each.reset(seed=0)
    actions = {agent: np.arange(5, dtype=dtype) for agent in env.agents}
    floats = {agent: action.astype(np.float32) for agent, action in actions.items()}
    assert same(env.step(actions), other.step(floats))
    actions["player_2"] = floats["player_2"]
    assert same(env.step(actions), other.step(floats))


def test_frame_skip_of_supersuit_repeats_actions():
    supersuit = need_sb3("supersuit")
    env, plain = supersuit.frame_skip_v0(make_env("energy"), (2, 4)), make_env("energy")
    for each in (env, plain):
        each.reset(seed=0)
    env.step(constant_actions(env, 1.0))
    skipped = int(env.unwrapped._simulation.current.step[0])
    assert skipped in (2, 3, 4)
    for _ in range(skipped):
        plain.step(constant_actions(plain, 1.0))
    assert np.array_equal(env.unwrapped.estimates, plain.estimates)


def test_black_death_of_supersuit_ends():
    env = need_sb3("supersuit").black_death_v3(make_env("energy", steps=3))
    env.reset(seed=0)
    steps = 0
    while env.agents:
        env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})
        steps += 1
        assert steps < 10
    assert steps == 4  # the wrapper asks once more after the end


@pytest.mark.parametrize("name", ["non-quadratic", "non-quadratic-switching", "non-quadratic-printed"])
def test_random_play_of_the_non_quadratic_game_stays_in_range(name):
    env = make_env(name)
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    high = env.action_space("player_0").high
    while env.agents:
        infos = env.step({agent: generator.uniform(-high, high).astype(np.float32) for agent in env.agents})[4]
    assert not infos["player_0"]["diverged"]
    assert int(env.get_state().step[0]) == 400


def test_inputs_beyond_the_action_space_are_not_clipped_up_to_the_input_limit():
    env = make_env("non-quadratic")
    env.reset()
    infos = env.step(constant_actions(env, 30.0))[4]
    assert env.action_space("player_0").high.tolist() == [10.0] * 5
    assert infos["player_0"]["clipped"] == 0
    assert (env.estimates - PAPER_START).max() == pytest.approx(30 * env.world.clock.theta[0])
