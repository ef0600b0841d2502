import numpy as np
import pytest
from worlds import PAPER_START

from ptne_env import FactorySpec, get_scenario
from ptne_env.world.starts import FixedStart, PaperStart, UniformStart
from ptne_env.world.world import World


def generator(seed=0):
    return np.random.default_rng(seed)


def test_paper_start_is_the_table_of_the_paper():
    assert np.array_equal(PaperStart().draw(5, 5, generator()), PAPER_START.T)


def test_columns_of_a_draw_are_rows_of_the_table():
    table = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert np.array_equal(FixedStart(table).draw(2, 3, generator()), np.transpose(table))


def test_fixed_start_returns_a_new_array_for_each_draw():
    start = FixedStart([[1.0, 2.0], [3.0, 4.0]])
    start.draw(2, 2, generator())[:] = 99
    assert np.array_equal(start.draw(2, 2, generator()), [[1.0, 3.0], [2.0, 4.0]])
    assert not start.is_random


def test_uniform_start_fills_exactly_its_interval():
    draws = UniformStart().draw(50, 60, generator())
    assert draws.shape == (60, 50)
    assert -20 <= draws.min() < -19.9
    assert 19.9 < draws.max() <= 20
    assert draws.mean() == pytest.approx(0, abs=1)
    assert UniformStart(2.0, 3.0).draw(4, 4, generator()).min() >= 2.0


def test_uniform_start_has_a_range_per_component():
    start = FactorySpec.of("start:uniform", low=0.0, high=np.array([1.0, 10.0, 0.1])).build()
    draws = start.draw(400, 3, generator())
    assert draws.min(axis=1) == pytest.approx(0, abs=0.1)
    assert draws.max(axis=1) == pytest.approx([1.0, 10.0, 0.1], rel=0.02)
    assert np.array_equal(
        UniformStart([-2.0] * 3, 3.0).draw(5, 3, generator()), UniformStart(-2.0, 3.0).draw(5, 3, generator())
    )
    with pytest.raises(ValueError, match="this start has bounds for 3 components, the game has 5"):
        World(get_scenario("energy", start=start))


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (1.0, 1.0),
        (2.0, 1.0),
        (float("nan"), 1.0),
        (0.0, float("inf")),
        (0.0, [1.0, -1.0]),
        (0.0, np.ones((2, 2))),
        ([0.0, 0.0], [1.0, 2.0, 3.0]),
    ],
)
def test_empty_or_infinite_intervals_are_refused(low, high):
    with pytest.raises(ValueError, match="finite low < high"):
        UniformStart(low, high)


@pytest.mark.parametrize("table", [[[1.0, 2.0], [3.0]], [1.0, 2.0], [[1.0, float("nan")]]])
def test_tables_that_are_not_finite_rectangles_are_refused(table):
    with pytest.raises(ValueError, match="FixedStart needs"):
        FixedStart(table)


@pytest.mark.parametrize("players", [2, 6, 9])
def test_the_papers_start_goes_on_for_other_numbers_of_players(players):
    estimates = PaperStart().draw(players, players, generator()).T
    for player, row in enumerate(estimates):
        assert row[player] == -2.0 * (player + 1)
        assert np.delete(row, player).tolist() == [5.0 * rest for rest in range(players - 2, -1, -1)]


def test_the_papers_start_needs_one_component_per_player():
    with pytest.raises(ValueError, match="the game has 3 players and 6 components; choose start='random'"):
        PaperStart().draw(3, 6, generator())
