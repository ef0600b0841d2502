"""Results: records, texts, JSON and CSV; a metric is declared once and stands in every output."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from small_suite import BASE

import ptne_env
from ptne_env import PolicySpec, evaluate, laws
from ptne_env.evaluation import METRICS, Metric, register
from ptne_env.evaluation.metrics import number


@pytest.fixture(scope="module")
def results():
    return evaluate(["static", "zero-input", "oracle", "random"], ["energy", "non-quadratic"], episodes=6, seed=2)


def test_the_short_text_names_the_first_policies(results):
    names = "static, zero-input, oracle, random"
    assert repr(results) == f"<Results of comparison: {names} on energy, non-quadratic, seed 2>"
    many = replace(results, policies={f"policy-{number}": results.policies["static"] for number in range(9)})
    assert repr(many).startswith("<Results of comparison: policy-0, policy-1, policy-2, policy-3, policy-4, [...] on ")


def test_the_printed_text_has_a_line_per_track_and_policy_the_best_first(results):
    reason = "step 3: it answered with an action that is not finite"
    _, energy, other = str(replace(results, failures={("non-quadratic", "mine"): reason})).split("\n\n")
    title, *lines = energy.splitlines()
    assert title == "energy, 6 episodes: digits, mean regret"
    assert [line.split("  ")[1] for line in lines] == ["oracle (oracle)", "static", "zero-input", "random"]
    mean, low, high = (number(results.record("energy", "static", "digits")[key]) for key in ("mean", "low", "high"))
    regret = number(results.record("energy", "static", "mean_regret")["mean"])
    assert lines[1].endswith(f"  {mean} [{low}, {high}], {regret}")
    assert other.splitlines()[-1] == f"  mine failed: {reason}"


def test_records_cover_every_track_policy_and_metric_once(results):
    keys = [(record["track"], record["policy"], record["metric"]) for record in results.records]
    assert len(set(keys)) == len(keys) == 2 * 4 * len(METRICS)
    assert [metric for _, _, metric in keys[: len(METRICS)]] == list(METRICS)
    for record in results.records:
        assert list(record) == ["track", "policy", "metric", "mean", "low", "high", "episodes"]
        if record["mean"] is not None:
            rounding = 1e-12 * abs(record["mean"])
            assert record["low"] - rounding <= record["mean"] <= record["high"] + rounding


def test_samples_average_to_the_records_and_an_episode_without_settling_has_no_time(results):
    digits = results.samples["energy", "static"]["digits"]
    assert digits.shape == (1, 6)
    assert np.mean(digits) == pytest.approx(results.record("energy", "static", "digits")["mean"], rel=1e-12)
    assert results.record("energy", "zero-input", "settling_time")["mean"] is None
    assert results.record("energy", "zero-input", "settled_share")["mean"] == 0


def test_timings_are_no_part_of_the_identity_of_results(results):
    slower = {place: dict(samples) for place, samples in results.samples.items()}
    slower["energy", "static"]["microseconds_per_decision"] = np.full((1, 6), 1e9)
    first, second = results.to_dict(), replace(results, samples=slower).to_dict()
    assert first["checksum"] == second["checksum"]
    assert first["timings"] != second["timings"]


def test_csv_repeats_the_records(results):
    rows = list(csv.DictReader(io.StringIO(results.to_csv())))
    assert len(rows) == len(results.records)
    for row, record in zip(rows, results.records, strict=True):
        assert row == {key: "" if value is None else str(value) for key, value in record.items()} | {
            "seed": "2",
            "split": "test",
            "version": ptne_env.__version__,
            "suite": "comparison",
        }


@pytest.mark.parametrize("name", ["=1+1", "fine; =1+1"])
def test_csv_holds_no_formulas(name):
    results = evaluate([PolicySpec(name, laws.Static)], [BASE], episodes=1)
    rows = [row for row in csv.DictReader(io.StringIO(results.to_csv())) if row["policy"]]
    assert all("'" in row["policy"] for row in rows)
    digits = results.record(BASE.name, name, "digits")["mean"]
    assert [row["mean"] for row in rows if row["metric"] == "digits"] == [str(digits)]


def test_a_metric_of_ones_own_is_declared_once_and_stands_in_every_output():
    half_way = Metric("half_way", "half-way distance", "the estimate distance after half of the steps", "lower",
                      value=lambda rollout: rollout["estimate_distance"][rollout.world.clock.steps // 2])  # fmt: skip
    register(half_way)
    try:
        results = evaluate(["static"], [BASE], episodes=2)
        assert results.record(BASE.name, "static", "half_way")["mean"] > 0
        assert "half_way" in results.to_csv()
        assert "half_way" in results.to_json()
        with pytest.raises(ValueError, match="already"):
            register(half_way)
    finally:
        del METRICS["half_way"]
