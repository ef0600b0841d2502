"""Results: records, JSON and CSV, the same for comparisons and suites; a metric is declared once."""

import csv
import dataclasses
import io
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from small_suite import BASE, SMALL

import ptne_env
from ptne_env import PolicySpec, evaluate, laws
from ptne_env.bench.report import result_tables
from ptne_env.evaluation import METRICS, Metric, Results, register, run_suite
from ptne_env.evaluation.metrics import number


@pytest.fixture(scope="module")
def results():
    return evaluate(["static", "zero-input", "oracle", "random"], ["energy", "non-quadratic"], episodes=6, seed=2)


def text_of(renderable):
    console = Console(width=400, record=True, file=io.StringIO())
    console.print(renderable)
    return console.export_text()


def test_the_short_text_names_few_policies_and_counts_many(results):
    assert repr(results) == (
        "<Results of comparison: static, zero-input, oracle, random on energy, non-quadratic, seed 2>"
    )
    many = dataclasses.replace(results, policies={str(number): results.policies["static"] for number in range(9)})
    assert repr(many).startswith("<Results of comparison: 9 policies on energy,")


def test_the_printed_text_has_a_line_per_track_and_policy_the_best_first(results):
    _, energy, other, *_ = str(results).split("\n\n")
    title, *lines = energy.splitlines()
    assert title == "energy, 6 episodes: digits"
    assert other.startswith("non-quadratic, 6 episodes: digits")
    assert [line.split("  ")[1] for line in lines] == ["oracle (oracle)", "static", "zero-input", "random"]
    mean, low, high = (number(results.record("energy", "static", "digits")[key]) for key in ("mean", "low", "high"))
    assert lines[1].endswith(f"  {mean} [{low}, {high}]")


def test_a_notebook_shows_a_table_in_which_names_are_text(results):
    name = "<b>mine</b>"
    policies = results.policies | {name: results.policies["static"]}
    records = tuple(record | {"policy": name} if record["policy"] == "static" else record for record in results.records)
    samples = results.samples | {("energy", name): results.samples["energy", "static"]}
    html = dataclasses.replace(results, policies=policies, records=records, samples=samples)._repr_html_()
    assert html.startswith("<table>")
    assert name not in html
    assert "<th>&lt;b&gt;mine&lt;/b&gt;</th>" in html
    assert "<small>digits, 6 episodes</small>" in html


def test_the_printed_text_names_failures_with_their_reasons(results):
    reason = "step 3: it answered with an action that is not finite"
    failed = dataclasses.replace(results, failures={("non-quadratic", "mine"): reason})
    _, energy, other = str(failed).split("\n\n")
    assert other.splitlines()[-1] == f"  mine failed: {reason}"
    assert "failed" not in energy


def test_the_figure_has_a_panel_per_track_and_a_point_per_policy(results):
    figure = results.plot()
    panels = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title(loc="left") for axes in panels] == [
        "energy, 6 episodes",
        "non-quadratic, 6 episodes",
    ]
    labels = [label.get_text() for label in panels[0].get_yticklabels()]
    assert labels == ["oracle (oracle)", "static", "zero-input", "random"]
    points = [line.get_xdata()[0] for line in panels[0].get_lines() if len(line.get_xdata()) == 1]
    assert points == [results.record("energy", name.split()[0], "digits")["mean"] for name in labels]
    assert results.plot("settling_time").axes[0].get_xlabel() == METRICS["settling_time"].label


def test_a_figure_of_an_unknown_metric_is_refused(results):
    with pytest.raises(ValueError, match="unknown metric 'digit'; did you mean 'digits'"):
        results.plot("digit")
    with pytest.raises(ValueError, match="no policy has a value of digits_after_hold"):
        results.plot("digits_after_hold")


def test_the_data_frame_has_the_rows_of_the_csv_file(results, monkeypatch):
    class DataFrame(list):
        """Records what pandas would get; pandas itself is no dependency of the tests."""

        def __init__(self, rows, columns):
            super().__init__(rows)
            self.columns = columns

        def astype(self, kinds):
            assert kinds == {"mean": float, "low": float, "high": float}
            return self

    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=DataFrame))
    frame = results.to_dataframe()
    table = list(csv.DictReader(results.to_csv().splitlines()))
    assert frame.columns == list(table[0])
    assert [{key: "" if value is None else str(value) for key, value in row.items()} for row in frame] == table


