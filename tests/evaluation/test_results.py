"""Results: records, texts, JSON and CSV; a metric is declared once and stands in every output."""

import csv
import io
import json
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from small_suite import BASE

import ptne_env
from ptne_env import PolicySpec, evaluate, laws
from ptne_env.evaluation import METRICS, Metric, Results, register
from ptne_env.evaluation.results import read_results, standing
from ptne_env.evaluation.statistics import Summary


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
    assert title == "energy, 6 episodes: digits, on the way, worst tenth"
    assert [line.split("  ")[1] for line in lines] == ["oracle *", "static", "zero-input", "random"]
    cells = []
    for metric in ("digits", "digits_on_the_way", "digits_cvar"):
        record = results.record("energy", "static", metric)
        cells.append(f"{record['mean']:.2f} [{record['low']:.2f}, {record['high']:.2f}]")
    assert lines[1].endswith("  " + ", ".join(cells))
    assert other.splitlines()[-1] == f"  mine failed: {reason}"


def test_the_printed_text_says_why_a_policy_has_no_values_and_where_there_is_no_interval(results):
    one = str(replace(evaluate("static", BASE, episodes=1), not_applicable={(BASE.name, "mine"): "too large"}))
    assert len(re.findall(r"\d+ \(no interval\)", one)) == 3
    assert one.splitlines()[-1] == "  mine n/a: too large"
    exact = evaluate("static", ptne_env.get_scenario("energy", start="paper"))
    record = exact.record("energy", "static", "digits")
    assert record["episodes"] == 1
    assert record["low"] == record["mean"] == record["high"]
    assert re.search(r"  4\.\d+, 2\.\d+, 4\.\d+$", str(exact))


def test_a_difference_is_paired_and_over_the_tracks_that_both_play(results):
    mine, theirs = (results.samples["energy", name]["digits"][0] for name in ("static", "zero-input"))
    low, high = stats.t.interval(0.95, 5, (mine - theirs).mean(), stats.sem(mine - theirs))
    found = results.difference("static", "zero-input", "energy")
    assert (found.mean, found.low, found.high) == pytest.approx(((mine - theirs).mean(), low, high))
    back = results.difference("zero-input", "static", "energy")
    assert (back.mean, back.low, back.high) == pytest.approx((-found.mean, -found.high, -found.low))
    other = results.difference("static", "zero-input", "non-quadratic").mean
    assert results.difference("static", "zero-input").mean == pytest.approx((found.mean + other) / 2)
    less = {place: samples for place, samples in results.samples.items() if place != ("non-quadratic", "static")}
    assert replace(results, samples=less).difference("static", "zero-input") == found
    assert results.difference("static", "zero-input", (), "regret").mean is None
    with pytest.raises(ValueError, match="unknown policy 'sttic'; did you mean 'static'"):
        results.difference("sttic", "zero-input")
    with pytest.raises(ValueError, match="unknown track 'energ'; did you mean 'energy'"):
        results.difference("static", "zero-input", "energ")
    with pytest.raises(ValueError, match="unknown metric 'digit'; did you mean 'digits'"):
        results.difference("static", "zero-input", metric="digit")


def test_the_episodes_that_scenarios_share_count_once():
    """The same world by two names tells no more than by one; a suite draws other episodes for every track."""
    worlds = [ptne_env.get_scenario("random-energy", name=name) for name in ("first", "second")]
    both = evaluate(["static", "zero-input"], worlds, episodes=6)
    once, twice = (both.difference("static", "zero-input", tracks) for tracks in ("first", ["first", "second"]))
    assert vars(twice) == pytest.approx(vars(once))
    assert vars(both.mean_over_tracks(["first", "second"], "digits", "static")) == pytest.approx(
        vars(both.summary("first", "static", "digits"))
    )
    drawn = {name: replace(each, track=("mine", name)) for name, each in both.episode_sets.items()}
    apart = replace(both, episode_sets=drawn).difference("static", "zero-input")
    assert apart.high - apart.low < 0.8 * (twice.high - twice.low)


def test_a_track_on_which_a_policy_never_settles_leaves_the_difference_on_the_others():
    results = evaluate(["grounded", "static"], ["energy", "energy-switching"], episodes=4)
    assert results.record("energy-switching", "static", "settling_time")["mean"] is None
    over_both = results.difference("grounded", "static", metric="settling_time")
    assert over_both.mean < 0
    assert over_both == results.difference("grounded", "static", "energy", "settling_time")


