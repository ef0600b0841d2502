"""The rows that an audit of decisions sees."""

import numpy as np
import pytest

import ptne_env
from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.evaluation import Track, get_policy_spec, suite_policies
from ptne_env.evaluation.audit import OWN_LINKS_EPISODES, WITNESSES, rows_of_one, sample_rows
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.jobs import Job
from ptne_env.learn import shipped_path
from ptne_env.perception.observation import Interface


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


@pytest.mark.parametrize(
    "scenario",
    [
        ptne_env.get_scenario("robots", steps=30),
        ptne_env.get_scenario(
            "random-energy-switching",
            steps=60,
            channel=FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=1e-3),
        ),
    ],
    ids=["robots", "noisy links"],
)
def test_policies_that_ship_pass_the_thorough_audit_by_which_a_run_takes_them_on_trust(scenario):
    track, episodes = Track("t", scenario, "A change."), EpisodeSet(3, 0)
    policies = [*suite_policies(), PolicySpec("tuned", FactorySpec.of("ptne_env.laws:Static", kappa=3.0))]
    assert all(policy.ships for policy in policies)
    results = {policy.name: Job(track, policy, 0, episodes).compute(thorough=True) for policy in policies}
    assert {name: result.failure for name, result in results.items() if result.failure} == {}
    assert sum(result.not_applicable is None for result in results.values()) >= 20


def test_a_run_audits_every_policy_that_does_not_ship(tmp_path):
    own = tmp_path / "mine.onnx"
    own.write_bytes(shipped_path("ppo-random-energy").read_bytes())
    for policy in (
        get_policy_spec(str(own)),
        PolicySpec("class", laws.Static),
        PolicySpec("object", FactorySpec.of("elsewhere:Law"), Interface("physical")),
        PolicySpec("part", FactorySpec.of("ptne_env.laws:Static", kappa=FactorySpec.of("elsewhere:gain"))),
    ):
        assert not policy.ships
