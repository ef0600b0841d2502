"""The command line, in a subprocess, as a person runs it."""

import csv
import json
import subprocess
import sys

import pytest


def ptne(*arguments, cwd=None):
    return subprocess.run(  # noqa: S603 - our own command line
        [sys.executable, "-W", "error", "-m", "ptne_env.cli", *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=cwd,
        check=False,
        timeout=300,
    )


@pytest.mark.parametrize("command", ["compare", "reproduce", "certify", "list"])
def test_every_command_has_help(command):
    outcome = ptne(command, "--help")
    assert outcome.returncode == 0
    assert "Usage" in outcome.stdout
    assert len(outcome.stdout.splitlines()) > 5


def test_list_shows_scenarios_policies_and_metrics():
    outcome = ptne("list")
    assert outcome.returncode == 0
    for name in ("energy-switching-transformed", "non-quadratic-printed", "corollary-one", "oracle", "velocity_energy"):
        assert name in outcome.stdout


def test_compare_prints_a_table_and_writes_json_and_csv(tmp_path):
    outcome = ptne(
        *("compare", "--scenario", "energy", "--policy", "static", "--policy", "oracle", "--episodes", "4"),
        *("--json", "out/results.json", "--csv", "out/results.csv"),
        cwd=tmp_path,
    )
    assert outcome.returncode == 0, outcome.stderr
    assert "energy: how close" in outcome.stdout
    assert "6.53e-5" in outcome.stdout  # the static law from the paper's start
    assert "oracle *" in outcome.stdout
    data = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    rows = list(csv.DictReader((tmp_path / "out" / "results.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == len(data["records"]) == 2 * 2 * 18
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"results.json", "results.csv"}


def test_compare_json_to_stdout_is_json_alone():
    outcome = ptne(
        "compare", "--scenario", "energy", "--policy", "null", "--episodes", "2", "--seed", "9", "--json", "-"
    )
    data = json.loads(outcome.stdout)
    assert data["seed"] == 9
    assert {record["policy"] for record in data["records"]} == {"null"}


def test_compare_takes_a_policy_by_module_and_object():
    outcome = ptne(
        "compare", "--scenario", "energy", "--policy", "ptne_env.laws:Grounded", "--episodes", "1", "--json", "-"
    )
    digits = [record["mean"] for record in json.loads(outcome.stdout)["records"] if record["metric"] == "digits"]
    assert digits == pytest.approx([12.0, 12.0], abs=4e-15)  # as near as a natural logarithm comes


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compare", "--scenario", "energie"), "unknown scenario 'energie'"),
        (("compare", "--policy", "statics"), "unknown policy 'statics'"),
        (("compare", "--episodes", "0"), "--episodes"),
        (("certify", "energie"), "unknown scenario 'energie'"),
        (("certify", "energy", "--kappa", "-1"), "kappa"),
        (("no-such-command",), "No such command"),
    ],
)
def test_wrong_usage_exits_with_2_names_what_was_wrong_and_shows_no_traceback(arguments, message):
    outcome = ptne(*arguments)
    assert outcome.returncode == 2
    assert message in outcome.stderr
    assert "Traceback" not in outcome.stderr


def test_an_unwritable_file_exits_with_1(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way", encoding="utf-8")
    outcome = ptne(
        "compare", "--scenario", "energy", "--policy", "null", "--episodes", "1", "--csv", str(blocked / "x.csv")
    )
    assert outcome.returncode == 1
    assert "Traceback" not in outcome.stderr
    assert blocked.read_text(encoding="utf-8") == "in the way"


def test_certify_prints_the_numbers_of_the_paper_and_json():
    outcome = ptne("certify", "energy")
    assert outcome.returncode == 0
    for text in ("ε = 2.10", "ι = 2.60", "κ > 4.21", "0.280", "unbounded"):
        assert text in outcome.stdout
    data = json.loads(ptne("certify", "energy", "--json", "-").stdout)
    assert data["rate"] == pytest.approx(0.280, abs=5e-4)
