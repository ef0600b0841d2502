"""Games with several equilibria, sparse games and saturating games: exact equilibria and distances to the nearest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_games import generators
from scipy import optimize
from worlds import make_env

from ptne_env import FactorySpec, evaluate, get_scenario, theory
from ptne_env.field.games import (
    CoordinationGame,
    RandomCoordination,
    RandomSaturating,
    RandomSparse,
    SaturatingGame,
    SparseGame,
)
from ptne_env.games import AffineGame, EnergyGame, MovedGame, RandomAffine
from ptne_env.world import distances

FAMILIES = {
    "sparse": RandomSparse(players=20),
    "saturating": RandomSaturating(RandomAffine(action_dim=(1, 2, 3, 1, 2))),
}


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES.keys())
def test_equilibria_are_those_that_a_solver_finds(family):
    game = family.draw(generators([3]))
    found = optimize.root(lambda x: game.pseudo_gradient(x[:, None])[:, 0], np.zeros(game.dimension), tol=1e-13)
    assert game.nash_equilibrium == pytest.approx(found.x, abs=1e-8)
    assert game.best_response(game.nash_equilibria) == pytest.approx(game.nash_equilibria, abs=1e-9)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES.keys())
def test_jacobian_and_best_response_follow_from_the_costs(family):
    games, generator = family.draw(generators(range(3))), np.random.default_rng(0)
    x, move = generator.uniform(-9, 9, (2, games.dimension, 3))
    step = 1e-6
    slope = (games.pseudo_gradient(x + step * move) - games.pseudo_gradient(x - step * move)) / (2 * step)
    assert np.einsum("ijb,jb->ib", games.jacobian(x), move) == pytest.approx(slope, abs=1e-5)
    response = games.best_response(x)
    for player in range(games.num_players):
        own = (games.owners == player)[:, None]
        best = games.costs(np.where(own, response, x))[player]
        for _ in range(20):
            other = np.where(own, response + generator.normal(size=x.shape), x)
            assert (games.costs(other)[player] >= best - 1e-9 * (1 + np.abs(best))).all()


def test_sparse_game_equals_the_affine_game_of_its_matrix():
    game, x = RandomSparse(players=9, reach=1).draw(generators([5])), np.random.default_rng(0).normal(size=(9, 4))
    matrix = game.jacobian(np.zeros((9, 1)))[..., 0]
    assert (np.count_nonzero(matrix, axis=1) == 3).all()
    dense = AffineGame(matrix, game.offset[:, 0])
    assert game.costs(x) == pytest.approx(dense.costs(x), abs=1e-12)
    assert game.best_response(x) == pytest.approx(dense.best_response(x), abs=1e-12)
    assert game.nash_equilibrium == pytest.approx(dense.nash_equilibrium, abs=1e-12)


def test_sparse_games_have_the_promised_monotonicity():
    games = RandomSparse(players=50, reach=2, coupling=0.8).draw(generators(range(20)))
    jacobians = np.moveaxis(games.jacobian(games.nash_equilibria), 2, 0)
    assert np.linalg.eigvalsh((jacobians + jacobians.transpose(0, 2, 1)) / 2).min() >= 0.2


def test_saturating_game_without_bend_is_affine():
    flat, affine = (family.draw(generators([1])) for family in (RandomSaturating(bend=0.0), RandomAffine()))
    x = np.random.default_rng(0).normal(size=(5, 3))
    assert flat.pseudo_gradient(x) == pytest.approx(affine.pseudo_gradient(x), abs=1e-12)
    bent = RandomSaturating().draw(generators([1]))
    assert not np.allclose(bent.jacobian(x)[..., 0], bent.jacobian(x)[..., 1], atol=0.1)


def test_saturating_games_have_the_sampled_constants_that_are_promised():
    game = RandomSaturating(RandomAffine(epsilon=0.7)).representative
    constants = theory.monotonicity_constants(game)
    assert constants.epsilon >= 0.7
    assert (
        constants.iota_strategies
        <= np.linalg.norm(game.matrix[..., 0], 2) + np.linalg.norm(game.prices[..., 0], 2) ** 2
    )


@given(seed=st.integers(0, 2**32 - 1), players=st.integers(2, 8), steepness=st.floats(0.2, 5.0))
def test_coordination_games_have_their_three_equilibria_and_no_other(seed, players, steepness):
    game = RandomCoordination(players=players, steepness=steepness).draw(generators([seed]))
    known = np.concatenate([game.nash_equilibria[None], game.other_equilibria])[..., 0]
    assert known.shape == (3, players)
    generator = np.random.default_rng(seed)
    for _ in range(5):
        start = game.middle[:, 0] + 2 * game.size[:, 0] * generator.uniform(-1, 1, players)
        found = optimize.root(lambda x: game.pseudo_gradient(x[:, None])[:, 0], start, tol=1e-12)
        if found.success and np.abs(found.fun).max() < 1e-10:
            assert np.abs(known - found.x).max(axis=1).min() < 1e-3


def test_distances_are_those_to_the_nearest_equilibrium():
    games = RandomCoordination().draw(generators(range(4)))
    points = np.concatenate([games.nash_equilibria[None], games.other_equilibria])
    for point in points:
        near = point + 0.01
        assert games.nearest_equilibria(near) == pytest.approx(point)
        expected = 0.01 * np.sqrt(5) / games.equilibrium_scale
        assert distances.strategy_distance(near, games) == pytest.approx(expected)
        estimates = np.repeat(near[:, None], 5, axis=1)
        assert distances.estimate_distance(estimates, games) == pytest.approx(expected)
        assert distances.player_distances(estimates, games) == pytest.approx(np.tile(expected, (5, 1)))


def test_estimates_of_all_players_share_one_equilibrium():
    game = CoordinationGame()
    estimates = np.repeat(game.nash_equilibria[:, None], 5, axis=1)
    estimates[:, 4] = game.other_equilibria[1]
    found = distances.player_distances(estimates, game)[:, 0]
    assert found[:4] == pytest.approx([0, 0, 0, 0])
    assert found[4] == pytest.approx(np.linalg.norm(2 * game.size) / game.equilibrium_scale[0])


def test_a_single_game_serves_many_environments_with_several_equilibria():
    game = CoordinationGame()
    ends = np.stack([game.nash_equilibrium, game.other_equilibria[0, :, 0], game.other_equilibria[1, :, 0]], axis=1)
    assert game.nearest_equilibria(ends + 0.1) == pytest.approx(ends)


def test_games_with_one_equilibrium_measure_from_it_as_before():
    game = EnergyGame()
    assert game.other_equilibria is None
    assert game.nearest_equilibria(np.zeros((5, 7))) is game.nash_equilibria


def test_a_moved_game_moves_all_its_equilibria():
    game, offset = CoordinationGame(), np.arange(10.0).reshape(5, 2)
    moved = MovedGame(game, offset)
    for point in (game.nash_equilibria, *game.other_equilibria):
        assert moved.nearest_equilibria(point + offset + 0.1) == pytest.approx(point + offset)
    assert MovedGame(EnergyGame(), offset).other_equilibria is None


class WrongPoints(CoordinationGame):
    def _solve_other_equilibria(self):
        return super()._solve_other_equilibria() + 0.1


def test_a_point_that_is_no_equilibrium_is_refused():
    with pytest.raises(ArithmeticError, match="no Nash equilibrium was found"):
        _ = WrongPoints().other_equilibria


def test_gradient_play_settles_at_one_of_the_stable_equilibria():
    scenario = get_scenario(
        "random-energy", name="coordination", game=FactorySpec.of("ptne_env.field.games:RandomCoordination")
    )
    results = evaluate(["routed"], [scenario], episodes=20, against_laws=False)
    assert results.samples["coordination", "routed"]["digits"].min() > 11


def test_an_environment_succeeds_at_an_equilibrium_that_is_not_the_first():
    env = make_env("random-energy", game=FactorySpec.of("ptne_env.field.games:CoordinationGame"), steps=4)
    point = CoordinationGame().other_equilibria[1, :, 0]
    env.reset(options={"estimates": np.tile(point, (5, 1))})
    infos = None
    while env.agents:
        *_, infos = env.step({agent: np.zeros(env.action_space(agent).shape, np.float32) for agent in env.agents})
    assert all(info["is_success"] for info in infos.values())


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: CoordinationGame(size=(1.0, 2.0)), "one middle and one size per player"),
        (lambda: CoordinationGame(size=(1.0, 2.0, 3.0, 4.0, 0.0)), "size > 0"),
        (lambda: SparseGame([1.0, 1.0], [[1, 1]], [[0.1, 0.1]], [0.0, 0.0]), "partners are other players"),
        (lambda: SparseGame([1.0] * 3, [[1, 2, 0]] * 2, [[0.1] * 3] * 2, [0.0] * 3), "each at most once"),
        (lambda: SparseGame([1.0, 0.0], [[1, 0]], [[0.1, 0.1]], [0.0, 0.0]), "curvature > 0"),
        (lambda: SparseGame([1.0, 1.0], [[1, 0]], [[0.1]], [0.0, 0.0]), "partners and coupling"),
        (lambda: SaturatingGame(np.eye(2), np.ones((3, 1)), np.ones(3), np.ones(2)), r"prices are \(m, 2\)"),
    ],
)
def test_wrong_parameters_are_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()
