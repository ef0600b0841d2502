"""The published numbers: documents show those of results.csv, and three random ones are computed again."""

import csv
import random
import re

import numpy as np
import pytest
import release_check
from scipy import stats

from baselines import algorithms, edge_cases, learned, pages, publish, published, ranking, tune
from ptne_env import CATALOGUE, evaluate, learn
from ptne_env.evaluation import CODED, ENTERED, POLICIES, EpisodeSet, Track
from ptne_env.evaluation.comparison import Job
from ptne_env.evaluation.tracks import compared_tracks
from ptne_env.execution import Runner
from ptne_env.suites import Suite, get_suite, leaderboard, run_suite
from ptne_env.suites.robustness import robustness
from ptne_env.training.configuration import RunSummary, write_record
from ptne_env.training.curve import write_learning_curve

EPISODES = 20
"""The first of the published episodes, at most."""

SUITES = {suite.name: suite for suite in (get_suite("ptne-v1"), *edge_cases.SUITES)} | {
    name: robustness(seed) for name, seed in published.WORLDS.items()
}


def test_every_table_of_the_documents_is_that_of_the_published_numbers():
    for document in published.documents():
        text = document.read_text(encoding="utf-8")
        assert text.count("<!-- table ") == text.count("<!-- end -->")
    assert list(release_check.stale_tables(published.documents())) == [], (
        "python -m baselines.publish --tables writes them anew, in a second"
    )


def job_of(row):
    """The first episodes of a published cell."""
    if row["suite"] == "comparison":
        (track,), names = compared_tracks([row["track"]]), None
    else:
        track, names = SUITES[row["suite"]].track(row["track"]), (row["suite"], row["track"])
    return Job(track, POLICIES[row["policy"]], 0, EpisodeSet(min(EPISODES, int(row["episodes"])), 0, "test", names))


def test_every_family_of_scenarios_has_its_page():
    written = {path.stem: path.read_text("utf-8") for path in pages.PAGES.glob("*.md")}
    assert written == {
        family: pages.page(family, names, published.read()) for family, names in pages.families().items()
    }


def test_three_random_published_numbers_are_computed_again_within_their_statistic():
    large = ("3", "4", "10")  # numbers of episodes of games that take minutes
    rows = [row for row in published.read().rows if row["metric"] == "digits" and row["episodes"] not in ("", *large)]
    for row in random.SystemRandom().sample(rows, 3):
        digits = job_of(row).compute().samples["digits"]
        # The mean of some of the published episodes differs from that of all by at most a t quantile of its own error.
        spread = stats.t.ppf(1 - 1e-5, digits.size - 1) * digits.std(ddof=1) / digits.size**0.5
        assert float(row["mean"]) == pytest.approx(digits.mean(), abs=spread + 0.05), row


def test_every_published_suite_can_be_computed_again():
    suites = {row["suite"]: row for row in published.read().rows if row["metric"] == "digits" and row["episodes"]}
    assert {suite: job_of(row).track.name for suite, row in suites.items()} == {
        suite: row["track"] for suite, row in suites.items()
    }


def test_the_published_numbers_are_of_policies_scenarios_and_tracks_that_exist():
    """New ones have no numbers until ``make publish`` has run; ``make release-check`` waits for them."""
    numbers = published.read()
    tracks, policies = set(numbers.names("track", "comparison")), set(numbers.names("policy", "comparison"))
    assert tracks <= {*CATALOGUE}
    for name, suite in SUITES.items():
        assert set(numbers.names("track", name)) <= {track.name for track in suite.tracks}
        policies |= set(numbers.names("policy", name))
    assert policies <= {*POLICIES}
    assert set(published.missing(numbers)) == ({*CATALOGUE} - tracks) | ({*ENTERED, *CODED} - policies)


