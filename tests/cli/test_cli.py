"""The command line, in a subprocess, as a person runs it."""

import csv
import html
import json
import os
import pty
import re
import select
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from extras import need_sb3

from ptne_env.cli import console
from ptne_env.cli.app import ExitCode, main
from ptne_env.shared.files import DamagedFileError

FILES = {"results.json", "results.csv", "marl-eval.json", "jobs"}

ROOT = Path(__file__).parents[2]
COMMANDS = ("compare", "check", "render", "certify", "reproduce", "train", "list")
LONG = {
    "compare": "compare energy --policy static,adaptive,grounded --episodes 3000 --out out",
    "suite": "compare --suite ptne-v1 --track delay --track noise --policy adaptive,grounded --jobs 2 --out out",
    "render": "render energy static --out out.gif --pictures 400",
    "reproduce": "reproduce --out out",
    "train": "train random-energy --out out --steps 2000000",
}
"""Commands that take a while, and write to out or out.*."""


def ptne(*arguments, cwd=None, **environment):
    if "train" in arguments and "--help" not in arguments:
        need_sb3()
    return subprocess.run(  # noqa: S603 - our own command line
        [sys.executable, "-W", "error", "-m", "ptne_env.cli", *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=cwd,
        check=False,
        timeout=300,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command):
    outcome = ptne(command, "--help")
    assert outcome.returncode == 0
    assert "Usage" in outcome.stdout
    assert len(outcome.stdout.splitlines()) > 5


def is_alive(group):
    """Whether a process of this group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def in_terminal(arguments, cwd, *, until=None, **environment):
    """Run a command in a terminal of 80 columns, interrupt it once ``until`` is printed; exit code and output."""
    if "train" in arguments:
        need_sb3()
    ours, theirs = pty.openpty()
    # Tests that run in the background ignore interruptions, and so would their subprocesses.
    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(  # noqa: S603 - our own command line
        [sys.executable, "-W", "error", "-m", "ptne_env.cli", *arguments],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=cwd,
        start_new_session=True,
        env={**os.environ, "COLUMNS": "80", "LINES": "40", "TERM": "xterm-256color", **environment},
    )
    signal.signal(signal.SIGINT, ignored)
    os.close(theirs)
    printed, deadline = b"", time.monotonic() + 200
    while time.monotonic() < deadline:
        if select.select([ours], [], [], 0.2)[0]:
            try:
                printed += os.read(ours, 65536)
            except OSError:  # how Linux tells that the other side is closed
                break
        if until is not None and re.search(until, printed.decode(errors="ignore")):
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to workers too
            until = None
    os.close(ours)
    code = process.wait(60)
    while is_alive(process.pid):
        assert time.monotonic() < deadline, "workers stayed behind"
        time.sleep(0.2)
    return code, printed.decode(errors="ignore")


@pytest.mark.parametrize("name", LONG)
def test_interrupted_work_showed_the_time_left_and_leaves_complete_files(name, tmp_path):
    code, printed = in_terminal(LONG[name].split(), tmp_path, until=r"\d/\d+.*\d:\d\d:\d\d")
    assert code == 130
    assert "Interrupted" in printed
    assert "Traceback" not in printed
    files = [path for path in tmp_path.rglob("*") if path.is_file() and "tensorboard" not in path.parts]
    assert [path for path in files if path.name.startswith(".")] == []
    for path in files:
        assert path.suffix in (".json", ".npz", ".png", ".svg", ".zip")
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))


def test_a_terminal_gets_colours_and_none_with_no_color(tmp_path):
    code, printed = in_terminal(["certify", "energy"], tmp_path)
    assert code == 0
    assert "\x1b[32mholds" in printed
    code, printed = in_terminal(["certify", "energy"], tmp_path, NO_COLOR="1")
    assert code == 0
    assert "holds" in printed
    assert "\x1b" not in printed


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["ptne", ""], set(COMMANDS)),
        (["ptne", "compare", "random-energy-"], {"random-energy-switching"}),
        (["ptne", "compare", "--scenario", "random-energy-"], {"random-energy-switching"}),
        (
            ["ptne", "compare", "--policy", "ppo-random"],
            {"ppo-random-energy", "ppo-random-energy-switching-transformed"},
        ),
        (["ptne", "compare", "--policy", "static,gr"], {"static,grounded"}),
        (["ptne", "compare", "--suite", ""], {"ptne-v1", "ptne-v2"}),
        (["ptne", "compare", "--suite", "ptne-v1", "--track", "large"], {"large-20", "large-50"}),
        (["ptne", "render", "ptne-v1/d"], {"ptne-v1/delay"}),
        (["ptne", "render", "energy", "grou"], {"grounded"}),
        (["ptne", "certify", "energy-s"], {"energy-switching", "energy-switching-transformed"}),
        (["ptne", "train", "ptne-v1-m"], {"ptne-v1-markov"}),
        (["ptne", "compare", "--no-r"], {"--no-report"}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_the_shell_completes_names(words, expected):
    environment = {"COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    outcome = ptne(**environment, _PTNE_COMPLETE="complete_bash")
    assert outcome.stderr == ""
    found = set(outcome.stdout.split())
    assert expected <= found
    assert all(name.startswith(words[-1]) for name in found)


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_the_completion_script_works_in_a_real_bash(tmp_path):
    (tmp_path / "ptne").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ptne_env.cli "$@"\n', encoding="utf-8")
    (tmp_path / "ptne").chmod(0o755)
    script = ptne(_PTNE_COMPLETE="source_bash").stdout
    script += '\nCOMP_WORDS=(ptne certify energy-s); COMP_CWORD=2; _ptne_completion ptne; echo "${COMPREPLY[*]}"'
    paths = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    outcome = subprocess.run(  # noqa: S603 - a script that we wrote
        [str(shutil.which("bash")), "--norc", "-c", script],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **paths},
    )
    assert outcome.stdout.split() == ["energy-switching", "energy-switching-transformed"]


def test_list_writes_json_of_all_kinds():
    listed = json.loads(ptne("list", "--json", "-").stdout)
    assert set(listed) == {"scenarios", "policies", "metrics", "suites"}
    assert listed["metrics"]["settling_time"]["unit"] == "s"
    assert listed["scenarios"]["robots"]["description"].startswith("Five robots in the plane")
    assert set(json.loads(ptne("list", "policies", "--json", "-").stdout)) == {"policies"}


def test_list_shows_scenarios_policies_and_metrics():
    outcome = ptne("list")
    assert outcome.returncode == 0
    for name in ("energy-switching-transformed", "non-quadratic-printed", "corollary-one", "oracle", "velocity_energy"):
        assert name in outcome.stdout


def test_compare_prints_a_table_and_writes_json_and_csv(tmp_path):
    outcome = ptne(
        *("compare", "energy", "--policy", "static", "--policy", "oracle", "--episodes", "4"),
        *("--jobs", "1", "--json", "there/again.json", "--details"),
        cwd=tmp_path,
    )
    assert outcome.returncode == 0, outcome.stderr
    assert "energy: how close" in outcome.stdout
    assert "oracle *" in outcome.stdout
    folder = tmp_path / "results" / "comparison"
    assert {path.name for path in folder.iterdir()} == {*FILES, "report.html"}
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    rows = list(csv.DictReader((folder / "results.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == len(data["records"]) + len(data["timings"])
    assert (tmp_path / "there" / "again.json").read_bytes() == (folder / "results.json").read_bytes()
    assert "static is the closest to the Nash equilibrium" in (folder / "report.html").read_text(encoding="utf-8")
    assert "Report written to results/comparison/report.html" in outcome.stdout


COMPARISON = "compare --scenario energy-switching --scenario random-energy --policy grounded,static,ppo-random-energy"


def test_compare_ends_with_the_answer_in_one_screen(tmp_path):
    command = [*COMPARISON.split(), "--episodes", "3", "--jobs", "1"]
    lines = ptne(*command, cwd=tmp_path).stdout.splitlines()
    assert len(lines) < 40
    assert lines[0].startswith("Digits at the deadline ± half of the 95 % interval, 3 episodes")
    text = " ".join(lines)
    assert (
        "grounded and ppo-random-energy are each the closest to the Nash equilibrium at the deadline, up to 0.1 digits "
        "and the 95 % interval, on 1 of 2 scenarios" in text
    )
    assert "Elsewhere the closest is a law that is tuned for the scenario on energy-switching" in text
    assert "how close" not in text
    assert lines[-2:] == [
        "Report written to results/comparison/report.html: open it in a browser",
        "All metrics of all policies: the same command with --details",
    ]


def test_the_command_on_the_page_repeats_the_page(tmp_path):
    command = [*COMPARISON.split(), "--episodes", "3", "--seed", "4", "--hold-steps", "5", "--jobs", "1"]
    page = tmp_path / "results" / "comparison" / "report.html"
    assert ptne(*command, cwd=tmp_path).returncode == 0
    first = page.read_bytes()
    *sections, whole = [
        shlex.split(html.unescape(text)) for text in re.findall("<pre tabindex.*?><code>(.*?)</code>", first.decode())
    ]
    page.unlink()
    outcome = ptne(*whole[1:], "--jobs", "1", cwd=tmp_path)  # in the same folder, so that timings are the stored ones
    assert outcome.returncode == 0, outcome.stderr
    assert page.read_bytes() == first
    jobs = {path.name for path in (page.parent / "jobs").iterdir()}
    assert len(sections) == 2
    outcome = ptne(*sections[0][1:], "--jobs", "1", "--out", "again", "--no-report", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    again = {path.name for path in (tmp_path / "again" / "jobs").iterdir()}
    assert again < jobs  # what is run again has the same key


def test_files_are_written_unless_the_output_is_json(tmp_path):
    arguments = ("compare", "energy", "--policy", "zero-input", "--episodes", "1", "--jobs", "1")
    assert json.loads(ptne(*arguments, "--json", "-", cwd=tmp_path).stdout)["seed"] == 0
    assert not any(tmp_path.iterdir())
    assert json.loads(ptne(*arguments, "--json", "-", "--no-report", "--out", "out", cwd=tmp_path).stdout)["seed"] == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES


def test_render_writes_a_video(tmp_path):
    outcome = ptne("render", "energy", "static", "--out", "videos/run.html", "--hold-steps", "5", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert "Video written to videos/run.html" in outcome.stdout
    assert "energy: static" in (tmp_path / "videos" / "run.html").read_text(encoding="utf-8")


def test_compare_json_to_stdout_is_json_alone():
    outcome = ptne("compare", "energy", "--policy", "zero-input", "--episodes", "2", "--seed", "9", "--json", "-")
    data = json.loads(outcome.stdout)
    assert data["seed"] == 9
    assert {record["policy"] for record in data["records"]} == {"zero-input"}


TALKATIVE = """
import numpy as np
from ptne_env import laws

def make(layout):
    print("making a policy")
    return laws.ZeroInput(layout)

def broken(layout):
    return 1 / 0
"""


@pytest.fixture
def own_module(tmp_path):
    """A folder with a module whose policy prints, and one that fails."""
    (tmp_path / "talkative.py").write_text(TALKATIVE, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    "command",
    [
        "compare energy --policy talkative:make --episodes 1 --trust",
        "compare --suite ptne-v1 --track nominal --policy talkative:make --trust --episodes 2 --jobs 2 --no-report",
        "certify energy",
        "train random-energy --steps 1 --out out",
        "list",
    ],
)
def test_json_on_stdout_is_json_alone_when_other_code_prints(command, own_module):
    outcome = ptne("-q", *command.split(), "--json", "-", cwd=own_module)
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)
    assert "making a policy" not in outcome.stderr  # the output of a foreign policy is not shown


def test_a_scenario_of_an_own_module_is_compared(tmp_path):
    text = (
        "from ptne_env import get_scenario\n\nmine = get_scenario('energy', name='mine', start='random', steps=120)\n"
    )
    (tmp_path / "own_world.py").write_text(text, encoding="utf-8")
    words = ("compare", "own_world:mine", "energy", "--policy", "static", "--episodes", "2", "--jobs", "1", "--trust")
    outcome = ptne(*words, "--json", "-", cwd=tmp_path)
    assert {record["track"] for record in json.loads(outcome.stdout)["records"]} == {"mine", "energy"}


def test_a_module_in_the_current_folder_is_found_by_the_installed_command(own_module):
    code = "import sys; sys.argv[0] = 'ptne'; from ptne_env.cli import main; main()"
    arguments = ("render", "energy", "talkative:make", "--trust", "--out", "run.html")
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    outcome = subprocess.run(  # noqa: S603 - our own command line, with -P as console scripts have their path
        [sys.executable, "-P", "-c", code, *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=own_module,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert outcome.returncode == 0, outcome.stderr
    assert "Video written" in outcome.stdout


def test_a_failing_policy_is_named_with_track_step_and_line_and_the_others_go_on(own_module):
    command = ("compare", "energy", "--policy", "static,talkative:broken", "--episodes", "1", "--trust")
    outcome = ptne(*command, cwd=own_module)
    assert outcome.returncode == 1
    place = "talkative:broken on energy"
    assert f"Failed: {place}: it cannot be built: ZeroDivisionError: division by zero (talkative.py," in outcome.stdout
    assert "Traceback" not in outcome.stderr
    records = json.loads((own_module / "results" / "comparison" / "results.json").read_text())["records"]
    assert {record["policy"] for record in records} == {"static"}


def test_a_comparison_of_which_every_policy_fails_says_why(own_module):
    outcome = ptne("compare", "energy", "--policy", "talkative:broken", "--trust", cwd=own_module)
    assert outcome.returncode == 1
    assert "Failed: talkative:broken on energy: it cannot be built: ZeroDivisionError" in outcome.stdout
    page = (own_module / "results" / "comparison" / "report.html").read_text(encoding="utf-8")
    assert "ZeroDivisionError: division by zero" in page
    assert "talkative:broken failed; the tables below name the steps and the errors." in page


@pytest.mark.parametrize("name", ["missing.onnx", "damaged.onnx"])
def test_a_policy_file_that_is_no_policy_is_named(name, tmp_path):
    (tmp_path / "damaged.onnx").write_bytes(b"no policy")
    outcome = ptne("compare", "energy", "--policy", name, cwd=tmp_path)
    assert outcome.returncode == ExitCode.FILE
    assert name in outcome.stderr
    assert "Traceback" not in outcome.stderr


@pytest.mark.parametrize("command", ["check file", "train file.toml --out out"])
def test_a_file_that_is_something_else_is_named(command, tmp_path):
    for name in ("file", "file.toml"):
        (tmp_path / name).write_text("something else", encoding="utf-8")
    outcome = ptne(*command.split(), cwd=tmp_path)
    assert outcome.returncode == ExitCode.FILE
    assert "file" in outcome.stderr
    assert "Traceback" not in outcome.stderr


def test_compare_takes_a_policy_by_module_and_object():
    outcome = ptne("compare", "energy", "--policy", "ptne_env.laws:Grounded", "--episodes", "1", "--json", "-")
    digits = [record["mean"] for record in json.loads(outcome.stdout)["records"] if record["metric"] == "digits"]
    assert digits == pytest.approx([12.0], abs=4e-15)  # as near as a natural logarithm comes


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compare", "energie"), "unknown scenario 'energie'; did you mean 'energy'?"),
        (("compare", "--scenario", "energie"), "unknown scenario 'energie'; did you mean 'energy'?"),
        (("compare", "energy", "static"), "'static' is a policy, no scenario: write --policy static"),
        (("compare", "energy", "ptne-v1/delay"), "of scenarios, or of the tracks of one suite"),
        (("compare", "ptne-v2/drift", "--suite", "ptne-v1"), "of scenarios, or of the tracks of one suite"),
        (("compare", "--policy", "Grounded"), "unknown policy 'Grounded'; did you mean 'grounded'"),
        (("render", "delay", "static", "--out", "x.gif"), "unknown scenario 'delay'; did you mean 'ptne-v1/delay'?"),
        (("compare", "--policy", "statics"), "unknown policy 'statics'"),
        (("compare", "--episodes", "0"), "--episodes"),
        (("render", "energy", "static", "--out", "run.avi"), "a video is written to .gif, .mp4, .html"),
        (("certify", "energie"), "unknown scenario 'energie'"),
        (("certify", "energy", "--kappa", "-1"), "kappa"),
        (("certify", "energy", "--law", "statik"), "unknown law 'statik'; did you mean 'static' or 'Static'?"),
        (("certify", "energy", "--law", "adaptive", "--kappa", "2"), "has no kappa"),
        (("compare", "--suite", "ptne-v0"), "unknown suite 'ptne-v0'; did you mean 'ptne-v1' or 'ptne-v2'?"),
        (
            ("compare", "--suite", "ptne-v1", "--track", "nominl"),
            "unknown track of suite ptne-v1 'nominl'; did you mean 'nominal'?",
        ),
        (("compare", "--suite", "ptne-v1", "--hold-steps", "3"), "leave out --hold-steps"),
        (("compare", "--suite", "ptne-v1", "--policy", "model.zip"), "say --trust"),
        (
            ("compare", "--track", "nominal"),
            "unknown scenario 'nominal'; did you mean 'ptne-v1/nominal'?",
        ),
        (("compare", "--scenario", "robots", "--policy", "ppo-random-energy", "--json", "-"), "fits no track"),
        (("compare", "--jobs", "0"), "0 jobs"),
        (
            ("train", "random-enery", "--out", "out"),
            "unknown configuration 'random-enery'; did you mean 'random-energy'",
        ),
        (("reproduce", "--points", "3"), "No such option"),
        (("list", "everything"), "'everything' is not one of"),
        (("no-such-command",), "No such command"),
    ],
)
def test_wrong_usage_exits_with_2_and_a_message(arguments, message):
    outcome = ptne(*arguments)
    assert outcome.returncode == ExitCode.USAGE
    assert message in outcome.stderr
    assert "Traceback" not in outcome.stderr


@pytest.mark.parametrize(
    "command",
    [
        "compare energy --policy missing.file.onnx",
        "compare energy --policy missing.file.zip --trust",
        "compare energy --policy mine=missing.file.onnx",
        "render energy missing.file.onnx --out out.gif",
        "check missing.file",
        "check missing.file.tar.xz",
        "train missing.file.toml --out out",
        "train ptne-v1/noise --from missing.file.onnx --out out",
    ],
)
def test_a_missing_file_is_called_a_missing_file(command, tmp_path):
    outcome = ptne(*command.split(), cwd=tmp_path)
    assert outcome.returncode == ExitCode.FILE
    assert outcome.stderr.startswith("Error: there is no file 'missing.file")
    assert not any(tmp_path.iterdir())


def test_arguments_and_options_name_the_same_tracks(tmp_path):
    options = ("--policy", "zero-input", "--episodes", "1", "--jobs", "1", "--json", "-")
    results = [
        json.loads(ptne("compare", *words, *options, cwd=tmp_path).stdout)
        for words in (["ptne-v1/delay"], ["--suite", "ptne-v1", "delay"], ["--suite", "ptne-v1", "--track", "delay"])
    ]
    assert [found["episodes"] for found in results] == [{"delay": 1}] * 3
    assert len({found["checksum"] for found in results}) == 1


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ValueError("wrong"), ExitCode.USAGE),
        (DamagedFileError("damaged"), ExitCode.FILE),
        (FileNotFoundError(2, "No such file or directory", "path"), ExitCode.FILE),
        (ImportError("missing"), ExitCode.LIBRARY),
        (ConnectionError("no cluster"), ExitCode.FAILED),
        (ChildProcessError("a worker died"), ExitCode.FAILED),
        (RuntimeError("bug"), ExitCode.FAILED),
    ],
)
def test_every_kind_of_fault_has_an_exit_code(error, code, monkeypatch, capsys):
    def fail(prog_name):
        raise error

    monkeypatch.setenv("PYTHONSAFEPATH", "1")  # main sets it; later tests run without it again
    monkeypatch.setattr(sys.modules[main.__module__], "app", fail)  # ptne_env.cli.app is the Typer object
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
    printed = capsys.readouterr().err
    assert printed.startswith("Error: ")
    assert "Errno" not in printed


def test_the_exit_codes_are_documented():
    usage = (ROOT / "docs" / "usage.md").read_text(encoding="utf-8")
    assert all(f"| {code.value} |" in usage for code in ExitCode)


def test_debug_shows_the_traceback():
    outcome = ptne("--debug", "certify", "energie")
    assert outcome.returncode == 2
    assert "Traceback" in outcome.stderr
    assert "get_scenario" in outcome.stderr
    assert "Error: unknown scenario 'energie'" in outcome.stderr


def test_quiet_writes_files_and_prints_nothing(tmp_path):
    outcome = ptne("--quiet", "certify", "energy", "--json", "out.json", cwd=tmp_path)
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (0, "", "")
    assert json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["scenario"] == "energy"
    assert json.loads(ptne("--quiet", "certify", "energy", "--json", "-").stdout)["scenario"] == "energy"
    assert "unknown scenario" in ptne("--quiet", "certify", "energie").stderr


def test_colours_need_a_terminal_or_force_color_and_no_no_color():
    plain = ptne("certify", "energy", FORCE_COLOR="").stdout
    assert "\x1b" not in plain
    assert "\x1b[32m" in ptne("certify", "energy", FORCE_COLOR="1", TERM="xterm-256color").stdout
    assert "\x1b[32m" not in ptne("certify", "energy", FORCE_COLOR="1", TERM="xterm-256color", NO_COLOR="1").stdout


@pytest.mark.parametrize(
    "command",
    [
        "compare energy --policy zero-input --episodes 1 --out blocked/x",
        "compare energy --policy zero-input --episodes 1 --json blocked/x",
        "compare --suite ptne-v1 --out blocked/x",
        "check blocked --json blocked/x",
        "render energy static --out blocked/x.gif",
        "certify energy --json blocked/x",
        "reproduce --out blocked",
        "train random-energy --out blocked/x",
        "list --json blocked/x",
    ],
)
def test_an_obstacle_to_writing_exits_before_the_work(command, tmp_path):
    (tmp_path / "blocked").write_text("in the way", encoding="utf-8")
    outcome = ptne(*command.split(), cwd=tmp_path)
    assert outcome.returncode == ExitCode.FILE
    assert outcome.stdout == ""
    (line,) = outcome.stderr.strip().splitlines()
    assert line.startswith("Error: ")
    assert (tmp_path / "blocked").read_text(encoding="utf-8") == "in the way"
    assert [path.name for path in tmp_path.iterdir()] == ["blocked"]


@pytest.mark.parametrize("scenario", ["energy-switching", "ptne-v1/switching-physical"])
def test_certify_knows_graphs_on_which_no_gain_is_enough(scenario):
    outcome = ptne("certify", scenario)
    assert outcome.returncode == 0, outcome.stderr
    assert "2.00 against ∞: fails" in " ".join(outcome.stdout.split())


def test_certify_prints_the_numbers_of_the_paper_and_json():
    outcome = ptne("certify", "energy")
    assert outcome.returncode == 0
    for text in ("ι = 2.6", "2.00 against 4.21", "0.280", "without bound"):
        assert text in outcome.stdout
    data = json.loads(ptne("certify", "energy", "--json", "-").stdout)
    assert data["rate"] == pytest.approx(0.280, abs=5e-4)


def test_certify_takes_a_law_by_name_or_class():
    assert "kappa=4.0" in ptne("certify", "energy", "--law", "Grounded", "--kappa", "4").stdout
    assert "Note: CentralisedOracle is an oracle" in ptne("certify", "energy", "--law", "oracle").stdout


@pytest.fixture(scope="module")
def suite_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    arguments = ("--policy", "grounded,ppo-random-energy", "--episodes", "6", "--jobs", "1", "--out", "out")
    tracks = ("--track", "nominal", "--track", "large-20", "--details")
    outcome = ptne("compare", "--suite", "ptne-v1", *tracks, *arguments, cwd=folder)
    assert outcome.returncode == 0, outcome.stderr
    return folder, outcome.stdout


def test_a_suite_prints_a_table_per_track_and_an_overall_one(suite_run):
    folder, printed = suite_run
    for text in (
        "out/report.html",
        "nominal: 6 episodes, ranked by digits",
        "large-20: 6 episodes, ranked by digits",
        "entries that play every track",
        "specialists, on the tracks that they play",
    ):
        assert text in printed
    for text in (
        "oracle *",
        "n/a",
        "the policy was made for another layout",
        "n/a and failed count as zero input",
        "out/results.json",
    ):
        assert text in printed
    data = json.loads((folder / "out" / "results.json").read_text(encoding="utf-8"))
    overall = {row["policy"] for row in data["leaderboard"]["overall"]}
    assert overall == {"grounded", "ppo-random-energy", "zero-input", "static", "oracle"}


def test_the_exit_code_of_check_is_0_when_results_reproduce(suite_run):
    folder, _ = suite_run
    outcome = ptne("check", "out", "--sample", "2", cwd=folder)
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.count("reproduces") == 3  # two that were drawn, and the n/a job, which always runs again
    assert "every number follows from the stored jobs" in outcome.stdout
    forge(folder / "out")
    outcome = ptne("check", "out/results.json", "--sample", "99", cwd=folder)
    assert outcome.returncode == 1
    assert "differs" in outcome.stdout
    outcome = ptne("check", "out", "--sample", "99", "--json", "-", cwd=folder)
    assert outcome.returncode == 1
    found = json.loads(outcome.stdout)
    assert [job["passes"] for job in found["jobs"]].count(False) == 1
    assert found["differences"]


def test_a_check_of_an_archive_says_which_policy_files_are_missing(tmp_path):
    from ptne_env.evaluation.archive import pack

    from ptne_env.bench import run_suite
    from ptne_env.learn import shipped_path
    from ptne_env.shared.files import write_atomically

    (tmp_path / "seed-0").mkdir()
    file = shutil.copy(shipped_path("ppo-random-energy"), tmp_path / "seed-0" / "policy.onnx")
    policies = ["grounded", f"mine={tmp_path}/seed-*/policy.onnx"]
    results = run_suite("ptne-v1", policies, tracks=["nominal"], episodes=2, folder=tmp_path / "out")
    write_atomically(tmp_path / "out" / "results.json", results.to_json())
    pack(results, tmp_path / "out", tmp_path / "raw.tar.xz")
    Path(file).unlink()
    outcome = ptne("check", "raw.tar.xz", "--sample", "1", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert "every number follows from the stored jobs" in outcome.stdout
    assert outcome.stdout.count("reproduces") == 1
    outcome = ptne("check", "out", "--sample", "1", "--json", "found.json", cwd=tmp_path)
    assert outcome.returncode == ExitCode.FILE
    assert "every number follows from the stored jobs" in outcome.stdout
    assert "not repeated" in outcome.stdout
    assert outcome.stdout.count("reproduces") == 1
    (missing,) = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["missing"]
    assert f"{file} is not here (expected SHA-256 " in missing


def forge(folder):
    """Improve a published job, with its checksum."""
    from ptne_env.evaluation.provenance import content_hash

    jobs = {path: json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / "jobs").iterdir())}
    path, data = next((path, data) for path, data in jobs.items() if data["samples"])  # a policy that fits has some
    next(iter(data["samples"].values()))[0] += 1
    data["checksum"] = content_hash({key: value for key, value in data.items() if key != "checksum"})
    path.write_text(json.dumps(data), encoding="utf-8")


def test_list_shows_the_tracks_of_suites():
    printed = ptne("list").stdout
    for text in ("Suite ptne-v1", "mixed-team", "Suite ptne-v2"):
        assert text in printed


ESCAPES = "\x1b[31mred\x1b]0;title\x9b2J"
SPELLED_OUT = r"\x1b[31mred\x1b]0;title\x9b2J"


def test_escape_sequences_of_names_and_errors_are_spelled_out(tmp_path):
    (tmp_path / "broken.py").write_text(f"def policy(layout):\n    raise RuntimeError({ESCAPES!r})\n", encoding="utf-8")
    (tmp_path / f"{ESCAPES}.onnx").write_bytes(b"not a network")
    for policy in (f"{ESCAPES}.onnx", "static,broken:policy"):
        done = ptne("--debug", "compare", "--trust", "--policy", policy, "--episodes", "1", "--no-report", cwd=tmp_path)
        assert done.returncode
        printed = done.stdout + done.stderr
        assert not [char for char in printed if not (char.isprintable() or char in "\n\xa0")]
        assert "[31mred" in printed


@pytest.mark.parametrize("show", [console.say, lambda text: console.console().print(text, markup=False)])
def test_escape_sequences_in_printed_texts_are_spelled_out(show, capsys):
    show(f"before {ESCAPES}\nafter é")
    assert capsys.readouterr().out == f"before {SPELLED_OUT}\nafter é\n"
