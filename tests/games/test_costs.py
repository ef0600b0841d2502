"""Games from their costs alone agree with the closed forms of the same games; the wrong ones are named."""

import pickle
import re

import numpy as np
import pytest
from derivatives import gradient_error
from sample_games import BlockGame, generators

import ptne_env
from ptne_env import FactorySpec
from ptne_env.games import (
    CostGame,
    EnergyGame,
    Game,
    GameFamily,
    NoBestResponseError,
    NonQuadraticGame,
    RandomAffine,
    RateControl,
    price_constraint,
)
from ptne_env.theory import check_costs
from ptne_env.world.graphs import path


def example_two(x):
    """The costs of Example 2, as a list of rows."""
    xp, (x1, x2, x3, x4, x5) = x.__array_namespace__(), x
    return [
        x1**2 / 2 + x1 * (x2 + x3 + x4 + x5),
        xp.exp(x2 / 2) / 2 + x2 * x4,
        x3**2 / 2 + x1**3,
        4 * x4 + x4**2 + x3**3,
        x5**2 - 5 * x5 + x1**3 * x2 + x3 * x4**4,
    ]


class Shadow(CostGame):
    """Another game, of which only the costs, the sizes and the bounds are told."""

    game: Game
    function = None

    @property
    def action_dims(self):
        return self.game.action_dims

    @property
    def low(self):
        return self.game.low

    @property
    def high(self):
        return self.game.high

    def costs(self, strategies):
        return self.game.costs(strategies)


BOXED = RandomAffine(players=3, action_dim=(2, 1, 3), low=-3.0, high=2.0).draw(generators([4]))
PAIRS = {
    "example 2": (CostGame(example_two, (1,) * 5), NonQuadraticGame()),
    "energy": (Shadow(game=EnergyGame()), EnergyGame()),
    "rates": (Shadow(game=RateControl()), RateControl()),
    "blocks": (Shadow(game=BlockGame()), BlockGame()),
    "blocks in a box": (Shadow(game=BOXED), BOXED),
}
each_pair = pytest.mark.parametrize(("game", "known"), PAIRS.values(), ids=PAIRS.keys())


def some_points(game, *shape):
    low, high = (np.where(np.isfinite(side), side, free) for side, free in zip(game.bounds, (-2, 2), strict=True))
    unit = np.random.default_rng(0).random((game.dimension, *shape))
    return (low + (high - low) * unit.reshape(game.dimension, -1)).reshape(unit.shape)


