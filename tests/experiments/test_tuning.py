"""Tuned laws and paired comparisons."""

import numpy as np
import pytest

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.experiments import tuning
from ptne_env.experiments.statistics import worst_decile


class Copy:
    """The static law at κ = 5 by another name, which makes it somebody else's policy."""

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


def test_groups_hold_what_they_say():
    paper, everything = list(tuning.candidates("paper")), list(tuning.candidates("all"))
    assert len(paper) == 6 + 6 + 18
    assert len(everything) == len(paper) + 6 + 30
    assert set(paper) < set(everything)
    targets = {part.target for part in everything}
    assert targets == {f"ptne_env.laws:{name}" for name in ("Static", "Adaptive", "CorollaryOne", "Grounded")}
    assert all(dict(part.arguments).get("gradient_gain", 1.0) == 1.0 for part in paper)


def test_the_tuned_laws_are_the_best_on_the_validation_bank(monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 10)
    scenario = ptne_env.get_scenario("random-energy")
    tuned = evaluate([PolicySpec("copy", Copy)], [scenario], episodes=2).tuned["random-energy"]
    for group, entry in tuned.items():
        entries = [PolicySpec(str(index), part) for index, part in enumerate(tuning.candidates(group))]
        found = evaluate(entries, [scenario], episodes=10, seed=0, split="validation")
        digits = {entry.name: found.record("random-energy", entry.name, "digits")["mean"] for entry in entries}
        best = max(entries, key=lambda entry: digits[entry.name])
        assert digits[best.name] == max(digits.values())
        assert entry.policy == best.policy


def test_only_other_peoples_policies_are_measured_against_the_tuned_laws(results):
    measured = {record["policy"] for record in results.records if record["metric"] == "digits_over_all_laws"}
    assert measured == {"copy"}
    assert {name for name, entry in results.entries.items() if entry.is_learned} == {"copy"}


def test_differences_are_paired_by_episode(results):
    cells = {cell.policy: cell.samples for cell in results.cells}
    for group, name in tuning.GROUPS.items():
        difference = cells["copy"]["digits"] - cells[name]["digits"]
        np.testing.assert_array_equal(cells["copy"][f"digits_over_{group}_laws"], difference)
        better = (difference > 0) + 0.5 * (difference == 0)
        record = results.record("random-energy", "copy", f"probability_of_beating_{group}_laws")
        assert record["mean"] == pytest.approx(better.mean())
        assert record["episodes"] == 40


def test_the_tuned_laws_are_written_down_with_their_parameters(results):
    written = results.to_dict()["tuned_laws"]["random-energy"]
    assert set(written) == set(tuning.GROUPS)
    assert written["all"]["policy"]["target"].startswith("ptne_env.laws:")
    assert results.to_csv().count("best of all laws") > 10


def test_tuning_does_not_depend_on_the_seed_of_the_comparison(results, monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 20)
    other = evaluate([PolicySpec("copy", Copy)], [ptne_env.get_scenario("random-energy")], episodes=3, seed=99)
    for group, entry in other.tuned["random-energy"].items():
        assert entry.policy == results.tuned["random-energy"][group].policy


def test_an_entry_that_is_bound_to_a_scenario_stays_out_of_the_others():
    entries = [
        PolicySpec("bound", FactorySpec.of("ptne_env.laws:ZeroInput"), scenarios=frozenset({"energy"})),
        "static",
    ]
    results = evaluate(entries, ["energy", "non-quadratic"], episodes=2)
    assert {cell.scenario for cell in results.cells if cell.policy == "bound"} == {"energy", "energy (paper start)"}


def test_the_worst_decile_is_the_mean_of_the_lowest_tenth():
    values = np.random.default_rng(0).permutation(np.arange(50.0))
    summary = worst_decile(values)
    assert summary.mean == np.mean([0, 1, 2, 3, 4])
    assert summary.low <= summary.mean <= summary.high
    assert worst_decile(np.full(9, 3.0)).mean == 3.0
