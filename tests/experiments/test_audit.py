"""The rows that an audit of decisions sees."""

import numpy as np
import pytest

from ptne_env.experiments.audit import OWN_LINKS_EPISODES, WITNESSES, rows_of_one, sample_rows


@pytest.mark.parametrize(("episodes", "players"), [(1, 5), (200, 1), (40, 5), (40, 20), (40, 50)])
def test_a_thorough_audit_sees_every_player_and_no_teammates_together(episodes, players):
    rows = np.array(sample_rows(episodes, players, thorough=True))
    assert rows.shape == (min(players, WITNESSES), episodes)
    assert len(np.unique(rows)) == rows.size
    assert all(len(np.unique(of_one // players)) == episodes for of_one in rows)
    assert len(np.unique(rows % players)) == players


@pytest.mark.parametrize(("episodes", "players"), [(1, 5), (200, 1), (200, 50), (200, 3)])
def test_an_audit_sees_one_player_of_every_episode_and_all_players_equally(episodes, players):
    (rows,) = sample_rows(episodes, players, thorough=False)
    assert sorted(rows // players) == list(range(episodes))
    seen = np.bincount(rows % players, minlength=players)
    assert seen.max() - seen.min() <= 1


def test_rows_are_chosen_afresh():
    assert len({tuple(sample_rows(20, 5, thorough=False)[0]) for _ in range(10)}) == 10


@pytest.mark.parametrize("episodes", [3, 200])
def test_a_witness_of_own_links_gets_rows_of_one_player(episodes):
    place, rows = rows_of_one(episodes, 5)
    assert set(rows % 5) == {place}
    assert len(np.unique(rows)) == len(rows) == min(episodes, OWN_LINKS_EPISODES)
    assert rows.max() < 5 * episodes
    assert {rows_of_one(episodes, 5)[0] for _ in range(200)} == set(range(5))
