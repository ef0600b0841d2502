import csv
import io
import json

import numpy as np
import pytest

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.experiments import COMPARED, METRICS, default_entries, get_policy_spec, tuning
from ptne_env.experiments.benchmark import TIMINGS
from ptne_env.experiments.workers import Workers


@pytest.fixture(scope="module")
def results():
    return evaluate(["static", "null", "oracle", "random"], ["energy", "non-quadratic"], episodes=6, seed=2)


def test_a_name_is_run_from_random_starts_and_from_the_papers_start(results):
    assert list(results.scenarios) == ["energy", "energy (paper start)", "non-quadratic", "non-quadratic (paper start)"]
    assert results.record("energy", "static", "digits")["episodes"] == 6
    assert results.record("energy (paper start)", "static", "digits")["episodes"] == 1


def test_the_papers_start_gives_the_distance_of_the_documented_loop(results):
    record = results.record("energy (paper start)", "static", "strategy_distance")
    assert record["mean"] == record["low"] == record["high"] == pytest.approx(6.5270e-5, rel=1e-4)


def test_records_cover_every_scenario_policy_and_metric_once(results):
    keys = [(record["scenario"], record["policy"], record["metric"]) for record in results.records]
    assert len(set(keys)) == len(keys) == len(results.scenarios) * len(results.entries) * 18
    assert {metric for _, _, metric in keys} == {*METRICS, "worst_decile_digits"}
    assert all(
        set(record) == {"scenario", "policy", "metric", "mean", "low", "high", "episodes"} for record in results.records
    )


def test_means_lie_within_their_intervals(results):
    for record in results.records:
        if record["mean"] is not None:
            rounding = 1e-12 * abs(record["mean"])
            assert record["low"] - rounding <= record["mean"] <= record["high"] + rounding


def test_json_holds_everything_and_no_nan(results):
    data = json.loads(results.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in the file"))
    assert data["version"] == ptne_env.__version__
    assert data["seed"] == 2
    assert data["records"] == list(results.records)
    assert data["policies"]["static"]["policy"]["arguments"] == {"kappa": 2.0}
    rebuilt = ptne_env.Scenario.from_dict(data["scenarios"]["energy"])
    assert rebuilt == ptne_env.get_scenario("energy", start="random")


def test_a_run_that_never_settles_is_null(results):
    assert results.record("energy", "null", "settling_time")["mean"] is None
    assert results.record("energy", "null", "settled_share")["mean"] == 0


def test_csv_repeats_the_records(results):
    rows = list(csv.DictReader(io.StringIO(results.to_csv())))
    assert len(rows) == len(results.records)
    for row, record in zip(rows, results.records, strict=True):
        assert row["metric"] == record["metric"]
        assert row["mean"] == ("" if record["mean"] is None else str(record["mean"]))
        assert json.loads(row["policy_parameters"])["name"] == record["policy"]


def test_episode_rows_average_to_the_records(results):
    rows = [
        row["value"]
        for row in results.episodes
        if (row["scenario"], row["policy"], row["metric"]) == ("energy", "static", "digits")
    ]
    assert len(rows) == 6
    assert np.mean(rows) == pytest.approx(results.record("energy", "static", "digits")["mean"], rel=1e-12)


def test_results_are_a_function_of_the_seed_apart_from_timings():
    def without_timings(results):
        return [record for record in results.records if record["metric"] != "microseconds_per_decision"]

    first, again, other = (
        evaluate(["static", "random"], [ptne_env.get_scenario("energy", start="random")], episodes=3, seed=seed)
        for seed in (7, 7, 8)
    )
    assert without_timings(first) == without_timings(again)
    assert without_timings(first) != without_timings(other)


def test_what_a_policy_meets_does_not_depend_on_the_other_policies():
    scenario = ptne_env.get_scenario("energy-switching", start="random")
    alone = evaluate(["static"], [scenario], episodes=3)
    among = evaluate(["random", "static"], [scenario], episodes=3)
    assert alone.record("energy-switching", "static", "digits") == among.record("energy-switching", "static", "digits")


def test_entries_take_a_class_a_part_a_callable_and_a_policy_itself():
    scenario = ptne_env.get_scenario("energy")
    env = ptne_env.parallel_env(scenario)
    entries = [
        PolicySpec("class", laws.Static),
        PolicySpec("part", FactorySpec.of("ptne_env.laws:Static", kappa=2.0)),
        PolicySpec("callable", lambda layout: laws.Static(layout, kappa=2.0)),
        PolicySpec("object", laws.Static(env.layout)),
        get_policy_spec("ptne_env.laws:Static"),
        "static",
    ]
    results = evaluate(entries, [scenario])
    assert len({results.record("energy", name, "digits")["mean"] for name in results.entries}) == 1
    json.loads(results.to_json())


def test_the_two_interfaces_agree_where_no_action_saturates():
    scenario = ptne_env.get_scenario("energy", start="random")
    entries = [
        PolicySpec("physical", laws.Static),
        PolicySpec("local", laws.Static, ptne_env.Interface("local")),
    ]
    results = evaluate(entries, [scenario], episodes=5)
    physical, local = (results.record("energy", name, "digits")["mean"] for name in ("physical", "local"))
    assert local == pytest.approx(physical, abs=1e-5)


def test_every_compared_entry_acts_on_every_scenario_of_the_catalogue():
    results = evaluate(COMPARED, list(ptne_env.CATALOGUE), episodes=2, hold_steps=3)
    assert len(results.cells) == 8 * (2 * 6 + 11)
    # The anchors bracket the laws: doing nothing is worse than the static law, full information is better.
    for scenario in ("energy", "energy-switching", "energy-switching-transformed", "non-quadratic", "random-energy"):
        digits = [results.record(scenario, name, "digits")["mean"] for name in ("null", "static", "oracle")]
        assert digits == sorted(digits)


def test_a_comparison_on_the_catalogue_leaves_out_policies_that_enter_none_of_it():
    names = {entry.name for entry in default_entries()}
    assert names >= {*COMPARED, "ppo-random-energy", "ppo-ptne-v1-generalist"}
    assert not names & {"ppo-ptne-v1-noise", "ppo-ptne-v1-markov", "ppo-ptne-v1-unseen-graphs"}


def test_oracle_by_module_path_brings_the_interface_that_it_needs():
    results = evaluate(["oracle", "ptne_env.laws:CentralisedOracle"], ["energy", "random-energy"], episodes=2)
    for scenario in results.scenarios:
        named, by_path = (results.record(scenario, name, "digits") for name in results.entries)
        assert named["mean"] == by_path["mean"] > 11


def test_scenario_that_draws_games_is_run_from_random_starts_alone():
    results = evaluate(["static"], ["random-energy", "random-energy-switching"], episodes=3)
    assert list(results.scenarios) == ["random-energy", "random-energy-switching"]
    assert {record["episodes"] for record in results.records} == {3}
    digits = [row["value"] for row in results.episodes if row["metric"] == "digits"]
    assert len(set(digits)) == 6


@pytest.mark.parametrize(("policies", "rollouts"), [(["static", "null"], 4), (["ppo-random-energy"], 2 + 66 + 2)])
def test_progress_is_reported_once_per_rollout(monkeypatch, policies, rollouts):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 2)
    seen = []
    evaluate(policies, ["energy"], episodes=1, progress=lambda *told: seen.append(told))
    assert len(seen) == rollouts
    assert {total for _, total in seen} == {rollouts}