def test_a_timing_is_one_measurement_without_an_interval(results):
    record = results.record("energy", "static", "microseconds_per_decision")
    assert record["mean"] > 0
    assert record["low"] is record["high"] is None


def test_policies_stand_by_digits_to_two_decimals_and_then_by_digits_on_the_way():
    def place(digits, on_the_way):
        return standing(*(None if mean is None else Summary(mean, mean, mean) for mean in (digits, on_the_way)))

    order = [place(5.02, 0.0), place(5.014, 0.0), place(5.006, 2.0), place(5.014, 1.0), place(4.98, 9.0)]
    ranked = [place(5.02, 0.0), place(5.006, 2.0), place(5.014, 1.0), place(5.014, 0.0), place(4.98, 9.0)]
    assert sorted(order) == ranked
    assert place(4.98, 9.0) < place(None, 9.0)
    assert place(5.0, 0.0) < place(5.0, None)


def test_records_cover_every_track_policy_and_metric_once(results):
    keys = [(record["track"], record["policy"], record["metric"]) for record in results.records]
    assert len(set(keys)) == len(keys) == 2 * 4 * len(METRICS)
    assert [metric for _, _, metric in keys[: len(METRICS)]] == list(METRICS)
    for record in results.records:
        assert list(record) == ["track", "policy", "metric", "mean", "low", "high", "episodes"]
        if record["low"] is not None:
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


def test_json_holds_everything_and_no_nan_and_reads_back(results, tmp_path):
    data = json.loads(results.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in the file"))
    assert data["versions"]["ptne_env"] == ptne_env.__version__
    assert data["policies"][0]["training_seeds"][0]["arguments"] == {"kappa": 2.0}
    again = Results.from_dict(data)
    assert again.records == results.records
    assert again.to_json() == results.to_json()
    assert again.tracks == results.tracks
    assert again.policies == results.policies
    (tmp_path / "results.json").write_text(results.to_json(), encoding="utf-8")
    assert read_results(tmp_path).to_json() == results.to_json()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[: len(text) // 2], "cut off"),
        (lambda text: text.replace('"seed":2', '"seed":3', 1), "damaged or changed"),
        (lambda text: text.replace('"format":', '"format":9', 1), "no file of results of format"),
        (lambda text: "{}", "no file of results"),
        (lambda text: text + " " * 2**25, "has more than 32 MiB"),
    ],
)
def test_damaged_foreign_and_huge_files_are_refused(results, tmp_path, change, message):
    path = tmp_path / "results.json"
    path.write_text(change(results.to_json()), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_results(path)


def test_numbers_beside_the_sealed_ones_do_not_replace_them(results):
    data = json.loads(results.to_json())
    track, policy = "energy", "static"
    data["timings"][track][policy]["digits"] = [[12.0]]  # the checksum does not cover timings
    with pytest.raises(ValueError, match=f"not results: digits of {policy} on {track} is among the timings"):
        Results.from_dict(data)


@pytest.mark.parametrize("change", [{"policies": 3}, {"tracks": [{}]}, {"episodes": {}}, {"samples": {"energy": 1}}])
def test_data_of_another_form_are_no_results(results, change):
    with pytest.raises(ValueError, match="not results"):
        Results.from_dict(json.loads(results.to_json()) | change)


def test_a_figure_has_a_mark_with_its_interval_per_track_and_policy(results):
    figure = results.plot()
    (axes,) = figure.axes
    tracks = [label.get_text() for label in axes.get_yticklabels()]
    assert tracks == list(results.episodes)
    for policy, drawn in zip(results.policies, axes.containers, strict=True):
        assert drawn.get_label() == results.policies[policy].label
        shown = drawn.lines[0].get_xdata()
        for track, value in zip(tracks, shown, strict=True):
            summary = results.summary(track, policy, "digits")
            assert value == summary.mean if summary else np.isnan(value)
    with pytest.raises(ValueError, match="unknown metric 'digit'"):
        results.plot("digit")


def test_a_data_frame_has_the_records_or_the_error_names_the_extra(results, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=list))
    assert results.to_frame() == list(results.records)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r'data frames need pandas: pip install "ptne-env\[pandas\]"'):
        results.to_frame()