@each_pair
def test_derivatives_are_those_of_the_closed_form(game, known):
    estimates, points = some_points(game, game.num_players, 7), some_points(game, 7)
    np.testing.assert_allclose(game.own_gradients(estimates), known.own_gradients(estimates), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(game.jacobian(points), known.jacobian(points), rtol=1e-11, atol=1e-11)


@each_pair
def test_equilibrium_and_best_responses_are_those_of_the_closed_form(game, known):
    assert game.nash_equilibrium == pytest.approx(known.nash_equilibrium, rel=1e-12, abs=1e-12)
    if known.has_best_response:
        points = some_points(game, 20)
        assert game.best_response(points) == pytest.approx(known.best_response(points), rel=1e-11, abs=1e-11)
        assert game.regrets(points) == pytest.approx(known.regrets(points), rel=1e-11, abs=1e-11)


@each_pair
def test_no_number_depends_on_the_other_environments(game, known):
    estimates, points = some_points(game, game.num_players, 5), some_points(game, 5)
    assert np.array_equal(game.own_gradients(estimates)[:, 2:3], game.own_gradients(estimates[..., 2:3]))
    if known.has_best_response:
        assert np.array_equal(game.best_response(points)[:, 2:3], game.best_response(points[:, 2:3]))


def test_a_cost_without_a_minimum_has_no_best_response():
    game = PAIRS["example 2"][0]
    assert game.has_best_response  # at x*, where x4 = −2
    with pytest.raises(NoBestResponseError, match="no strategy of player 1 was found"):
        game.best_response(np.ones((5, 1)))


def two_valleys(x):
    """Each cost has a minimum near −1 and a lower one near 1; F vanishes at both."""
    return (x**2 - 1) ** 2 - 0.3 * x + 0.01 * x[::-1] * x


def lower_ends(x):
    """F vanishes at 0, a minimum of each cost, and each falls without end further out."""
    return x**2 - x**4 / 10


def matching(x):
    """x1 wants the sign of x2, and x2 the other one: wherever F vanishes, somebody has a better strategy."""
    valleys = (x**2 - 1) ** 2
    return [valleys[0] - x[0] * x[1], valleys[1] + x[0] * x[1]]


class Deep(CostGame):
    """A solver that stops in the upper valley."""

    action_dims = (1, 1)

    def costs(self, strategies):
        return two_valleys(strategies)

    def _solve_nash_equilibria(self):
        from ptne_env.games.variational import solve_box

        return solve_box(self.pseudo_gradient, self.jacobian, *self.bounds, -np.ones((2, 1)))


def test_a_second_minimum_is_no_equilibrium_where_a_lower_one_is_far_away():
    with pytest.raises(ArithmeticError, match=r"player \d lowers its cost from .* by .*so it is no Nash equilibrium"):
        Deep().nash_equilibrium  # noqa: B018 - the property raises
    assert np.all(CostGame(two_valleys, (1, 1)).nash_equilibrium > 0.9)


class DeepByHand(Game):
    """The same with gradients and best responses that are written by hand."""

    action_dims, low, high = (1, 1), -2.0, -0.1 + 2.1

    def costs(self, strategies):
        return two_valleys(strategies)

    def own_gradients(self, estimates):
        own, other = np.stack([estimates[0, 0], estimates[1, 1]]), np.stack([estimates[1, 0], estimates[0, 1]])
        return 4 * own * (own**2 - 1) - 0.3 + 0.01 * other

    def best_response(self, strategies):
        return np.ones_like(strategies)

    def _solve_nash_equilibria(self):
        return Deep._solve_nash_equilibria(self)


def test_best_responses_verify_equilibria_of_any_game():
    with pytest.raises(ArithmeticError, match="so it is no Nash equilibrium"):
        DeepByHand().nash_equilibrium  # noqa: B018 - the property raises


@pytest.mark.parametrize(
    ("costs", "message"),
    [
        (lower_ends, "no strategy was found that minimises the cost of player 0 .*; give low and high where a cost"),
        (lambda x: x**2 / 2 - 100 * x / (1 + x.sum(axis=0)), "no .* was found; give low and high where a cost"),
        (matching, "Nash equilibrium"),
    ],
)
def test_a_game_without_equilibrium_is_an_error(costs, message):
    with pytest.raises(ArithmeticError, match=message):
        CostGame(costs, (1, 1)).nash_equilibrium  # noqa: B018 - the property raises


def as_list(x):
    return [x[0] ** 2, x[1] ** 2, x[0]]


def logarithm(x):
    return x**2 - np.log(x)


def absolute(x):
    return abs(x - 0.3) ** 3


def by_float(x):
    return np.array([[float(value) ** 2 for value in row] for row in x])


def stored(x):
    costs = np.zeros(x.shape)
    costs[0], costs[1] = x[0] ** 2, x[1] ** 2
    return costs


@pytest.mark.parametrize(
    ("costs", "message"),
    [
        (as_list, r"CostGame.costs maps \(n, B\) = \(2, 16\) to \(N, B\) = \(2, 16\).*returned the shape \(3, 16\)"),
        (lambda x: x[2], r"CostGame.costs maps .*it raised IndexError"),
        (logarithm, r"the cost of player 0 is nan at x = .*bound the strategies"),
        (
            stored,
            r"test_costs.stored, cannot be differentiated.*a complex step gives another derivative of .* player 0",
        ),
        (by_float, r"test_costs.by_float.*"),
        (lambda x: np.abs(x - 0.3) ** 3, r"with JAX installed, abs\(x\) and .*, but not np\.abs\(x\)\. "),
        (lambda x: x**2 / 2 - x * 10 / (1 + x.sum() ** 2), r"of one environment depend on another: sum over axis=0"),
        (lambda x: np.random.default_rng().random(x.shape), "of one environment depend on another"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_wrong_costs_are_named(costs, message):
    with pytest.raises(ValueError, match=message):
        CostGame(costs, (1, 1))


def test_a_game_says_what_it_lacks():
    with pytest.raises(ValueError, match="at least 2 players"):
        CostGame(two_valleys)
    with pytest.raises(ValueError, match="action_dims is a tuple, a number for each of at least 2 players, got 6"):
        CostGame(two_valleys, action_dims=6)
    with pytest.raises(NotImplementedError, match=r"write costs\(x\), or pass a function"):
        CostGame(action_dims=(1, 1))


@pytest.mark.parametrize("costs", [absolute, lambda x: x.__array_namespace__().abs(x - 0.3) ** 3])
def test_costs_that_complex_numbers_cannot_have_are_differentiated_by_jax(costs):
    pytest.importorskip("jax", reason="needs the extra 'jax'")
    game, points = CostGame(costs, (1, 1)), some_points(Deep(), 9)
    expected = 3 * np.abs(points - 0.3) * (points - 0.3)
    np.testing.assert_allclose(game.pseudo_gradient(points), expected, rtol=1e-14)
    assert game.pseudo_gradient(points).dtype == np.float64
    assert game.nash_equilibrium == pytest.approx([0.3, 0.3], abs=1e-5)  # where the curvature is 0, too


def test_costs_that_neither_differentiates_are_named_with_both_reasons(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "jax", None)
    with pytest.raises(ValueError, match="absolute.*a complex step gives another.*JAX raised ModuleNotFoundError"):
        CostGame(absolute, (1, 1))


# --- parts ------------------------------------------------------------------------------------------------------------


def test_a_game_of_a_function_is_a_part_like_others():
    game = CostGame(example_two, (1,) * 5)
    spec = FactorySpec.of(game)
    assert spec.to_dict()["arguments"]["function"] == {"target": "test_costs:example_two", "arguments": {}}
    assert FactorySpec.from_dict(spec.to_dict()).build() == game
    assert pickle.loads(pickle.dumps(game)) == game  # noqa: S301 - our own
    assert hash(game) == hash(CostGame(example_two, (1,) * 5))


def test_a_function_of_costs_is_foreign_code():
    from ptne_env.shared.parts import foreign_targets

    spec = FactorySpec.of(CostGame(example_two, (1,) * 5))
    assert foreign_targets([spec, spec.to_dict()]) == ["test_costs:example_two"]


def test_it_plays_in_evaluate_as_the_closed_form_does():
    scenario = ptne_env.get_scenario("non-quadratic", steps=100)
    twin = scenario.replace(name="twin", game=CostGame(example_two, (1,) * 5))
    results = ptne_env.evaluate("static", [scenario, twin], episodes=2)
    digits = [results.record(name, "static", "digits")["mean"] for name in (scenario.name, "twin")]
    assert digits[0] == pytest.approx(digits[1], rel=1e-9)
    assert "regret" in {record["metric"] for record in results.records if record["track"] == "twin"}


def test_its_gradients_are_the_derivatives_of_its_costs():
    game = CostGame(two_valleys, (1, 1))
    assert gradient_error(game) < 1e-9
    assert not np.all(check_costs(game))


# --- families ---------------------------------------------------------------------------------------------------------


class Tastes(CostGame):
    """J_i = (x_i − b_i)² + ¼ x_i⁴ + x_i x_j / 2, a batch of games where b is (2, G)."""

    parameters = {"taste": 1}  # noqa: RUF012 - as every game
    action_dims = (1, 1)

    taste: np.ndarray

    def costs(self, strategies):
        taste = self.taste if self.taste.ndim == 2 else self.taste[:, None]
        return (strategies - taste) ** 2 + strategies**4 / 4 + strategies * strategies[::-1] / 2


class RandomTastes(GameFamily):
    is_strongly_monotone = True

    def draw(self, generators):
        return Tastes(taste=np.stack([generator.normal(size=2) for generator in generators], axis=1))


def test_a_batch_of_games_is_its_games():
    batch = RandomTastes().draw(generators(range(3)))
    estimates, points = some_points(batch, 2, 3), some_points(batch, 3)
    for index in range(3):
        single = Tastes(taste=batch.taste[:, index])
        own = slice(index, index + 1)
        assert np.array_equal(batch.own_gradients(estimates)[:, own], single.own_gradients(estimates[..., own]))
        assert batch.best_response(points)[:, own] == pytest.approx(single.best_response(points[:, own]), abs=1e-11)
        assert batch.nash_equilibria[:, index] == pytest.approx(single.nash_equilibrium, abs=1e-12)
    results = ptne_env.evaluate(
        "static",
        ptne_env.get_scenario(
            "energy",
            name="tastes",
            game=RandomTastes(),
            topology=path(2),
            steps=20,
            start="random",
        ),
        episodes=3,
    )
    assert not results.failures


# --- shared constraints -----------------------------------------------------------------------------------------------


def energy_costs(x):
    return EnergyGame().costs(x)


def within(x):
    return [x.sum(axis=0) - 40.0]


def within_a_ball(x):
    return [(x**2).sum(axis=0) - 400.0]


def test_a_linear_constraint_is_priced_as_that_of_an_affine_game():
    affine = price_constraint(EnergyGame(), np.ones((1, 5)), [40.0])
    players = CostGame(energy_costs, (1,) * 5)
    for game in (price_constraint(players, within), price_constraint(players, np.ones((1, 5)), [40.0])):
        assert game.nash_equilibrium == pytest.approx(affine.nash_equilibrium, rel=1e-10)
        estimates = some_points(game, 6, 4)
        assert game.own_gradients(estimates) == pytest.approx(affine.own_gradients(estimates), rel=1e-12, abs=1e-9)
        assert not game.has_best_response
        assert FactorySpec.of(game).build() == game


def test_a_curved_constraint_satisfies_the_conditions_of_the_variational_equilibrium():
    players = EnergyGame()
    game = price_constraint(players, within_a_ball)
    x, price = game.nash_equilibria[:5], game.nash_equilibria[5]
    assert price > 0.01
    assert within_a_ball(x)[0] == pytest.approx(0, abs=1e-8)
    assert players.pseudo_gradient(x) + price * 2 * x == pytest.approx(0, abs=1e-9)


def test_wrong_constraints_are_named():
    with pytest.raises(ValueError, match=re.escape("is a function of x or a matrix (m, 5), got (1, 4)")):
        price_constraint(CostGame(energy_costs, (1,) * 5), np.ones((1, 4)))