def test_results_do_not_depend_on_the_number_of_processes(monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 5)
    one, two = (
        evaluate(["static", "random", "ppo-random-energy"], ["random-energy"], episodes=3, workers=Workers(jobs))
        for jobs in (1, 2)
    )
    assert [record for record in one.records if record["metric"] not in TIMINGS] == [
        record for record in two.records if record["metric"] not in TIMINGS
    ]
    assert one.tuned == two.tuned
    assert [cell.policy for cell in one.cells] == [cell.policy for cell in two.cells]


@pytest.mark.parametrize(
    ("entries", "scenarios", "message"),
    [
        (["statics"], ["energy"], "unknown policy 'statics'; choose from static"),
        (["static"], ["energie"], "unknown scenario 'energie'; the catalogue has energy"),
        (["static", "static"], ["energy"], "twice"),
        (["static"], ["energy", "energy"], "twice"),
        ([], ["energy"], "at least one policy"),
        (["static"], [], "at least one scenario"),
        (["no.such.module:thing"], ["energy"], "cannot import"),
        (["ptne_env.laws:NoSuchLaw"], ["energy"], "has no 'NoSuchLaw'"),
        ([PolicySpec("blind", laws.CentralisedOracle, ptne_env.Interface())], ["energy"], "interface 'full'"),
    ],
)
def test_wrong_names_are_told_what_there_is(entries, scenarios, message):
    with pytest.raises(ValueError, match=message):
        evaluate(entries, scenarios, episodes=1)


def test_an_object_without_predict_is_refused():
    with pytest.raises(ValueError, match="no predict"):
        evaluate([PolicySpec("broken", lambda layout: object())], [ptne_env.get_scenario("energy")])


@pytest.mark.parametrize(("episodes", "seed"), [(0, 0), (1, -1), (1.5, 0)])
def test_counts_out_of_range_are_refused(episodes, seed):
    with pytest.raises(ValueError, match="whole number"):
        evaluate(["static"], ["energy"], episodes=episodes, seed=seed)