def test_a_small_run_gives_rows_from_which_every_table_of_the_suite_is_written(tmp_path):
    policies = ["static", "relay", "coded-relay", published.PPO, published.TRAINED, "oracle"]
    results = run_suite("ptne-v1", policies, tracks=["coupled", "switching-physical"], episodes=8)
    rows = list(publish.rows_of(results))
    published.write_rows(tmp_path / "results.csv", rows)
    numbers = published.read(tmp_path / "results.csv")
    lead = results.difference(published.TRAINED, "static", "switching-physical")
    cell = numbers.cell("ptne-v1", "switching-physical", published.TRAINED, published.MINUS_PAPER)
    assert float(cell["low"]) == pytest.approx(lead.low, rel=1e-6)
    assert lead.low > 0
    table = published.headline(numbers)
    for track in ("coupled", "switching-physical"):
        law, _ = published.best_law(numbers, "ptne-v1", track)
        three = [name for name in results.ranked(track) if name in (law, published.PPO, published.TRAINED)]
        digits = f"{results.record(track, three[0], 'digits')['mean']:.2f}{f' {law}' * (three[0] == law)}"
        lead = results.difference(*three[:2], track)
        bold = re.escape(f"**{digits}**" if lead.low > 0 else digits)
        assert re.search(rf"\| {track} .*\| {bold} \|", table)
    assert "**" in table.replace("**score**", "")
    score = next(row for row in leaderboard(results) if row.policy == "static")
    digits, on_the_way, worst = (
        f"{summary.mean:.2f}" for summary in (score.score, score.on_the_way, score.worst_tenth)
    )
    assert re.search(rf"\| static \| {digits} \[.*\] \| {on_the_way} \[.*\] \| {worst} ", published.overall(numbers))
    assert numbers.ranked("ptne-v1", "coupled") == [*results.ranked("coupled")]
    assert "zero-input" in published.all_policies(numbers, "ptne-v1")


@pytest.mark.parametrize("algorithm", ["ippo", "sb3-sac"])
def test_what_is_trained_gives_a_row_and_the_best_seed_on_validation_episodes_ships(algorithm, tmp_path, monkeypatch):
    (budget, *_), seeds, *_ = algorithms.PLANS[algorithm]
    shipped = learn.shipped_path("ppo-rounding").read_bytes()
    for seed in seeds:
        run = algorithms.folder_of(algorithm, "rounding", budget, tmp_path) / f"seed-{seed}"
        run.mkdir(parents=True)
        other = learn.shipped_path("ppo-nominal").read_bytes()
        (run / "policy.npz").write_bytes(shipped if seed == seeds[-1] else other)
        (run / "core-seconds.json").write_text("90.0")
        write_record(run / "summary.json", RunSummary(budget + 48_000, 0, 90.0, digits=seed / 4))
        write_learning_curve(run, [0, 80, 100], [[0.0, 0.0], [2.0, 2.0], [2.0, 2.0 + seed / 100]])
    monkeypatch.setattr(algorithms, "PICTURE", tmp_path / "algorithms.png")
    for module in (algorithms, published):
        monkeypatch.setattr(module, "TRAININGS", tmp_path / "algorithms.csv")
    monkeypatch.setattr(algorithms, "CURVES", tmp_path / "curves.csv")
    kept = {"track": "nominal", "policy": algorithm, "metric": "digits", "mean": "1"}
    replaced = {"track": "rounding", "policy": algorithm, "metric": "digits", "mean": "-2"}
    published.write_rows(tmp_path / "algorithms.csv", [replaced, kept])
    published.write_rows(tmp_path / "curves.csv", [], algorithms.CURVE_COLUMNS)
    monkeypatch.setattr(learn, "__file__", str(tmp_path / "__init__.py"))
    algorithms.publish(tmp_path, jobs=1)
    rows = published.read().rows
    assert [row["mean"] for row in rows if row["track"] == "nominal" and row["suite"] == ""] == ["1"]  # of a former run
    assert "-2" not in {row["mean"] for row in rows if row["suite"] == "algorithms"}
    assert (tmp_path / "curves.csv").read_text().splitlines()[1:4] == [
        f"rounding,{algorithm},0,{point}" for point in ("0,0", "1.2,2", "1.5,2")
    ]
    file = tmp_path / "ppo-rounding.npz"
    assert file.exists() == algorithms.PLANS[algorithm].ships
    for digits, expected in ((1.5, shipped), (3.0, other)) if file.exists() else ():
        assert file.read_bytes() == shipped
        write_record(run.with_name("seed-0") / "summary.json", RunSummary(budget, 0, 90.0, digits=digits))
        algorithms.ship("rounding", run.parent)  # the file has about 2
        assert file.read_bytes() == expected
    assert (tmp_path / "algorithms.png").stat().st_size > 10_000
    played = evaluate({name: learn.load(f"ppo-{name}") for name in ("nominal", "rounding")}, "ptne-v1/rounding")
    nominal, rounding = (samples["digits"].mean() for samples in played.samples.values())
    means = [*[nominal] * (len(seeds) - 1), rounding]
    line = published.algorithms(published.read()).splitlines()[-1]
    assert line.startswith(f"| rounding | {algorithm} | {np.mean(means):.2f} [")
    gained = f"{np.mean(seeds) / 200:.2f}"
    assert line.endswith(f"| {np.std(means, ddof=1):.2f} | {len(seeds)} | {budget // 10**6} M | 1.5 | {gained} |")