def test_a_data_frame_without_pandas_names_what_to_install(results, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        results.to_dataframe()


def test_records_cover_every_track_policy_and_metric_once(results):
    keys = [(record["track"], record["policy"], record["metric"]) for record in results.records]
    measured = [name for name, metric in METRICS.items() if metric.block != "Against tuned laws"]
    assert len(set(keys)) == len(keys) == 2 * 4 * len(measured)
    assert [metric for track, policy, metric in keys[: len(measured)]] == measured
    fields = ["track", "policy", "metric", "mean", "low", "high", "episodes"]
    assert all(list(record) == fields for record in results.records)


def test_means_lie_within_their_intervals(results):
    for record in results.records:
        if record["mean"] is not None:
            rounding = 1e-12 * abs(record["mean"])
            assert record["low"] - rounding <= record["mean"] <= record["high"] + rounding


def test_samples_average_to_the_records(results):
    digits = results.samples["energy", "static"]["digits"]
    assert digits.shape == (1, 6)
    assert np.mean(digits) == pytest.approx(results.record("energy", "static", "digits")["mean"], rel=1e-12)


def test_json_holds_everything_and_no_nan(results):
    data = json.loads(results.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in the file"))
    assert data["versions"]["ptne_env"] == ptne_env.__version__
    assert data["seed"] == 2
    timed = [record for record in results.records if METRICS[record["metric"]].is_timing]
    assert data["timings"] == timed
    assert data["records"] == [record for record in results.records if record not in timed]
    policies = {policy["name"]: policy for policy in data["policies"]}
    assert policies["static"]["training_seeds"][0]["arguments"] == {"kappa": 2.0}
    rebuilt = ptne_env.Scenario.from_dict(data["suite"]["tracks"][0]["scenario"])
    assert rebuilt == ptne_env.get_scenario("energy", start="random")


def test_results_of_a_suite_have_the_same_keys_and_all_that_repeats_them(results, tmp_path):
    data = run_suite(SMALL, ["ppo-random-energy"], folder=tmp_path).to_dict()
    assert list(data) == list(results.to_dict())
    assert data["suite"]["content_hash"] == SMALL.content_hash
    assert ptne_env.Scenario.from_dict(data["suite"]["tracks"][0]["scenario"]) == BASE
    assert {"ptne_env", "sources", "numpy", "scipy", "python"} <= set(data["versions"])
    policies = {policy["name"]: policy["training_seeds"][0] for policy in data["policies"]}
    assert set(policies["ppo-random-energy"]["files"]) == {"ppo-random-energy"}
    assert (data["seed"], data["split"], data["episodes"]) == (0, "test", {"ring": 5, "complete": 5})
    assert {f"{job['key']}.json" for job in data["jobs"]} == {path.name for path in (tmp_path / "jobs").iterdir()}
    assert data["not_applicable"][0]["policy"] == "ppo-random-energy"
    assert results.leaderboard is results.to_dict()["leaderboard"] is None


def test_csv_repeats_the_records(results):
    rows = list(csv.DictReader(io.StringIO(results.to_csv())))
    assert len(rows) == len(results.records)
    for row, record in zip(rows, results.records, strict=True):
        assert row["metric"] == record["metric"]
        assert row["mean"] == ("" if record["mean"] is None else str(record["mean"]))
        assert row["content_hash"] == results.suite.content_hash
        known = {"graphs": "all" if row["policy"] == "oracle" else "own links", "memory": "no", "estimates": "honest"}
        assert {name: row[name] for name in known} == known


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@SUM(A1)"])
def test_csv_holds_no_formulas(name):
    results = evaluate([PolicySpec(name, laws.Static)], [BASE], episodes=1)
    rows = [row for row in csv.DictReader(io.StringIO(results.to_csv())) if row["policy"].endswith(name)]
    assert {row["policy"] for row in rows} == {f"'{name}"}
    digits = results.record(BASE.name, name, "digits")["mean"]
    assert [row["mean"] for row in rows if row["metric"] == "digits"] == [str(digits)]


@pytest.mark.parametrize("end", [";", ", ", "; "])
def test_a_name_holds_no_formula_where_a_spreadsheet_ends_a_cell(end):
    text = evaluate([PolicySpec(f"fine{end}=1+1", laws.Static)], [BASE], episodes=1).to_csv()
    assert f"fine{end}'=1+1" in text
    assert f"{end}=" not in text


@pytest.fixture
def half_way():
    """A metric of one's own, declared in one statement."""
    yield register(
        Metric("half_way_distance", "half-way distance", "the estimate distance after half of the steps", "lower",
               value=lambda rollout: rollout["estimate_distance"][rollout.world.clock.steps // 2])
    )  # fmt: skip
    del METRICS["half_way_distance"]


def test_a_metric_is_declared_once_and_stands_in_every_output(half_way):
    results = evaluate(["static"], [BASE], episodes=2)
    assert isinstance(results, Results)
    assert results.record(BASE.name, "static", half_way.name)["mean"] > 0
    for output in (results.to_csv(), results.to_json()):
        assert half_way.name in output
    assert "half-way" in text_of(result_tables(results, 400))


def test_a_metric_with_a_taken_name_is_refused():
    with pytest.raises(ValueError, match="already"):
        register(METRICS["digits"])
