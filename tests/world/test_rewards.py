import numpy as np
import pytest
from worlds import BLOCKS, constant_actions, make_env, while_running

from ptne_env import get_scenario
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics
from ptne_env.world.rewards import REWARD_LIMIT, TERMS, Reward
from ptne_env.world.world import World

EVERY_TERM = dict.fromkeys(TERMS, 1.0)
GAMES = {"energy": get_scenario("energy", start="random"), "blocks": BLOCKS}


def episode(scenario, reward, steps=25, batch=3):
    """States along a random walk, and the terms of each step."""
    world = World(scenario)
    judge = Reward(world, reward)
    generator = np.random.default_rng(0)
    states = [dynamics.initial_state(world, world.draw_estimates([RandomStreams.from_seed(b) for b in range(batch)]))]
    judge.reset(states[0])
    terms = []
    for _ in range(steps):
        states.append(dynamics.step(world, states[-1], generator.normal(size=states[-1].estimates.shape)))
        terms.append(judge.step(states[-1]))
    return world, judge, states, terms


def distance(world, state):
    equilibrium = world.game.nash_equilibrium
    error = state.estimates - equilibrium[:, None, None]
    return np.sqrt((error**2).sum(axis=0)) / np.linalg.norm(equilibrium)


@pytest.mark.parametrize("name", GAMES)
def test_digits_telescope_to_the_digits_gained(name):
    world, _, states, terms = episode(GAMES[name], "digits")
    gained = sum(term["digits"] for term in terms)
    expected = np.log10(distance(world, states[0])) - np.log10(distance(world, states[-1]))
    assert gained == pytest.approx(expected, abs=1e-12)


def test_digits_count_no_further_than_twelve():
    world = World(get_scenario("energy"))
    judge = Reward(world)
    equilibrium = np.repeat(world.game.nash_equilibrium[:, None, None], 5, axis=1)
    state = dynamics.initial_state(world, equilibrium * 1.1)
    judge.reset(state)
    arrived = dynamics.step(world, state, (equilibrium - state.estimates) / world.clock.theta[0])
    first = judge.step(arrived)["digits"]
    assert first == pytest.approx(np.full((5, 1), 11.0), abs=1e-9)
    assert judge.step(dynamics.step(world, arrived, np.zeros_like(equilibrium)))["digits"].tolist() == [[0.0]] * 5


@pytest.mark.parametrize("name", GAMES)
def test_tracking_is_minus_the_distance_after_the_step(name):
    world, _, states, terms = episode(GAMES[name], "tracking")
    for state, term in zip(states[1:], terms, strict=True):
        assert term["tracking"] == pytest.approx(-distance(world, state), rel=1e-12)


@pytest.mark.parametrize("name", GAMES)
def test_payoff_is_minus_the_cost_of_the_real_strategies(name):
    world, _, states, terms = episode(GAMES[name], "payoff")
    owners = world.game.owners
    for state, term in zip(states[1:], terms, strict=True):
        strategies = state.estimates[np.arange(owners.size), owners]
        assert np.array_equal(term["payoff"], -world.game.costs(strategies))


@pytest.mark.parametrize("name", GAMES)
def test_regret_is_minus_the_gain_of_a_best_response(name):
    world, _, states, terms = episode(GAMES[name], "regret")
    game, owners = world.game, world.game.owners
    for state, term in zip(states[1:], terms, strict=True):
        strategies = state.estimates[np.arange(owners.size), owners]
        response = game.best_response(strategies)
        for i in range(game.num_players):
            deviated = np.where((owners == i)[:, None], response, strategies)
            loss = game.costs(strategies)[i] - game.costs(deviated)[i]
            assert term["regret"][i] == pytest.approx(-loss, abs=1e-10)
        assert np.all(term["regret"] <= 1e-12)


def test_a_mixed_reward_is_the_weighted_sum_of_unweighted_terms():
    weights = {"digits": 2.0, "tracking": 0.5, "payoff": 1e-3, "regret": 0.25}
    _, judge, _, terms = episode(GAMES["energy"], weights)
    alone = {name: episode(GAMES["energy"], name)[3] for name in weights}
    for k, term in enumerate(terms):
        assert list(term) == list(weights)
        for name in weights:
            assert np.array_equal(term[name], alone[name][k][name])
        assert judge.total(term) == pytest.approx(sum(weights[name] * term[name] for name in weights), rel=1e-14)


def returns_of(env, act):
    """The sums of all terms, players by terms, when ``act(k)`` are the actions of step k; divergence; length."""
    total, infos = 0.0, {}
    for k in while_running(env):
        infos = env.step(act(k))[4]
        terms = [[value for name, value in info.items() if name.startswith("reward_")] for info in infos.values()]
        total = total + np.array(terms)
    return total, infos["player_0"]["diverged"], k + 1


@pytest.mark.parametrize("crash_at", [0, 3, 18])
def test_divergence_never_pays(crash_at):
    env = make_env("energy", steps=20, reward=EVERY_TERM, input_limit=1e7)
    theta = env.world.clock.theta
    brink = 1.9e5  # own gradients are 2.6 times a strategy that all share, so this is just inside the range

    def after(continuation):
        env.reset()
        return returns_of(env, lambda k: constant_actions(env, 0.0 if k < crash_at else continuation(k)))

    crash, diverged, length = after(lambda k: 1e7)
    assert diverged
    assert length == crash_at + 1
    for name, continuation in {
        "nothing": lambda k: 0.0,
        "to the brink": lambda k: brink / theta[crash_at:].sum(),
        "to the brink at once": lambda k: brink / theta[k] if k == crash_at else 0.0,
        "to the other brink": lambda k: -brink / theta[crash_at:].sum(),
    }.items():
        survivor, gone, _ = after(continuation)
        assert not gone, name
        assert (crash < survivor).all(), name


def test_divergence_of_one_player_is_charged_to_all_players():
    env = make_env("non-quadratic", steps=40, reward=dict.fromkeys(["digits", "tracking", "payoff"], 1.0))
    near = np.tile(env.nash_equilibrium, (5, 1)) + 1e-3

    def push(by):
        env.reset(options={"estimates": near})
        actions = constant_actions(env, 0.0)
        actions["player_1"][1] = by  # its own gradient leaves the range, every other estimate stays
        return returns_of(env, lambda k: actions)

    (crash, diverged, _), (survivor, gone, _) = push(1000.0), push(0.0)
    assert (diverged, gone) == (True, False)
    assert (crash < survivor - 5).all()


def test_divergence_is_charged_for_the_remaining_steps():
    env = make_env("energy", steps=20, reward=EVERY_TERM, input_limit=1e9)
    env.reset()
    env.step(constant_actions(env, 0.0))
    infos = env.step(constant_actions(env, 1e9))[4]
    worst = {"tracking": dynamics.distance_limit(env.world.game)[0], "payoff": REWARD_LIMIT, "regret": REWARD_LIMIT}
    for info in infos.values():
        assert -6 < info["reward_digits"] < 0
        for name, limit in worst.items():
            assert info[f"reward_{name}"] == pytest.approx(-19 * limit, rel=1e-12)