def test_a_training_without_a_mechanism_lacks_the_worlds_that_have_it():
    every = {track.name for track in learned.worlds()}
    left_out = {name: len(every) - len({track.name for track in learned.worlds(name)}) for name in learned.LEFT_OUT}
    assert left_out == {"liar": 5, "rounding": 9, "short-deadline": 2, "coupled": 2}
    assert {*left_out} <= {track.name for track in get_suite("ptne-v1").tracks}
    with pytest.raises(KeyError, match="lair"):
        learned.worlds("lair")


def test_a_name_with_a_comma_survives_the_file_of_results(tmp_path):
    row = {"suite": "mine", "track": "20 players, directed", "policy": "relay", "metric": "digits", "mean": "1.5"}
    published.write_rows(tmp_path / "results.csv", [row])
    assert published.read(tmp_path / "results.csv").cell("mine", "20 players, directed", "relay")["mean"] == "1.5"


def test_tables_of_random_worlds_count_failures_and_shortfalls_behind_the_best_rival():
    def row(world, policy, metric, mean, low="", high=""):
        numbers = {"mean": mean, "low": low, "high": high}
        return {"suite": "robustness", "track": world, "policy": policy, "metric": metric} | numbers

    digits = {
        "world-001": {"static": "1", "relay": "3", "grounded": "0.5", "coded-relay": "9", "zero-input": "8"},
        "world-002": {"static": "2", "relay": "1", "grounded": "1.9", "coded-relay": "1", "zero-input": "0"},
    }
    rows = [row(world, name, "digits", mean) for world, means in digits.items() for name, mean in means.items()]
    rows += [
        row("world-002", "relay", published.MINUS_PAPER, "-1", "-1.5", "-0.5"),
        row("world-002", "coded-relay", published.MINUS_PAPER, "-1", "-2.1", "0.1"),
        row("world-001", "grounded", "diverged_share", "0.2"),
    ]
    numbers = published.Published(rows)
    assert published.best_on(numbers, "robustness", "world-001") == ("relay", 3.0)
    failing = {
        policy: published.failures(numbers, ["robustness"], policy) for policy in numbers.names("policy", "robustness")
    }
    assert failing.pop("relay") == [("robustness", "world-002")]
    assert failing.pop("grounded") == [("robustness", "world-001")]
    assert not any(failing.values())
    lines = published.shortfalls(numbers, published.WORLDS).splitlines()[2:]
    assert "| relay | 1 | 1 of 2 | 0.50 [-5.85, 6.85] | 1.00 |" in lines
    assert "| coded-relay ‡ | 0 | 1 of 2 | -2.50 [-46.97, 41.97] | 1.00 |" in lines
    (line,) = (line for line in published.failed_worlds(numbers).splitlines() if "world-002" in line)
    assert line.endswith("| 2.00 | 1.90 | – | **1.00** | – | static 2.00 |")


def test_an_entry_that_raises_an_error_is_not_published():
    class Silent:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            raise ArithmeticError("no answer")

    results = evaluate({"mine": Silent()}, "energy", episodes=1)
    with pytest.raises(RuntimeError, match="mine fails on energy of comparison, so nothing is published"):
        list(publish.rows_of(results))


def test_constants_are_tuned_from_those_of_the_entry_on():
    row = tune.search("grounded", 1, 0, Runner())
    assert row["policy"] == "grounded"
    assert row["constants"].startswith("kappa=")
    assert float(row["digits"]) >= float(row["digits before"])
    with tune.OUTPUT.open(encoding="utf-8", newline="") as file:
        assert [row["policy"] for row in csv.DictReader(file)] == [*tune.TUNED]


def test_every_scored_track_leaves_room_below_the_oracle():
    digits = {track.name: {} for track in get_suite("ptne-v1").tracks if track.scored}
    for row in published.read().rows:
        if row["suite"] == "ptne-v1" and row["track"] in digits and row["metric"] == "digits":
            digits[row["track"]][row["policy"]] = float(row["mean"])
    for found in digits.values():
        assert found.pop("oracle") > max(found.values()) + 0.5


def test_one_principal_component_explains_tracks_that_rank_alike_and_not_others():
    generator = np.random.default_rng(0)
    alike = np.outer(generator.normal(size=8), [1.0, 2.0, 5.0])
    assert ranking.principal_share(alike) == pytest.approx(1)
    assert ranking.principal_share(np.linalg.qr(generator.normal(size=(8, 3)))[0]) < 0.6


@pytest.mark.parametrize(("episodes", "line"), [(1, "cannot be told from static, by"), (6, "leads static, by")])
def test_an_entry_leads_a_track_where_the_interval_says_so(episodes, line):
    suite = Suite("tiny", (Track("energy", "random-energy", "A track."),), episodes)
    assert ranking.leads(run_suite(suite, ["grounded"]))[0].startswith(f"energy: grounded {line}")
