"""Tuned laws and paired comparisons."""

import numpy as np
import pytest

import ptne_env
from ptne_env import PolicySpec, evaluate, laws
from ptne_env.experiments import tuning
from ptne_env.experiments.statistics import summaries


class Copy:
    """The static law at κ = 5 in a class outside the library."""

    def __init__(self, layout):
        self.law = laws.Static(layout, kappa=5.0)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.law.predict(observation, state, episode_start, deterministic)


@pytest.fixture(scope="module")
def results():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "VALIDATION_EPISODES", 20)
        scenario = ptne_env.get_scenario("random-energy")
        return evaluate(["static", "oracle", PolicySpec("copy", Copy)], [scenario], episodes=40, seed=1)


def test_groups_hold_the_laws_of_their_names():
    paper, everything = list(tuning.candidates("paper")), list(tuning.candidates("all"))
    assert len(paper) == 6 + 6 + 18
    assert len(everything) == len(paper) + 6 + 30
    assert set(paper) < set(everything)
    targets = {law.target for law in everything}
    assert targets == {f"ptne_env.laws:{name}" for name in ("Static", "Adaptive", "CorollaryOne", "Grounded")}
    assert all(dict(law.arguments).get("gradient_gain", 1.0) == 1.0 for law in paper)


def test_the_tuned_laws_are_the_best_on_the_validation_episodes(monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 10)
    scenario = ptne_env.get_scenario("random-energy")
    tuned = evaluate([PolicySpec("copy", Copy)], [scenario], episodes=2).tuned["random-energy"]
    for group, law in tuned.items():
        laws_of_group = [PolicySpec(str(index), found) for index, found in enumerate(tuning.candidates(group))]
        found = evaluate(laws_of_group, [scenario], episodes=10, seed=0, split="validation")
        best = max(laws_of_group, key=lambda policy: found.record("random-energy", policy.name, "digits")["mean"])
        assert law.policy == best.policy


def test_only_policies_outside_the_library_are_compared_with_tuned_laws(results):
    measured = {record["policy"] for record in results.records if record["metric"] == "digits_over_all_laws"}
    assert measured == {"copy"}
    assert {name for name, policy in results.policies.items() if policy.is_learned} == {"copy"}


def test_differences_are_paired_by_episode(results):
    samples = {policy: found for (_, policy), found in results.samples.items()}
    for group, name in tuning.GROUPS.items():
        difference = samples["copy"]["digits"] - samples[name]["digits"]
        np.testing.assert_array_equal(samples["copy"][f"digits_over_{group}_laws"], difference)
        better = (difference > 0) + 0.5 * (difference == 0)
        record = results.record("random-energy", "copy", f"probability_of_beating_{group}_laws")
        assert record["mean"] == pytest.approx(better.mean())
        assert record["episodes"] == 40


def test_the_tuned_laws_stand_in_the_file_with_their_parameters(results):
    written = results.to_dict()["tuned_laws"]["random-energy"]
    assert set(written) == set(tuning.GROUPS)
    assert written["all"]["training_seeds"][0]["target"].startswith("ptne_env.laws:")
    assert results.to_csv().count("best of all laws") > 10


def test_tuning_does_not_depend_on_the_seed_of_the_comparison(results, monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 20)
    other = evaluate([PolicySpec("copy", Copy)], [ptne_env.get_scenario("random-energy")], episodes=3, seed=99)
    for group, law in other.tuned["random-energy"].items():
        assert law.policy == results.tuned["random-energy"][group].policy


def test_cvar_is_the_mean_of_the_lowest_tenth():
    values = np.random.default_rng(0).permutation(np.arange(50.0))

    def cvar(samples):
        return summaries({"digits_cvar": (samples, "cvar")})["digits_cvar"]

    summary = cvar(values[None])
    assert summary.mean == np.mean([0, 1, 2, 3, 4])
    assert summary.low <= summary.mean <= summary.high
    assert cvar(np.full((1, 9), 3.0)).mean == 3.0
    both = cvar(np.stack([values, values + 1]))
    assert both.mean == summary.mean + 0.5
    assert both.low < summary.mean < both.high
