"""The rows that an audit of decisions sees."""

import numpy as np
import pytest

from ptne_env.experiments.audit import EPISODES, WITNESSES, sample_rows


@pytest.mark.parametrize(("episodes", "players"), [(1, 5), (200, 1), (40, 5), (40, 20), (40, 50)])
def test_a_thorough_audit_sees_every_player_and_no_teammates_together(episodes, players):
    rows = np.array(sample_rows(episodes, players, thorough=True))
    assert rows.shape == (min(players, WITNESSES), episodes)
    assert len(np.unique(rows)) == rows.size
    assert all(len(np.unique(of_one // players)) == episodes for of_one in rows)
    assert len(np.unique(rows % players)) == players


@pytest.mark.parametrize("thorough", [False, True])
@pytest.mark.parametrize("players", [1, 5, 20])
def test_all_rows_of_a_witness_of_own_links_belong_to_one_player(players, thorough):
    rows = sample_rows(40, players, thorough=thorough, by_player=True)
    owners = [np.unique(of_one % players) for of_one in rows]
    assert all(len(player) == 1 for player in owners)
    assert len(np.unique(owners)) == len(rows) == (min(players, WITNESSES) if thorough else 1)
    assert all(len(np.unique(of_one)) == (40 if thorough else EPISODES) for of_one in rows)


def test_an_audit_sees_one_player_of_some_episodes():
    (rows,) = sample_rows(200, 5, thorough=False)
    assert len(np.unique(rows // 5)) == len(rows) == EPISODES
    assert rows.max() < 1000
