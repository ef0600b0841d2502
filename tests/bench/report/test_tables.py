"""Tables of results, and of the catalogue, in the terminal."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.cells import cell_len
from rich.console import Console

from ptne_env import CATALOGUE, FactorySpec, PolicySpec, evaluate
from ptne_env import learn as policies
from ptne_env.bench.report import Kind, answer_tables, catalogue, check_tables, page, result_tables
from ptne_env.bench.report.tables import overview, summary_tables, track_tables
from ptne_env.evaluation import (
    METRICS,
    POLICIES,
    Metric,
    default_policies,
    get_policy_spec,
    get_suite,
    register,
    suite_policies,
)
from ptne_env.evaluation.check import Check, Repetition
from ptne_env.evaluation.metrics import number, share
from ptne_env.evaluation.suite import SUITES
from ptne_env.evaluation.traces import scenes
from ptne_env.perception.observation import Interface
from ptne_env.world.catalogue import DESCRIPTIONS


def written(tables, width=172):
    stream = io.StringIO()
    Console(file=stream, width=width).print(tables)
    return stream.getvalue()


@pytest.mark.parametrize("width", [80, 100, 172])
def test_result_tables_fit_the_terminal_and_lose_nothing(comparison, suite, width):
    for results in (comparison, suite):
        text = written(result_tables(results, width), width)
        assert "…" not in text
        assert max(map(cell_len, text.splitlines())) <= width
        words = set(text.split())
        for record in results.records:
            if record["mean"] is not None:
                assert number(record["mean"]) in words


@pytest.mark.parametrize("width", [80, 120])
def test_tables_of_a_check_fit_the_terminal_and_lose_nothing(suite, width):
    job = replace(suite.jobs[0], policy=replace(suite.jobs[0].policy, name="ppo-random-energy-switching-transformed"))
    reason = f"step 0: {60 * 'long '}reason"
    repetitions = [
        Repetition(job, 0.0, None, -1.23, -0.0996, 0.0571, knows_episodes=False),
        Repetition(
            replace(job, policy=replace(job.policy, name="zero-input")), 0.0, None, 1.2, 1.2, 0.5, knows_episodes=False
        ),
        Repetition(job, 1.23e-10, None, 11.23, -0.0996, 1.23e-5, knows_episodes=True),
        Repetition(job, 0.0, reason, None, None, None, knows_episodes=False),
        Repetition(job, np.inf, reason, 3.21, None, None, knows_episodes=False),
    ]
    text = written(check_tables(Check((), tuple(repetitions)), 0.0), width)
    assert "…" not in text
    assert max(map(cell_len, text.splitlines())) <= width
    assert {"reproduces", "better", "fails", "again"} <= set(text.split())
    assert text.count("long") == 2 * 60
    assert "zero-input" in text.split()  # a short name stays whole


def test_blocks_hold_the_metrics_of_the_registry(comparison):
    track = comparison.tracks[0]
    tables = track_tables(comparison, track)
    labels = [column.label.replace("\N{NO-BREAK SPACE}", " ") for table in tables for column in table.columns]
    assert labels == [
        metric.label
        for metric in METRICS.values()
        if any(
            record["metric"] == metric.name and record["track"] == track.name and record["mean"] is not None
            for record in comparison.records
        )
    ]
    digits = tables[0].columns[0]
    for policy in tables[0].rows:
        assert digits[policy].value == comparison.record(track.name, policy, "digits")["mean"]


def test_best_policy_comes_first_and_oracles_are_marked(comparison, suite):
    for results in (comparison, suite):
        for track in results.tracks:
            table = track_tables(results, track)[0]
            ranked = [policy for policy, division in table.rows.items() if division == "honest"]
            means = [results.record(track.name, policy, "digits")["mean"] for policy in ranked]
            assert means == sorted(means, reverse=True)
            assert table.sections["oracle"] == ["oracle"]
            assert list(table.rows)[-1] == "oracle"
        assert "oracle *" in written(result_tables(results))


def test_policy_that_cannot_act_is_listed_with_the_reason(suite):
    plain, robots = (track_tables(suite, track)[0] for track in suite.tracks)
    assert "ppo-random-energy" in plain.rows
    assert "ppo-random-energy" not in robots.rows
    assert robots.notes[0].startswith("n/a: ppo-random-energy: the policy was made for another layout")
    assert "ppo-random-energy" not in [column.label for column in summary_tables(suite)[2].columns]


def test_overview_shows_the_scores_of_the_leaderboard(suite, comparison):
    tables = overview(suite)
    for row in suite.leaderboard.overall:
        (table,) = (table for table in tables if row.policy in table.rows)
        columns = {column.label: column for column in table.columns}
        assert columns["score"][row.policy].value == row.score.mean
        assert columns["graphs"][row.policy].text == ("all" if row.policy == "oracle" else "own links")
        assert columns["memory"][row.policy].text == ("yes" if row.policy == "adaptive" else "no")
        assert columns["estimates"][row.policy].text == "honest"
    ranked = [row.policy for row in suite.leaderboard.overall]
    assert [name for table in tables for name in table.rows] == sorted(ranked, key="ppo-random-energy".__eq__)
    assert tables[-1].notes == ("Scores are means over 2 tracks; n/a and failed count as zero input.",)
    assert "score" not in {column.label for column in overview(comparison)[0].columns}


def test_means_are_over_the_same_tracks_and_specialists_stand_apart(suite):
    complete, specialists = overview(suite)
    assert set(complete.rows) == {"grounded", "adaptive", "static", "zero-input", "oracle"}
    for name, value in complete.columns[0].values.items():
        if name in complete.rows:
            means = [suite.record(track.name, name, "digits")["mean"] for track in suite.tracks]
            assert value.value == pytest.approx(np.mean(means))
    assert list(specialists.rows) == ["ppo-random-energy"]
    cells = {column.label: column["ppo-random-energy"] for column in specialists.columns}
    learned, grounded = (suite.record("plain", name, "digits")["mean"] for name in ("ppo-random-energy", "grounded"))
    assert cells["tracks"].text == "plain"
    assert cells["digits there"].value == pytest.approx(learned)
    assert cells["best of the above there"].text == "grounded"
    assert cells["its digits there"].value == pytest.approx(grounded)
    assert cells["ahead"].value == pytest.approx(learned - grounded)
    of_complete, of_specialists = (table for table in summary_tables(suite)[2:4])
    assert list(of_complete.rows) == ["plain", "robots"]
    assert list(of_specialists.rows) == ["plain"]


def test_policies_that_play_no_track_are_named_below_the_tables():
    results = evaluate(["static", get_policy_spec("ppo-random-energy")], ["energy", "robots"], episodes=1)
    tables = overview(results)
    assert [name for table in tables for name in table.rows] == ["static", "ppo-random-energy"]
    results = evaluate(default_policies(), ["robots"], episodes=1)
    (table,) = overview(results)
    assert table.notes[0].startswith("n/a on every track: ppo-")
    assert "best specialist" not in written(answer_tables(results))


@pytest.mark.parametrize("width", [80, 100, 172])
def test_the_answer_is_one_table_that_fits_the_terminal(comparison, suite, width):
    for results in (comparison, suite):
        text = written(answer_tables(results, width), width)
        assert "…" not in text
        assert max(map(cell_len, text.splitlines())) <= width
        assert text.count("grounded") >= 1
        (missing,) = re.findall(r"--details, also shows (.*?)\.", " ".join(text.split())) or [""]
        heading = text[: text.index("─")]
        for name in results.policies:
            is_specialist = name not in list(overview(results)[0].rows)
            assert is_specialist or name in missing or all(part in heading for part in re.findall(r"\w+", name))
        digits = results.record(results.tracks[0].name, "static", "digits")
        assert f"{digits['mean']:.2f} ±{digits['high'] - digits['mean']:.2f}" in text


def test_first_place_is_shared_within_a_tenth_of_a_digit(comparison):
    column = next(column for column in overview(comparison)[0].columns if column.label == "first")
    assert column["grounded"].value == len(comparison.tracks)
    assert column["zero-input"].value == 0
    assert column["oracle"].value is None


def test_coded_entries_stand_apart_from_honest_ones_and_oracles():
    coded = PolicySpec("code", FactorySpec.of("ptne_env.laws:Grounded"), Interface(estimates="coded"))
    results = evaluate([coded, "static", "oracle", "grounded"], ["energy"], episodes=2, against_laws=False)
    for table in [overview(results)[0], track_tables(results, results.tracks[0])[0]]:
        assert table.sections == {"honest": ["grounded", "static"], "coded": ["code"], "oracle": ["oracle"]}
    assert [column.label for column in summary_tables(results)[1].columns][2:] == ["code †", "oracle *"]
    estimates = next(column for column in overview(results)[0].columns if column.label == "estimates")
    assert [estimates[name].text for name in ("grounded", "code")] == ["honest", "coded"]
    firsts = next(column for column in overview(results)[0].columns if column.label == "first")
    assert [firsts[name].value for name in ("grounded", "code")] == [1, 1]
    text = written(result_tables(results))
    assert "code †" in text
    assert "† coded: " in text


def test_room_table_names_the_tracks_on_which_little_is_left(suite):
    room = summary_tables(suite)[-1]
    assert list(room.rows) == [track.name for track in suite.tracks]
    columns = {column.label: column for column in room.columns}
    for scale in suite.leaderboard.scales:
        assert columns["best honest"][scale.track].value == scale.best_digits
        assert columns["room"][scale.track].value == scale.room == pytest.approx(12 - scale.best_digits)
        assert (scale.track in room.notes[0]) == (scale.room < 1)


def test_learned_policy_stands_beside_the_tuned_laws():
    results = evaluate(["ppo-random-energy"], ["random-energy"], episodes=3, against_laws=True)
    table = track_tables(results, results.tracks[0])[-1]
    assert list(table.rows) == ["ppo-random-energy"]
    assert [column.values["ppo-random-energy"].value for column in table.columns] == [
        results.record("random-energy", "ppo-random-energy", metric.name)["mean"]
        for metric in METRICS.values()
        if metric.block == "Against tuned laws"
    ]
    assert [note.partition(": ")[0] for note in table.notes] == [
        law.name for law in results.tuned["random-energy"].values()
    ]


def test_suite_without_scores_has_a_table_over_all_tracks(suite):
    unscored = replace(suite)
    scales = tuple(replace(scale, has_scores=False) for scale in suite.leaderboard.scales)
    unscored.__dict__["leaderboard"] = replace(suite.leaderboard, overall=(), scales=scales)
    tables = overview(unscored)
    assert tables[-1].notes[0].startswith("No track has scores")
    assert {name for table in tables for name in table.rows} == set(suite.policies)


def test_new_metric_is_in_every_table():
    try:
        register(
            Metric("brightness", "brightness", "always 7", value=lambda rollout: np.full(len(rollout.diverged), 7.0))
        )
        results = evaluate(["static"], ["energy"], episodes=2)
        for text in (written(result_tables(results)), written(catalogue()), page(results, scenes(results))):
            assert "brightness" in text
    finally:
        METRICS.pop("brightness", None)


def test_the_catalogue_splits_no_word_in_a_narrow_terminal():
    narrow, wide = (written(catalogue(), width) for width in (80, 400))
    assert max(map(cell_len, narrow.splitlines())) <= 80
    assert narrow.split() == wide.split()
    names = narrow.splitlines()
    assert {*CATALOGUE, *POLICIES, *policies.shipped(), *METRICS} <= set(names)
    assert {f"{suite}/{track.name}" for suite in SUITES for track in get_suite(suite).tracks} <= set(names)


def test_every_scenario_policy_and_track_has_a_sentence_of_its_own():
    sentences = [
        *DESCRIPTIONS.values(),
        *(spec.description for spec in suite_policies()),
    ]
    assert len(set(sentences)) == len(sentences) == len(CATALOGUE) + len(POLICIES) + len(policies.shipped())
    for suite in map(get_suite, SUITES):
        changes = [track.change for track in suite.tracks]
        assert len(set(changes)) == len(changes)
        sentences += changes
    for sentence in sentences:
        assert sentence.endswith(".")
        assert sentence[0].isupper() or sentence[0].isdigit()


def test_the_catalogue_may_be_of_one_kind():
    text = written(catalogue([Kind.SUITES]))
    assert "ptne-v1/delay" in text
    assert "weakly-monotone" not in text.splitlines()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (float("inf"), "∞"),
        (float("nan"), "–"),
        (0.0, "0"),
        (0.01234, "0.0123"),
        (999.6, "1.00e3"),
        (12.0, "12.0"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_shares_have_three_decimals_and_no_negative_zero():
    assert [share(value) for value in (None, 0.5, -1e-9)] == ["–", "0.500", "0.000"]
