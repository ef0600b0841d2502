import numpy as np
import pytest
from worlds import BLOCKS, constant_actions, make_env, while_running

from ptne_env import get_scenario
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import distances, dynamics
from ptne_env.world.rewards import TERMS, Reward, measure_distances
from ptne_env.world.world import RANGE_LIMIT, World

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


def strategies(world, state):
    owners = world.game.owners
    return state.estimates[np.arange(owners.size), owners]


def savings(world, played):
    """What a best response of each player would save it."""
    game = world.game
    response, saved = game.best_response(played), []
    for i in range(game.num_players):
        deviated = np.where((game.owners == i)[:, None], response, played)
        saved.append(game.costs(played)[i] - game.costs(deviated)[i])
    return np.array(saved)


def regrets_of_order_one(world, state):
    """What best responses would save, over the mean of it where each component is off by ‖x*‖/√n."""
    equilibrium = world.game.nash_equilibrium[:, None]
    away = savings(world, equilibrium + np.sqrt((equilibrium**2).mean()))
    return savings(world, strategies(world, state)) / away.mean()


FORMULAS = {
    "digits": (lambda w, before, after: np.log10(distance(w, before)) - np.log10(distance(w, after)), 1e-12),
    "tracking": (lambda w, before, after: -distance(w, after), 0),
    "payoff": (lambda w, before, after: -w.game.costs(strategies(w, after)), 0),
    "regret": (lambda w, before, after: -regrets_of_order_one(w, after), 1e-10),
}
"""Every term once more, from the world and the states before and after a step, and the slack of its comparison."""


@pytest.mark.parametrize("game", GAMES)
@pytest.mark.parametrize("name", TERMS)
def test_a_term_is_that_of_an_independent_formula(name, game):
    assert name in FORMULAS, f"the reward {name} is new: write its formula down once more, in FORMULAS"
    formula, slack = FORMULAS[name]
    world, _, states, terms = episode(GAMES[game], name)
    for before, after, term in zip(states[:-1], states[1:], terms, strict=True):
        assert term[name] == pytest.approx(formula(world, before, after), rel=1e-12, abs=slack)


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


def test_a_mixed_reward_is_the_weighted_sum_of_unweighted_terms():
    weights = {name: 1 / (1 + place) for place, name in enumerate(TERMS)}
    _, judge, _, terms = episode(GAMES["energy"], weights)
    alone = {name: episode(GAMES["energy"], name)[3] for name in weights}
    for k, term in enumerate(terms):
        assert list(term) == list(weights)
        for name in weights:
            assert np.array_equal(term[name], alone[name][k][name])
        assert judge.total(term) == pytest.approx(sum(weights[name] * term[name] for name in weights), rel=1e-14)


@pytest.mark.parametrize("game", GAMES)
@pytest.mark.parametrize("name", TERMS)
def test_the_worst_value_is_the_limit_of_the_values_in_range(name, game):
    world, term, generator = World(GAMES[game]), TERMS[name], np.random.default_rng(0)
    shape = world.game.dimension, world.game.num_players, 100
    corners, inside = generator.choice((-1.0, 1.0), shape), generator.uniform(-1, 1, shape)
    together = np.ones(shape) * np.where(np.arange(100) % 2, -1.0, 1.0)
    estimates = RANGE_LIMIT * np.concatenate([corners, inside, together], axis=2)
    state = dynamics.begin(world, estimates, world.game, None)._replace(any_diverged=False)
    values, worst = term.value(state, measure_distances(state)), term.worst(world.game)
    assert (values >= worst).all()
    assert values.min() <= worst / 4


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


def test_divergence_is_charged_once_for_the_remaining_steps():
    world = World(get_scenario("energy", steps=20, start="random"))
    judge, rest = Reward(world, EVERY_TERM), np.zeros((5, 5, 1))
    before = dynamics.step(world, dynamics.initial_state(world, rest), rest)
    judge.reset(before)
    after = dynamics.step(world, before, rest + 1e9)
    charged, later = judge.step(after), judge.step(dynamics.step(world, after, rest))
    for name, term in TERMS.items():
        worst = term.worst(world.game)
        lost = worst - term.value(before, measure_distances(before)) if term.is_gain else 19 * worst
        assert charged[name] == pytest.approx(np.broadcast_to(lost, (5, 1)), rel=1e-12)
        assert (charged[name] < 0).all()
        assert (later[name] == 0).all()


def digits_gained(before, after, world):
    """The term ``digits`` as a function of a user, which serves numpy and JAX."""
    return distances.digits(measure_distances(after)) - distances.digits(measure_distances(before))


def test_a_function_pays_for_each_step_and_a_team_is_paid_alike():
    _, _, _, terms = episode(GAMES["energy"], digits_gained)
    _, _, _, expected = episode(GAMES["energy"], "digits")
    assert all(np.array_equal(term["function"], row["digits"]) for term, row in zip(terms, expected, strict=True))
    _, judge, _, terms = episode(GAMES["energy"], lambda before, after, world: after.own_gradients.sum(axis=0), steps=1)
    assert judge.total(terms[0]).shape == (5, 3)
    assert (np.ptp(judge.total(terms[0]), axis=0) == 0).all()


@pytest.mark.parametrize("wrong", [np.zeros((3, 5)), np.full((5, 3), np.nan), 0.0, None], ids=str)
def test_a_function_that_returns_something_else_is_refused(wrong):
    with pytest.raises(ValueError, match=r"returns finite numbers, \(5, 3\) or \(3,\), got"):
        episode(GAMES["energy"], lambda before, after, world: wrong)


def test_a_function_pays_for_the_step_that_diverges_and_nothing_afterwards():
    world = World(get_scenario("energy", start="random"))
    judge, rest = Reward(world, lambda before, after, world: -1.0 - after.diverged), np.zeros((5, 5, 1))
    before = dynamics.initial_state(world, rest)
    judge.reset(before)
    after = dynamics.step(world, before, rest + 1e9)
    assert (judge.step(after)["function"] == -2).all()
    assert (judge.step(dynamics.step(world, after, rest))["function"] == 0).all()
