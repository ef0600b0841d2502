"""The PettingZoo environment's own facts; what all adapters promise is in test_adapters.py."""

import numpy as np
import pytest
from extras import need_sb3
from test_adapters import same
from worlds import BLOCKS, FAULTY, PAPER_START, constant_actions, make_env, play, while_running

import ptne_env
from ptne_env import laws
from ptne_env.envs.turn_based import aec_env


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


def test_divergence_ends_the_episode_with_finite_values():
    env = make_env("non-quadratic", input_limit=1e7)
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
    env.reset()
    _, _, _, _, infos = env.step(constant_actions(env, 0.0))
    assert not infos["player_0"]["diverged"]


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


@pytest.mark.parametrize(
    "view", [lambda env: env.estimates, lambda env: env.strategies, lambda env: env.time, lambda env: env.state()]
)
def test_properties_before_reset_ask_for_reset(view):
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        view(make_env("energy"))


def test_order_of_the_actions_does_not_matter():
    env, other = make_env("energy"), make_env("energy")
    env.reset()
    other.reset()
    actions = {agent: np.full(5, index, dtype=np.float32) for index, agent in enumerate(env.agents)}
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


def test_a_start_with_gradients_out_of_range_is_refused():
    env = ptne_env.parallel_env("non-quadratic")
    env.reset(seed=0)
    before = env.estimates
    with pytest.raises(ValueError, match="start closer"):
        env.reset(options={"estimates": np.full((5, 5), 200.0)})
    np.testing.assert_array_equal(env.estimates, before)


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


@pytest.mark.parametrize(("name", "other"), [("random-energy", FAULTY), (FAULTY, "random-energy")], ids=str)
def test_a_state_of_another_world_is_refused(name, other):
    env, foreign = ptne_env.parallel_env(name), ptne_env.parallel_env(other)
    env.reset(seed=1)
    foreign.reset(seed=1)
    before = env.get_state()
    with pytest.raises(ValueError, match="another world: its random draws, active graphs, received messages are not"):
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


def test_inputs_beyond_the_action_space_are_not_clipped_up_to_the_input_limit():
    env = make_env("non-quadratic")
    env.reset()
    infos = env.step(constant_actions(env, 30.0))[4]
    assert env.action_space("player_0").high.tolist() == [10.0] * 5
    assert infos["player_0"]["clipped"] == 0
    assert (env.estimates - PAPER_START).max() == pytest.approx(30 * env.world.clock.theta[0])
