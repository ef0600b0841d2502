"""Tables of results as data, and in the terminal."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from ptne_env import PolicySpec, evaluate, get_scenario
from ptne_env.evaluation import METRICS, Track, get_policy_spec
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.statistics import Summary
from ptne_env.perception.observation import LayoutError
from ptne_env.report.tables import (
    Cell,
    answer,
    answer_table,
    leaders,
    order_policies,
    track_tables,
)
from ptne_env.report.terminal import answer_tables, result_tables
from ptne_env.suites import Suite, leaderboard, run_suite


def written(tables, width=172):
    stream = io.StringIO()
    Console(file=stream, width=width).print(tables)
    text = stream.getvalue()
    assert "…" not in text
    assert max(map(cell_len, text.splitlines())) <= width
    return text


def digits_of(results, track, policy):
    record = results.record(track, policy, "digits")
    return f"{record['mean']:.2f} ±{record['high'] - record['mean']:.2f}".removesuffix(" ±0.00")


@pytest.mark.parametrize("width", [80, 120, 172])
def test_tables_of_results_fit_the_terminal_and_lose_no_number(comparison, suite, width):
    for results in (comparison, suite):
        words = set(written(result_tables(results, width), width).split())
        for record in results.records:
            if record["mean"] is not None:
                assert number(record["mean"]) in words


@pytest.mark.parametrize("width", [80, 120])
def test_the_answer_fits_the_terminal_and_keeps_the_papers_law(comparison, suite, width):
    for results in (comparison, suite):
        text = written(answer_tables(results, width), width)
        for track in results.tracks:
            assert digits_of(results, track.name, "static") in text
        hidden = " ".join(re.findall(r"--details, also shows (.*?)\.", " ".join(text.split())))
        heading = text[: text.index("─")]
        for name in results.policies:
            assert name in hidden or all(part in heading for part in re.findall(r"\w+", name))
        assert not [name for name in leaders(results) if name in hidden.split(", ")]


def test_the_answer_has_a_row_per_track_and_their_mean(comparison, suite, hostile):
    table = answer_table(comparison)
    assert table.rows == ("energy", "energy-switching")
    assert table.totals == ("mean of 2", "on the way", "worst tenth")
    columns = {column.label: column for column in table.columns}
    assert list(columns)[:2] == ["grounded", "static"]
    assert list(columns)[2:] == [hostile, "zero-input", "oracle *"]
    for name in ("static", "grounded"):
        means = [comparison.record(track, name, "digits")["mean"] for track in table.rows]
        assert columns[name]["energy"].text == digits_of(comparison, "energy", name)
        assert columns[name]["mean of 2"].value == pytest.approx(np.mean(means))
        for row, metric in (("on the way", "digits_on_the_way"), ("worst tenth", "digits_cvar")):
            values = [comparison.record(track, name, metric)["mean"] for track in table.rows]
            assert columns[name][row].value == pytest.approx(np.mean(values))
    learned = next(column for column in answer_table(suite).columns if column.label == "ppo-nominal")
    assert learned["robots"] == Cell("n/a")
    board = {row.policy: row for row in leaderboard(suite)}
    assert learned["score"].value == board[learned.label].score.mean
    assert learned["mean rank"].value == board[learned.label].mean_rank


def test_the_answer_names_the_closest_policy_and_its_lead_over_the_papers_law_and_ones_own(comparison, hostile):
    first, *leads = answer(comparison)
    assert first == "grounded comes closest to the Nash equilibrium by the deadline on average over 2 scenarios."
    for name, shown in (("static", "the paper's law (static)"), (hostile, hostile)):
        lead = comparison.difference("grounded", name)
        digits = f"{lead.mean:.2f} digits [{lead.low:.2f}, {lead.high:.2f}] on average over 2 scenarios"
        assert f"grounded leads {shown} by {digits}." in leads


def test_the_answer_says_what_a_policy_of_the_user_did_that_cannot_play(hostile):
    class Unfit:
        def __init__(self, layout):
            raise LayoutError("it needs six players")

    worlds = ["energy", "energy-switching"]
    results = evaluate(["static", "grounded", PolicySpec(hostile, Unfit)], worlds, episodes=2)
    assert (
        answer(results)[-1]
        == f"{hostile} has no result on energy and energy-switching, for the reason below the table."
    )
    table = answer_table(results)
    (column,) = [column for column in table.columns if column.label == hostile]
    assert [column[world].text for world in worlds] == ["n/a", "n/a"]
    assert f"n/a: {hostile} on energy and energy-switching: it needs six players" in table.notes
    assert "n/a: it needs six players" in str(results)
    failing = evaluate(["static", PolicySpec("mine", lambda layout: 1 / 0)], worlds, episodes=2)
    assert answer(failing)[-1].startswith("mine has no result on energy and energy-switching")
    assert any(note.startswith("failed: mine on energy and") for note in answer_table(failing).notes)


def test_the_columns_have_the_order_of_the_score_and_the_weakest_are_hidden():
    policies = ["zero-input", "random", "grounded", "adaptive", "relay", "static", "oracle"]
    results = evaluate(policies, ["energy"], episodes=2)
    digits = [column["energy"].value for column in answer_table(results).columns if "*" not in column.label]
    assert digits == sorted(digits, reverse=True)
    text = written(answer_tables(results, 60), 60)
    hidden = re.search(r"--details, also shows (.*?)\.", " ".join(text.split()))[1].split(", ")
    least = [name for name in order_policies(results)[:-1] if name not in leaders(results)]
    assert hidden == [*least[1 - len(hidden) :], "oracle *"]
    assert len(hidden) > 2


def test_a_policy_that_fails_everywhere_comes_last_and_leads_nothing():
    ring = Track("ring", get_scenario("energy", channel="noise(std=5.0)"), "Noise.")
    broken = PolicySpec("broken", lambda layout: 1 / 0)
    results = run_suite(Suite("noisy", (ring,), episodes=2), [broken, "random", "zero-input"])
    names = [name for name in order_policies(results) if name != "oracle"]
    assert names[-1] == "broken"
    assert "broken" not in leaders(results)
    (column,) = [column for column in answer_table(results).columns if column.label == "broken"]
    assert {column[row].text for row in ("on the way", "mean rank")} == {"–"}


def test_one_random_episode_has_no_interval_and_the_answer_says_so():
    results = evaluate(["static", "grounded"], ["random-energy"], episodes=1)
    assert answer(results)[1].endswith("of the paper's law (static) on random-energy; one episode has no interval.")
    table = answer_table(results)
    assert all(column["random-energy"].text.endswith(" ±n/a") for column in table.columns)
    assert "±n/a: too few random episodes or training seeds for an interval" in table.notes
    cells = [column["static"] for column in track_tables(results, results.tracks[0])[0].columns]
    assert {cell.interval for cell in cells if cell.value is not None} == {"n/a"}


def test_policies_that_win_different_episodes_are_not_told_apart(comparison):
    static = comparison.samples["energy", "static"]
    twin = static | {"digits": static["digits"] + [[1.0, -1.0, 1.0, -1.0, 1.0, -0.9]]}
    less = {"static": comparison.policies["static"], "twin": replace(comparison.policies["grounded"], name="twin")}
    tracks = [track for track in comparison.tracks if track.name == "energy"]
    made = replace(
        comparison,
        policies=less,
        tracks=tuple(tracks),
        samples={("energy", "static"): static, ("energy", "twin"): twin},
    )
    assert answer(made) == (
        "twin and static cannot be told apart: they come closest to the Nash equilibrium by the deadline on energy.",
    )


def test_the_answer_about_several_tracks_is_that_of_the_paired_mean_difference(comparison):
    """On no track alone one leads the other, and over both, which play other episodes here, it does."""
    static, change = comparison.samples["energy", "static"], [[0.4, 0.0, 0.3, -0.05, 0.4, -0.1]]
    twin = static | {"digits": static["digits"] + change}
    policies = {"static": comparison.policies["static"], "twin": replace(comparison.policies["grounded"], name="twin")}
    samples = {
        (track.name, name): each for track in comparison.tracks for name, each in (("static", static), ("twin", twin))
    }
    drawn = {name: replace(each, track=("mine", name)) for name, each in comparison.episode_sets.items()}
    made = replace(comparison, policies=policies, samples=samples, episode_sets=drawn)
    for track in comparison.tracks:
        assert made.difference("twin", "static", track.name).low < 0
    assert made.difference("twin", "static", [track.name for track in comparison.tracks]).low > 0
    first, lead = answer(made)
    assert first == "twin comes closest to the Nash equilibrium by the deadline on average over 2 scenarios."
    assert lead.startswith("twin leads the paper's law (static) by 0.16 digits [0.01, 0.31]")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["static", "zero-input"], ["static comes closest to the Nash equilibrium by the deadline on energy."]),
        (["oracle"], ["No policy that is ranked has a result."]),
        (["zero-input"], ["zero-input was compared with no other policy; --policy names others."]),
    ],
)
def test_the_answer_of_few_policies(names, expected):
    assert list(answer(evaluate(names, ["energy"], episodes=2))) == expected


def test_equal_policies_are_not_told_apart_by_one_episode():
    assert answer(evaluate({"a": "static", "b": "static"}, ["random-energy"], episodes=1)) == (
        "a and b cannot be told apart: they come closest to the Nash equilibrium by the deadline on random-energy.",
    )


def test_policies_that_do_not_lead_each_other_come_closest_together():
    again = replace(get_policy_spec("grounded"), name="again")
    results = evaluate(["zero-input", again, "grounded", "oracle"], ["energy"], episodes=2)
    assert answer(results)[0].startswith("again and grounded cannot be told apart: they come closest")


def test_tables_of_a_track_hold_the_metrics_that_have_values(comparison):
    tables = track_tables(comparison, comparison.tracks[0])
    valued = {
        record["metric"] for record in comparison.records if record["track"] == "energy" and record["mean"] is not None
    }
    labels = [column.label for table in tables for column in table.columns]
    assert sorted(labels) == sorted(METRICS[name].label for name in valued)
    digits = tables[0].columns[0]
    for row in tables[0].rows:
        name = row.removesuffix(" *")
        assert digits[row].value == comparison.record("energy", name, "digits")["mean"]
    assert "oracle *" in tables[0].rows


def test_a_policy_that_cannot_act_is_named_with_the_reason(suite):
    plain, robots = (track_tables(suite, track)[0] for track in suite.tracks)
    assert "ppo-nominal" in plain.rows
    assert {column["ppo-nominal"] for column in robots.columns} == {Cell("n/a")}
    for table in (robots, answer_table(suite)):
        (reason,) = [note for note in table.notes if note.startswith("n/a: ppo-nominal on robots: ")]
        assert "was made for another layout" in reason


def test_numbers_have_three_digits():
    values = [None, float("inf"), float("nan"), 0.0, 0.01234, 999.6, 12.0]
    assert [number(value) for value in values] == ["–", "∞", "–", "0", "0.0123", "1.00e3", "12.0"]


def test_digits_have_two_decimals_without_a_negative_zero():
    summaries = [Summary(-0.001, -0.001, -0.001), Summary(-1.5, -1.75, -1.25), Summary(None, None, None), None]
    assert [Cell.plus_minus(summary).text for summary in summaries] == ["0.00", "−1.50 ±0.25", "–", "–"]


def test_an_interval_longer_than_the_scale_of_digits_is_not_shown():
    assert Cell.plus_minus(Summary(0.4, -57.0, 57.8)).text == "0.40 ±n/a"
