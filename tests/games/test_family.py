import numpy as np
import pytest
from sample_games import generators
from worlds import make_env

from ptne_env import FactorySpec, get_scenario
from ptne_env.games import (
    CoupledConstraint,
    EnergyGame,
    Market118,
    NonQuadraticGame,
    RandomAffine,
    RandomEnergy,
    RandomSaturating,
    require_strong_monotonicity,
)
from ptne_env.shared.arrays import replace_columns
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.theory import monotonicity_constants
from ptne_env.world.world import World

PARAMETERS = ("curvature", "target", "coupling")

DRAWN = {
    "energy, 2 players": RandomEnergy(2),
    "affine": RandomAffine(),
    "affine, planar, in a box": RandomAffine(players=3, action_dim=2, low=-5.0, high=5.0),
    "affine, players of different dimensions": RandomAffine(action_dim=(1, 2, 3, 1, 2)),
    "merely monotone": RandomAffine(epsilon=0.0),
    "coupled constraint on energy": CoupledConstraint(RandomEnergy()),
    "market": Market118(),
    "saturating": RandomSaturating(RandomEnergy(4)),
    "saturating, players of different dimensions": RandomSaturating(RandomAffine(players=3, action_dim=(2, 1, 3))),
}
each_family = pytest.mark.parametrize("family", DRAWN.values(), ids=DRAWN.keys())


def merge(old, fresh, mask):
    return old.map_columns(lambda before, after: replace_columns(before, after, mask), fresh)


def parameters(game):
    return [getattr(game, name) for name in game.parameters]


def same_games(first, second):
    return all(map(np.array_equal, parameters(first), parameters(second)))


def test_draws_fill_exactly_their_ranges():
    game = RandomEnergy(players=7).draw(generators(range(2000)))
    assert game.curvature.shape == game.target.shape == (7, 2000)
    assert game.coupling.shape == (2000,)
    assert game.base_price == 10.0
    for name, low, high in [("curvature", 0.5, 2.0), ("target", 5.0, 35.0), ("coupling", 0.05, 0.3)]:
        values = getattr(game, name)
        margin = 0.02 * (high - low)
        assert low <= values.min() < low + margin
        assert high - margin < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=2 * margin)


@each_family
def test_batch_of_games_equals_single_draws_bit_for_bit(family):
    games, batch = family.draw(generators(range(6))), 6
    assert games.batch_size == batch
    estimates = np.random.default_rng(8).uniform(-9, 9, (games.dimension, games.num_players, batch))
    strategies = np.ascontiguousarray(estimates[:, 0])
    for b in range(batch):
        alone, own = family.draw(generators([b])), slice(b, b + 1)
        assert alone.batch_size == 1
        assert all(
            np.array_equal(one[..., 0], many[..., b])
            for one, many in zip(parameters(alone), parameters(games), strict=True)
        )
        assert np.array_equal(alone.nash_equilibrium, games.nash_equilibria[:, b])
        assert alone.equilibrium_scale[0] == games.equilibrium_scale[b]
        responses = ("regrets", "best_response") if games.has_best_response else ()
        for of in ("costs", "pseudo_gradient", "natural_residual", "jacobian", *responses):
            together = getattr(games, of)(strategies)[..., b]
            assert np.array_equal(getattr(alone, of)(strategies[:, own].copy())[..., 0], together), of
        gradients = alone.own_gradients(np.ascontiguousarray(estimates[..., own]))
        assert np.array_equal(gradients[:, 0], games.own_gradients(estimates)[:, b])


def test_batch_of_games_has_no_single_equilibrium():
    with pytest.raises(ValueError, match="batch of 3 games has nash_equilibria"):
        _ = RandomEnergy().draw(generators(range(3))).nash_equilibrium


@each_family
def test_merged_replaces_the_masked_games_in_a_copy(family):
    old, fresh, expected = (family.draw(generators(seeds)) for seeds in (range(5), [10, 11], [0, 10, 2, 3, 11]))
    kept = [values.copy() for values in (*parameters(old), *parameters(fresh))]
    merged = merge(old, fresh, np.array([False, True, False, False, True]))
    assert same_games(merged, expected)
    assert np.array_equal(merged.nash_equilibria, expected.nash_equilibria)
    assert all(map(np.array_equal, kept, (*parameters(old), *parameters(fresh))))


@each_family
def test_declared_monotonicity_agrees_with_sampled_jacobians(family):
    slopes = [monotonicity_constants(family.draw(generators([seed]))).epsilon for seed in range(10)]
    if family.is_strongly_monotone is not False:
        assert min(slopes) > (0.043 if isinstance(family, Market118) else 0.15)  # 2 q + β, q = 0.01, β = 0.0232
        if family.is_strongly_monotone is None:
            require_strong_monotonicity(family.draw(generators(range(10))))
    else:
        smallest = np.linalg.eigvalsh(symmetric_parts(family.draw(generators(range(10)))))[:, 0]
        assert np.abs(smallest).max() < 1e-12
        assert np.abs(slopes).max() < 1e-12


def symmetric_parts(games):
    """(dF + dFᵀ)/2 of affine games, shape (G, n, n)."""
    jacobians = np.moveaxis(games.jacobian(np.zeros((games.dimension, games.batch_size))), 2, 0)
    return (jacobians + jacobians.transpose(0, 2, 1)) / 2


