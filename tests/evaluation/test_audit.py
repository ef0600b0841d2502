"""The audit: the rows that it sees, and the policies that it refuses."""

import re

import numpy as np
import pytest
from small_suite import BASE

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.evaluation import POLICIES, EpisodeSet, Track, get_policy_spec
from ptne_env.evaluation.audit import OWN_LINKS_EPISODES, Witness, rows_of_one, sample_rows
from ptne_env.evaluation.comparison import Job
from ptne_env.learn import shipped_path
from ptne_env.perception.observation import LayoutError


@pytest.mark.parametrize(("episodes", "players"), [(1, 5), (200, 1), (200, 50), (200, 3)])
def test_an_audit_sees_one_player_of_every_episode_and_all_players_equally(episodes, players):
    rows = sample_rows(episodes, players)
    assert sorted(rows // players) == list(range(episodes))
    seen = np.bincount(rows % players, minlength=players)
    assert seen.max() - seen.min() <= 1


def test_rows_are_chosen_afresh():
    assert len({tuple(sample_rows(20, 5)) for _ in range(10)}) == 10


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
        ptne_env.get_scenario("robots", steps=20),
        ptne_env.get_scenario("random-energy-switching", steps=50, channel=FactorySpec.of("channel:noise", std=1e-3)),
    ],
    ids=["robots", "noisy links"],
)
def test_policies_that_ship_pass_the_audit_without_which_a_run_takes_them_on_trust(scenario):
    track, episodes = Track("t", scenario, "A change."), EpisodeSet(5, 0)
    any_size = [POLICIES[name] for name in POLICIES if name != "ppo"]
    results = {policy.name: Job(track, policy, 0, episodes).compute(audits=True) for policy in any_size}
    assert {name: result.failure for name, result in results.items() if result.failure} == {}
    assert not any(result.not_applicable for result in results.values())


class Mixing(laws.Static):
    """The static law, whose rows talk to each other from a step on, in large enough batches."""

    def __init__(self, layout, first=0, smallest=2, share=1e-3):
        super().__init__(layout)
        self.first, self.smallest, self.share, self.calls = first, smallest, share, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        actions, state = super().predict(observation, state, episode_start, deterministic)
        if self.calls >= self.first and len(observation) >= self.smallest:
            actions = actions + np.float32(self.share * observation.mean())
        self.calls += 1
        return actions, state


class ThroughMemory(laws.Static):
    """The static law, whose memory is shared by all rows."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        actions, _ = super().predict(observation, None, episode_start, deterministic)
        return actions if state is None else actions + np.float32(state), float(observation.mean())


class CountsLinks(laws.Static):
    """The static law, with a gain that depends on the links of all players."""

    def __init__(self, layout):
        players = range(layout.num_players)
        super().__init__(layout, kappa=1.0 + sum(n != i for i in players for n in layout.neighbours[i]) / 10)


class NeedsLinks(laws.Static):
    """The static law, which refuses players without neighbours."""

    def __init__(self, layout):
        if any(set(row) == {player} for player, row in enumerate(layout.neighbours)):
            raise LayoutError("a player has no neighbours")
        super().__init__(layout)


@pytest.mark.parametrize(
    ("policy", "reason"),
    [
        (Mixing, "not row-wise"),
        (lambda layout: Mixing(layout, share=1e-9), "it decides differently"),  # a message in the last bits
        (lambda layout: Mixing(layout, first=100), "step 100: its decisions are not row-wise"),
        (lambda layout: Mixing(layout, smallest=20), "not row-wise"),
        (ThroughMemory, "not row-wise"),
        (CountsLinks, "it uses links of other players: .*decides differently"),
        (NeedsLinks, "it uses links of other players.*cannot be built from them: a player has no neighbours"),
    ],
)
def test_decisions_that_are_not_row_wise_or_use_other_links_fail_the_audit(policy, reason):
    results = evaluate([PolicySpec("cheat", policy, laws.Static.interface), "static"], BASE, episodes=5)
    assert re.search(reason, results.failures[BASE.name, "cheat"])
    assert (BASE.name, "static") in results.samples


class Samples(laws.Static):
    """The static law with noise that no seed repeats, as dropout and sampling give."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        actions, state = super().predict(observation, state, episode_start, deterministic)
        return actions + np.random.default_rng().normal(size=actions.shape).astype(np.float32), state


def test_a_policy_that_does_not_repeat_is_told_so():
    failure = evaluate(Samples, BASE, episodes=2).failures[BASE.name, "Samples"]
    assert failure.startswith("step 0: it does not repeat: ")
    assert all(hint in failure for hint in (".eval()", "seeds itself", "the state that predict returns"))


def test_a_policy_may_write_into_its_observations():
    class Writes(laws.Static):
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            answer = super().predict(observation, state, episode_start, deterministic)
            observation[:] = 0
            return answer

    results = evaluate([Writes, "static"], BASE, episodes=3)
    assert not results.failures
    one, other = (results.samples[BASE.name, name]["digits"] for name in ("Writes", "static"))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("episodes", [1, 2, 3, 7])
def test_rounding_that_depends_on_the_size_of_the_batch_passes_the_audit(episodes):
    """As torch does it: rows of small batches, and the last numbers of a batch, are rounded otherwise."""

    class Rounding(laws.Static):
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            actions, state = super().predict(observation, state, episode_start, deterministic)
            shifted = np.arange(len(actions))[:, None] >= len(actions) // 4 * 4
            return np.where(shifted, np.nextafter(actions, np.float32(np.inf)), actions), state

    assert evaluate(Rounding, BASE, episodes=episodes).samples


def test_policies_of_the_user_are_audited_and_those_that_ship_are_not(tmp_path, monkeypatch):
    own = tmp_path / "mine.npz"
    own.write_bytes(shipped_path("recurrent-random-worlds").read_bytes())
    audited = []
    monkeypatch.setattr(Witness, "compare", lambda witness, rows, actions: audited.append(1))
    for policy in (get_policy_spec(str(own)), PolicySpec("class", laws.Static)):
        audited.clear()
        evaluate(policy, BASE, episodes=1)
        assert audited
    audited.clear()
    evaluate(["static", "recurrent-random-worlds"], BASE, episodes=1)
    assert not audited
