"""The PettingZoo environment's own facts; what all adapters promise is in test_adapters.py."""

import numpy as np
import pytest
from test_adapters import same
from worlds import BLOCKS, FAULTY, constant_actions, make_env, while_running

import ptne_env
from ptne_env import laws
from ptne_env.envs.parallel import aec_env
from ptne_env.games import EnergyGame


def test_options_set_the_start():
    env = make_env(BLOCKS)
    table = np.arange(18.0).reshape(3, 6)
    env.reset(options={"estimates": table})
    assert np.array_equal(env.estimates, table)
    table[:] = 0
    assert env.estimates[2, 5] == 17.0
    env.reset(options={"estimates": (np.ones((3, 6))).tolist()})
    assert np.all(env.estimates == 1)
    env.reset(seed=0, options={"options": 1})  # as PettingZoo's conformance tests do


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


@pytest.mark.parametrize("max_cycles", [4, 3])
def test_success_of_all_estimates_is_reported_at_every_end(max_cycles):
    env = make_env("energy", max_cycles=max_cycles, steps=4)
    near = np.tile(env.nash_equilibrium, (5, 1))
    direction = np.ones((5, 5)) * np.linalg.norm(env.nash_equilibrium) / np.sqrt(5)
    for distance, success in [(0.0049, True), (0.0051, False), (0.0, True)]:
        length, terminated, truncated, info = ends(env, options={"estimates": near + distance * direction})
        assert (length, terminated, truncated) == (max_cycles, max_cycles == 4, max_cycles == 3)
        assert info["is_success"] == success

    env = make_env("energy", steps=1)  # all estimates have to arrive, not the strategies alone
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
    with pytest.raises(KeyError, match="unknown agent 'player_99': agents are player_0 to "):
        env.action_space("player_99")
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
        first.reset(seed=0)
        assert getattr(first, name)("player_0") is spaces[0]


def test_agents_are_players_numbered_from_zero():
    env = make_env(BLOCKS)
    assert env.agents == []
    assert env.possible_agents == ["player_0", "player_1", "player_2"]
    env.reset()
    assert env.agents == env.possible_agents
    assert env.num_agents == env.max_num_agents == 3
    assert str(env) == f"ptne_{BLOCKS.name}_v0"


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


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda good: {}, "missing: player_0"),
        (lambda good: {**good, "player_99": good["player_0"]}, "player_99"),
        (lambda good: list(good.values()), "list"),
        (lambda good: {**good, "player_3": None}, "player_3"),
        (lambda good: {**good, "player_3": np.zeros((1, 5))}, "player_3"),
    ],
)
def test_joint_actions_of_other_players_or_shapes_are_refused(spoil, message):
    env = make_env("energy")
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.step(spoil(constant_actions(env, 0.0)))


def test_order_of_the_actions_does_not_matter():
    env, other = make_env("energy"), make_env("energy")
    env.reset()
    other.reset()
    actions = {agent: np.full(5, index, dtype=np.float32) for index, agent in enumerate(env.agents)}
    env.step(actions)
    other.step(dict(reversed(actions.items())))
    assert np.array_equal(env.estimates, other.estimates)


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
    before = env._simulation.current
    with pytest.raises(ValueError, match="another world: its random draws, active graphs, received messages are not"):
        env.set_state(foreign.get_state())
    assert env._simulation.current is before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": np.array([10**6])}, r"0 to 400, got \[1000000\]"),
        ({"step": np.array([-5])}, r"0 to 400, got \[-5\]"),
        ({"estimates": np.full((5, 5, 1), np.nan)}, "finite"),
        ({"estimates": np.zeros((5, 5, 1), dtype=object)}, r"has estimates of shape \(5, 5, 1\) .*, got object"),
        ({"step": np.array([3.0])}, r"has step of shape \(1,\) and a dtype of kind 'iu', got float64"),
        ({"step": 3}, r"has step of shape \(1,\) .*, got int64 of shape \(\)"),
        ({"own_gradients": None}, "has own_gradients of shape"),
        ({"game": "energy"}, "the game of a state is a Game, got a str"),
    ],
)
def test_a_damaged_state_is_refused_and_the_state_stays(changes, message):
    env = ptne_env.parallel_env("energy")
    env.reset(seed=1)
    before = env._simulation.current
    with pytest.raises(ValueError, match=message):
        env.set_state(before._replace(**changes))
    with pytest.raises(ValueError, match="got NoneType"):
        env.set_state(None)
    assert env._simulation.current is before


def test_a_state_shares_no_array_with_the_environment():
    env, undisturbed = ptne_env.parallel_env("energy"), ptne_env.parallel_env("energy")
    for each in (env, undisturbed):
        each.reset(seed=1)
    given = env.get_state()
    assert given.game is env._simulation.current.game  # which need not be solved again
    given.estimates[...] = env.nash_equilibrium[:, None, None]
    given = undisturbed.get_state()
    env.set_state(given)
    given.estimates[...] = given.own_gradients[...] = 0
    actions = dict.fromkeys(env.agents, np.ones(5, dtype=np.float32))
    assert env.step(actions)[1] == undisturbed.step(actions)[1]


@pytest.mark.parametrize(("action", "fault"), [(np.full(5, np.nan), "is not finite"), (np.zeros(4), "has the shape")])
def test_a_wrong_action_in_turns_is_refused_at_once_and_the_player_may_act_again(action, fault):
    """PettingZoo's conversion keeps it until the last player has acted, and then nobody can correct it."""
    env, good = aec_env("energy"), np.zeros(5, dtype=np.float32)
    env.reset(seed=1)
    env.step(good)
    with pytest.raises(ValueError, match=f"the action of player_1 {fault}"):
        env.step(action)
    for agent in env.agents[1:]:
        assert env.agent_selection == agent
        env.step(good)
    assert env.unwrapped.time > 0


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
    env.step(constant_actions(env, 0.0))
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_a_state_with_another_game_plays_it_at_once():
    env, other = ptne_env.parallel_env("energy"), EnergyGame(target=(30.0, 25.0, 20.0, 15.0, 10.0))
    env.reset(seed=1)
    env.set_state(env.get_state()._replace(game=other))
    assert np.array_equal(env.nash_equilibrium, other.nash_equilibrium)
    assert np.array_equal(env.get_state().own_gradients, other.own_gradients(env.get_state().estimates))
    rewards = env.step(constant_actions(env, 0.0))[1]
    assert list(rewards.values()) == [0.0] * 5  # nobody moved, so no digit is gained by the change
    env.reset()
    assert np.array_equal(env.nash_equilibrium, EnergyGame().nash_equilibrium)


def test_a_game_whose_gradients_leave_the_range_ends_the_episode():
    env = ptne_env.parallel_env("energy")
    env.reset(seed=1)
    env.set_state(env.get_state()._replace(game=EnergyGame(curvature=1e6)))
    assert env.agents == []
    assert env.get_state().any_diverged