def test_worlds_play_families_that_declare_that_they_are_not_strongly_monotone():
    env = make_env("random-energy", game=FactorySpec.of("game:random-saturating"))
    env.reset(seed=0)
    assert np.isfinite(env.nash_equilibrium).all()
    env = make_env("random-energy", game=FactorySpec.of("game:random-affine", epsilon=0.0))
    env.reset(seed=0)
    assert np.isfinite(env.nash_equilibrium).all()


@pytest.mark.parametrize(
    ("family", "arguments", "message"),
    [
        (RandomAffine, {"action_dim": (1, 2)}, r"one number for all, or one per player \(5\), got \(1, 2\)"),
        (RandomAffine, {"epsilon": -1.0}, "epsilon must be a finite number of at least 0"),
        (
            RandomSaturating,
            {"affine": RandomAffine(epsilon=0.0)},
            "affine games without bounds that are strongly monotone",
        ),
        (RandomSaturating, {"affine": RandomAffine(low=0.0)}, "affine games without bounds"),
        (RandomSaturating, {"bend": -1.0}, "bend must be"),
    ],
)
def test_families_name_wrong_numbers(family, arguments, message):
    with pytest.raises(ValueError, match=message):
        family(**arguments)


def test_merging_keeps_the_price_and_refuses_other_games():
    family = RandomEnergy(base_price=3.0)
    game = family.draw(generators(range(2)))
    mask = np.array([True, False])
    assert merge(game, family.draw(generators([9])), mask).base_price == 3.0
    assert merge(game, EnergyGame(), mask).targets[:, 0].tolist() == [10, 15, 20, 25, 30]
    for first, second in [(game, NonQuadraticGame()), (game, HiddenGame()), (HiddenGame(), game)]:
        with pytest.raises(TypeError, match=r"a batch of games of the same class and players, got \w+, \w+"):
            merge(first, second, mask)
    single = NonQuadraticGame()
    assert merge(single, single, mask) is single
    with pytest.raises(TypeError, match="got NonQuadraticGame, NonQuadraticGame"):
        merge(single, NonQuadraticGame(), mask)


def test_single_game_uses_no_random_numbers():
    game, generator = EnergyGame(), np.random.default_rng(0)
    assert game.draw([generator, generator]) is game
    assert generator.random() == np.random.default_rng(0).random()


def test_game_that_is_not_strongly_monotone_is_named():
    game = TwistedGames(*(getattr(RandomEnergy().draw(generators(range(6))), name) for name in PARAMETERS))
    with pytest.raises(ValueError, match=r"game 4 of the batch is not strongly monotone: ε = -1\b"):
        require_strong_monotonicity(game)


def test_strong_monotonicity_needs_an_affine_game():
    with pytest.raises(ValueError, match="strong monotonicity of HiddenGame cannot be decided: F is not affine"):
        require_strong_monotonicity(HiddenGame())


def test_environment_refuses_a_draw_that_is_not_strongly_monotone():
    env = make_env("random-energy", game=FactorySpec.of("test_family:TwistedFamily"))
    with pytest.raises(ValueError, match="game 0 of the batch is not strongly monotone"):
        env.reset(seed=0)
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        _ = env.estimates


class HiddenGame(EnergyGame):
    """An energy game that is not declared affine."""

    is_affine = False


class TwistedGames(EnergyGame):
    """The second to last game of the batch has dF = −I."""

    def jacobian(self, strategies):
        jacobian = super().jacobian(strategies)
        jacobian[:, :, -2 if self.batch_size > 1 else 0] = -np.eye(self.num_players)
        return jacobian


class TwistedFamily(RandomEnergy):
    def draw(self, generators):
        game = super().draw(generators)
        return TwistedGames(*(getattr(game, name) for name in PARAMETERS))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"players": 1}, "players must be a whole number of at least 2, got 1"),
        ({"curvature": (2.0, 1.0)}, r"finite range low < high for curvature, got \(2.0, 1.0\)"),
        ({"coupling": (0.1, float("inf"))}, "finite range low < high for coupling"),
        ({"curvature": (0.0, 1.0)}, "curvature > 0"),
        ({"coupling": (-0.1, 0.1)}, "coupling ≥ 0"),
        ({"base_price": float("nan")}, "finite parameters"),
    ],
)
def test_empty_ranges_and_invalid_games_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        RandomEnergy(**arguments)


# --- random streams ---------------------------------------------------------------------------------------------------


def episodes(**fields):
    """Games and starts of four episodes in three environments."""
    world = World(get_scenario("random-energy", **fields))
    streams = [RandomStreams.from_seed(seed) for seed in range(3)]
    return [(world.draw_game(streams), world.draw_estimates(streams)) for _ in range(4)]


def test_draws_of_games_starts_and_graphs_do_not_depend_on_each_other():
    switching = {"topology": get_scenario("energy-switching").topology}
    narrow = FactorySpec.of("start:uniform", low=0.0, high=1.0)
    other = FactorySpec.of("game:random-energy", coupling=(0.0, 9.0))
    expected, starts, games = episodes(), episodes(start=narrow, **switching), episodes(game=other, **switching)
    assert all(same_games(ours[0], theirs[0]) for ours, theirs in zip(starts, expected, strict=True))
    assert not np.array_equal(starts[0][1], expected[0][1])
    assert all(np.array_equal(ours[1], theirs[1]) for ours, theirs in zip(games, expected, strict=True))
    assert not same_games(games[0][0], expected[0][0])
    assert not same_games(expected[0][0], expected[1][0])  # another episode is another game
