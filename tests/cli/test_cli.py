"""The command line: what it prints and writes, its errors and exit codes, and that interrupted work goes on."""

import csv
import html
import io
import json
import os
import pty
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from extras import need_jax, need_matplotlib, need_sb3

from ptne_env import record
from ptne_env.cli.app import ExitCode, main
from ptne_env.learn import shipped_path
from ptne_env.shared.files import DamagedFileError

ROOT = Path(__file__).parents[2]
COMMANDS = ("compare", "render", "certify", "train", "list")
# After Ctrl-C joblib's tracker sometimes finds a semaphore gone already.
PTNE = (sys.executable, "-W", "error", "-W", "ignore:resource_tracker:UserWarning", "-m", "ptne_env.cli")


def ptne(*arguments, cwd=None, **environment):
    """A command in a process of its own, as a person runs it."""
    return subprocess.run(  # noqa: S603 - our own command line
        [*PTNE, *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=cwd,
        check=False,
        timeout=300,
        env={**os.environ, **environment},
    )


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """``run("certify energy")`` runs a command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONSAFEPATH", "1")  # main sets it; later tests run without it again
    monkeypatch.setattr(sys, "path", list(sys.path))

    def command(words):
        monkeypatch.setattr(sys, "argv", ["ptne", *shlex.split(words)])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return SimpleNamespace(code=ended.value.code or 0, out=printed.out, err=printed.err)

    return command


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command, run):
    outcome = run(f"{command} --help")
    assert outcome.code == 0
    assert "Usage" in outcome.out


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        ("list policies", rb"\\u03ba"),
        ("certify energy", rb"\\u03bb"),
        ("compare energy --policy static --episodes 2 --out 'out \udcc3\udcbc'", rb"4\.\d\d \\xb1\d"),
        ("compare energie", b""),
    ],
)
@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_characters_that_the_output_cannot_encode_are_spelled_out(words, printed, encoding, run, monkeypatch, tmp_path):
    streams = {name: io.TextIOWrapper(io.BytesIO(), encoding=encoding) for name in ("stdout", "stderr")}
    for name, stream in streams.items():
        monkeypatch.setattr(sys, name, stream)
    assert run(words).code == (0 if printed else 2)
    if encoding == "ascii":
        assert re.search(printed, streams["stdout"].buffer.getvalue())
    if "--out" in words:  # as under LC_ALL=C, where Python has the bytes of a path in another encoding as surrogates
        assert "out ü" in (tmp_path / "out ü" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("compare energie", "unknown scenario 'energie'; did you mean 'energy'?"),
        ("compare energy static", "'static' is a policy, not a scenario: write --policy static"),
        ("compare energy ptne-v1/liar", "of scenarios, or of the tracks of one suite"),
        ("compare ptne-v1/liar --suite ptne-v2", "of scenarios, or of the tracks of one suite"),
        ("compare nominal", "unknown scenario 'nominal'; did you mean 'ptne-v1/nominal'?"),
        ("compare energy --policy ,", "--policy names no policy"),
        ("certify energy --law recurrent-random-worlds", "'recurrent-random-worlds' is no law"),
        ("compare --policy Grounded", "unknown policy 'Grounded'; did you mean 'grounded'"),
        ("compare energy --policy static(kappa=-3)", "static(kappa=-3): it cannot be built: ValueError: kappa must be"),
        ("compare --episodes 0", "--episodes"),
        ("certify energy --law ppo", "'ppo' is no law, but a learned policy"),
        ("render energy ppo --out x.npz", "ppo cannot act on energy: it has one file per track"),
        ("compare --jobs 0", "0 jobs"),
        ("compare --suite ptne-v0", "unknown suite 'ptne-v0'; did you mean 'ptne-v1'?"),
        ("compare --suite ptne-v1 nominl", "did you mean 'nominal'?"),
        ("render liar static --out x.html", "unknown scenario 'liar'; did you mean 'ptne-v1/liar'?"),
        ("render energy static --out run.avi", "a file that ends in .html, .npz,"),
        ("certify energie", "unknown scenario 'energie'"),
        ("certify energy --law statik", "unknown policy 'statik'; did you mean 'static'"),
        ("certify --points 3", "No such option"),
        ("certify energy --set dedline=2", "unknown scenario field 'dedline'; did you mean 'deadline'?"),
        ("certify energy --set deadline", "--set takes FIELD=VALUE"),
        ("certify energy --set game=os:getcwd", "'os:getcwd' would run code from outside the library"),
        ("compare ptne-v1/liar --set deadline=2", "--set changes scenarios"),
        ("list everything", "'everything' is not one of"),
        ("train energy --algorithm ipo", "unknown algorithm 'ipo'; did you mean 'ippo'"),
        ("train nope", "unknown scenario 'nope'"),
        ("train energy --set step=3", "unknown setting 'step'; did you mean 'steps'"),
        ("train energy --algorithm through-world --set steps=3", "unknown setting 'steps'"),
        ("train energy --set algorithm=ippo-rnn", "unknown setting 'algorithm'"),
        ("train energy --set scenario=robots", "unknown setting 'scenario'"),
        ("train energy --set seed=3", "unknown setting 'seed'"),
        ("train energy --set learning_rate=fast", "learning_rate must be"),
        ("train energy --set batch=0", "batch must be a whole number of at least 1, got 0"),
        ("no-such-command", "No such command"),
    ],
)
def test_wrong_usage_exits_with_2_and_a_message(words, message, run, tmp_path):
    outcome = run(words)
    assert outcome.code == ExitCode.ERROR
    assert message in outcome.err
    assert "Traceback" not in outcome.err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        "compare energy --policy missing.file.npz",
        "compare energy --policy missing.file.zip --trust",
        "compare energy --policy mine=missing.file.npz",
        "render energy missing.file.npz --out out.html",
    ],
)
def test_a_missing_file_is_called_a_missing_file(words, run, tmp_path):
    outcome = run(words)
    assert outcome.code == ExitCode.FILE
    assert re.search(r"^Error: .*'missing\.file", outcome.err)
    assert not any(tmp_path.iterdir())


def test_a_file_that_is_something_else_is_named(run, tmp_path):
    (tmp_path / "no.npz").write_text("something else", encoding="utf-8")
    outcome = run("compare energy --policy no.npz")
    assert outcome.code == ExitCode.FILE
    assert "no.npz" in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize(
    "words",
    [
        "compare energy --policy zero-input --episodes 1 --out blocked/x",
        "compare energy --policy zero-input --episodes 1 --json blocked/x",
        "render energy static --out blocked/x.html",
        "certify energy --json blocked/x",
        "train random-energy --out blocked/x",
        "list --json blocked/x",
    ],
)
def test_an_obstacle_to_writing_exits_before_the_work(words, run, tmp_path):
    if words.startswith("train"):
        need_jax()
    (tmp_path / "blocked").write_text("in the way", encoding="utf-8")
    outcome = run(words)
    assert (outcome.code, outcome.out) == (ExitCode.FILE, "")
    assert outcome.err.startswith("Error: ")
    assert (tmp_path / "blocked").read_text(encoding="utf-8") == "in the way"
    assert [path.name for path in tmp_path.iterdir()] == ["blocked"]


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ValueError("wrong"), ExitCode.ERROR),
        (DamagedFileError("damaged"), ExitCode.FILE),
        (FileNotFoundError(2, "No such file or directory", "path"), ExitCode.FILE),
        (ImportError("missing"), ExitCode.LIBRARY),
        (ConnectionError("no cluster"), ExitCode.FAILED),
        (ChildProcessError("a worker died"), ExitCode.FAILED),
        (RuntimeError("bug"), ExitCode.ERROR),
    ],
)
def test_every_kind_of_fault_has_an_exit_code(error, code, run, monkeypatch):
    def fail(prog_name):
        raise error

    monkeypatch.setattr(sys.modules[main.__module__], "app", fail)
    outcome = run("list")
    assert outcome.code == code
    assert outcome.err.startswith("Error: ")
    assert "Errno" not in outcome.err


def test_the_exit_codes_are_documented():
    usage = (ROOT / "docs" / "usage.md").read_text(encoding="utf-8")
    assert all(f"| {code.value} |" in usage for code in ExitCode)


def test_debug_shows_the_traceback(run):
    outcome = run("--debug certify energie")
    assert outcome.code == ExitCode.ERROR
    assert "Traceback" in outcome.err
    assert "Error: unknown scenario 'energie'" in outcome.err


def test_quiet_writes_files_and_prints_nothing_but_errors(run, tmp_path):
    outcome = run("--quiet certify energy --json out.json")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    assert json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["scenario"] == "energy"
    assert "unknown scenario" in run("--quiet certify energie").err


# --- compare --------------------------------------------------------------------------------------------------------

COMPARISON = "compare energy-switching random-energy --policy grounded,static --episodes 3 --jobs 1"


def test_compare_prints_one_screen_and_writes_results_and_a_page(run, tmp_path):
    outcome = run(f"{COMPARISON} --json there/again.json")
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    assert len(lines) < 25
    assert lines[0].startswith("Digits at the deadline ± half of the 95 % interval, 3 episodes")
    assert "grounded comes closest to the Nash equilibrium" in outcome.out
    assert lines[-1] == "Report written to results/comparison/report.html: open it in a browser"
    folder = tmp_path / "results" / "comparison"
    assert {path.name for path in folder.iterdir()} == {"results.json", "results.csv", "report.html", "jobs"}
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    rows = list(csv.DictReader((folder / "results.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) >= len(data["records"])
    assert (tmp_path / "there" / "again.json").read_bytes() == (folder / "results.json").read_bytes()


def test_the_command_on_the_page_repeats_the_results_from_the_stored_jobs(run, tmp_path):
    folder = tmp_path / "results" / "comparison"
    assert run(f"{COMPARISON} --seed 4").code == 0
    first = (folder / "results.json").read_bytes()
    page = (folder / "report.html").read_text(encoding="utf-8")
    command = html.unescape(re.search(r"<dt>command</dt>\s*<dd>(.*?)</dd>", page)[1])
    written = {path: path.stat().st_mtime_ns for path in (folder / "jobs").iterdir()}
    assert run(command.removeprefix("ptne ")).out.startswith("The results will replace earlier ones in results/")
    assert (folder / "results.json").read_bytes() == first
    assert {path: path.stat().st_mtime_ns for path in (folder / "jobs").iterdir()} == written


def test_details_print_the_tables_of_all_metrics(run):
    outcome = run(f"{COMPARISON} --details --no-report --out out")
    assert "energy-switching: how close" in outcome.out
    assert "random-energy: at what cost" in outcome.out


def test_details_hide_no_policy_in_a_narrow_terminal(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    words = "compare energy --policy static,grounded,zero-input,random --episodes 2 --jobs 1 --no-report"
    assert "or --details, also shows" in run(words).out
    whole = run(f"{words} --details").out
    assert "--details" not in whole
    assert len(re.findall("zero-input", whole[whole.index("Digits at the deadline") :])) == 1


def test_tracks_are_named_with_their_suite_or_after_it(run, tmp_path):
    words = "--policy zero-input --episodes 1 --jobs 1 --no-report"
    assert run(f"compare ptne-v1/liar {words} --out one").code == 0
    assert run(f"compare --suite ptne-v1 liar {words} --out two").code == 0
    found = [json.loads((tmp_path / name / "results.json").read_text(encoding="utf-8")) for name in ("one", "two")]
    assert found[0]["checksum"] == found[1]["checksum"]
    assert list(found[0]["episodes"]) == ["liar"]


TALKATIVE = """
from ptne_env import get_scenario, laws

mine = get_scenario("energy", name="mine", steps=120)

def make(layout):
    print("making a policy")
    return laws.ZeroInput(layout)

make.interface = laws.ZeroInput.interface

def broken(layout):
    return 1 / 0
"""


@pytest.fixture
def own_module(tmp_path):
    """A folder with a module whose policy prints, and one that fails."""
    (tmp_path / "talkative.py").write_text(TALKATIVE, encoding="utf-8")
    yield tmp_path
    sys.modules.pop("talkative", None)


def test_scenarios_and_policies_of_an_own_module_are_found_in_the_current_folder(own_module):
    words = "compare talkative:mine energy --policy talkative:make --episodes 2 --jobs 2 --trust --json -"
    outcome = ptne(*words.split(), cwd=own_module)
    assert {record["track"] for record in json.loads(outcome.stdout)["records"]} == {"mine", "energy"}


def test_a_failing_policy_is_named_with_its_error_and_the_others_go_on(own_module, run):
    outcome = run("compare energy --policy static,talkative:broken --episodes 1 --jobs 1 --trust")
    assert outcome.code == ExitCode.FAILED
    assert re.search("failed: talkative:broken on energy: .*ZeroDivisionError", " ".join(outcome.out.split()))
    assert "Traceback" not in outcome.err
    folder = own_module / "results" / "comparison"
    records = json.loads((folder / "results.json").read_text(encoding="utf-8"))["records"]
    assert {record["policy"] for record in records} == {"static"}
    assert "ZeroDivisionError" in (folder / "report.html").read_text(encoding="utf-8")


def test_a_policy_that_cannot_play_a_track_is_in_the_answer_with_its_reason(tmp_path, run):
    (tmp_path / "mine.npz").write_bytes(shipped_path("ppo-nominal").read_bytes())
    outcome = run("compare --suite ptne-v1 nominal uneven-box --policy mine.npz,static --episodes 2 --jobs 1")
    assert outcome.code == 0
    words = " ".join(outcome.out.split())
    assert "mine has no result on uneven-box, for the reason below the table." in words
    assert "n/a: mine on uneven-box: the policy was made for another layout; " in words
    assert re.search(r"uneven-box\s+\S+ ±\S+\s.*\s+n/a\s", outcome.out)


@pytest.mark.parametrize(
    "words", ["compare energy --policy talkative:make --episodes 1 --jobs 1 --trust", "certify energy"]
)
def test_json_on_stdout_is_json_alone_when_other_code_prints(words, own_module):
    outcome = ptne(*words.split(), "--json", "-", cwd=own_module)
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)
    assert {path.name for path in own_module.iterdir()} <= {"talkative.py", "__pycache__"}


# --- other commands -------------------------------------------------------------------------------------------------


def test_list_names_everything_and_writes_json(run, tmp_path):
    outcome = run("list --json listed.json")
    for name in ("energy-switching-transformed", "corollary-one", "oracle", "input_energy", "ptne-v1/long-way"):
        assert re.search(rf"^{name} ", outcome.out, re.MULTILINE)
    assert len(outcome.out.splitlines()) < 150
    listed = json.loads((tmp_path / "listed.json").read_text(encoding="utf-8"))
    assert set(listed) == {"scenarios", "policies", "metrics", "suites"}
    sentences = [entry["description"] for entries in listed.values() for entry in entries.values()]
    assert all(sentences)
    assert "corollary-one" not in run("list scenarios").out


def test_certify_prints_the_numbers_of_the_paper_and_json(run, tmp_path):
    printed = " ".join(run("certify energy --json found.json").out.split())
    for text in ("2.10: ε", "2.00 against 4.21: fails (sufficient, not necessary)", "0.280"):
        assert text in printed
    data = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert data["rate"] == pytest.approx(0.280, abs=5e-4)
    assert "grounded(kappa=4)" in run("certify energy --policy grounded(kappa=4)").out
    assert "energy gain=2 start=paper: static" in run("certify energy --set gain=2 --set start=paper").out


def test_render_writes_the_player_of_an_episode(run, tmp_path):
    assert "Episode written to videos/run.html" in run("render energy static --out videos/run.html").out
    text = (tmp_path / "videos" / "run.html").read_text(encoding="utf-8")
    assert "energy: static" in text
    assert "<dd>ptne render energy static --out videos/run.html</dd>" in text
    assert "<dt>seed</dt>" in text
    assert re.findall(r'<script type="text/plain" id="(.*?)"', text) == ["scene-0-data"]
    assert len(text) < 1e5


def test_render_writes_the_trajectories_of_record(run, tmp_path):
    run("render energy static --out run.npz --seed 3")
    expected = record("static", "energy", seed=3).estimates
    np.testing.assert_array_equal(np.load(tmp_path / "run.npz")["estimates"], expected)


# --- terminals ------------------------------------------------------------------------------------------------------


def in_terminal(arguments, cwd, *, until=None, **environment):
    """Run a command in a terminal of 80 columns, interrupt it once ``until`` is printed; exit code and output."""
    ours, theirs = pty.openpty()
    # Tests that run in the background ignore interruptions, and so would their subprocesses.
    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(  # noqa: S603 - our own command line
        [*PTNE, *arguments],
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


def is_alive(group):
    """Whether a process of this group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_interrupted_work_showed_the_time_left_and_leaves_complete_files(tmp_path):
    words = "compare ptne-v1/liar ptne-v1/rounding --policy adaptive,grounded --jobs 2 --out out"
    code, printed = in_terminal(words.split(), tmp_path, until=r"\d%.*\d:\d\d:\d\d")
    assert code == ExitCode.INTERRUPTED, printed
    assert "Interrupted" in printed
    assert "Traceback" not in printed, printed
    for path in tmp_path.rglob("*"):
        assert not path.name.startswith(".")
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))


def test_an_interruption_ends_the_process_at_once():
    """What Python does at the end, it did to XLA while its threads compiled: a segmentation fault in most cases."""
    ends = "import atexit, os; from ptne_env.cli.app import app, main; atexit.register(os.abort)"
    stops = "app.command('stop')(lambda: (_ for _ in ()).throw(KeyboardInterrupt))"
    program = (sys.executable, "-c", f"import sys; sys.argv[1:] = ['stop']; {ends}; {stops}; main()")
    done = subprocess.run(program, capture_output=True, text=True, check=False, timeout=60)  # noqa: S603 - our own
    assert done.returncode == ExitCode.INTERRUPTED
    assert "Interrupted" in done.stderr


def test_a_terminal_gets_colours_and_none_with_no_color(run, monkeypatch, tmp_path):
    assert "\x1b[32mholds" in in_terminal(["certify", "energy"], tmp_path)[1]
    assert "\x1b" not in in_terminal(["certify", "energy"], tmp_path, NO_COLOR="1")[1]
    monkeypatch.setenv("COLUMNS", "80")
    piped = run("certify energy").out
    assert "\x1b" not in piped
    assert max(map(len, piped.splitlines())) <= 80


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["ptne", ""], set(COMMANDS)),
        (["ptne", "compare", "--policy", "static,gr"], {"static,grounded"}),
        (["ptne", "compare", "ptne-v1/sw"], {"ptne-v1/switching-physical", "ptne-v1/switching-transformed"}),
        (["ptne", "train", "random-e"], {"random-energy"}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_the_shell_completes_names(run, monkeypatch, words, expected):
    monkeypatch.setenv("_PTNE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", " ".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    outcome = run("")
    assert outcome.err == ""
    found = set(outcome.out.split())
    assert expected <= found
    assert all(name.startswith(words[-1]) for name in found)


ESCAPES = "\x1b[31mred\x1b]0;title\x9b2J"


def test_escape_sequences_of_names_and_errors_are_spelled_out(run, tmp_path):
    (tmp_path / "broken.py").write_text(f"def policy(layout):\n    raise RuntimeError({ESCAPES!r})\n", encoding="utf-8")
    (tmp_path / f"{ESCAPES}.npz").write_bytes(b"not a network")
    for policy in (shlex.quote(f"{ESCAPES}.npz"), "static,broken:policy"):
        done = run(f"--debug compare energy --trust --policy {policy} --episodes 1 --jobs 1 --no-report")
        assert done.code
        printed = done.out + done.err
        assert not [char for char in printed if not (char.isprintable() or char in "\n\xa0")]
        assert "[31mred" in printed


@pytest.mark.parametrize(
    ("algorithm", "module", "told"),
    [
        ("ippo", "jax_ppo", ""),
        ("sb3-ppo", "sb3", "1000 agent-steps"),
        ("sb3-sac", "sb3", "1000 agent-steps"),
        ("through-world", "through_world", "1000 updates"),
    ],
)
def test_a_resumed_run_that_nobody_can_repeat_is_named(run, monkeypatch, algorithm, module, told):
    need_jax()
    need_sb3()
    need_matplotlib()
    from ptne_env.training.configuration import RunSummary
    from ptne_env.training.curve import write_learning_curve

    def train(configuration, out, progress):
        write_learning_curve(out, [1000, 5000], [[1.0], [1.0]])
        return RunSummary(5000, 1000, 1.0, 1.0)

    monkeypatch.setattr(f"ptne_env.training.{module}.train", train)
    printed = run(f"train energy --algorithm {algorithm}").out
    assert "1.00 digits on " in printed
    assert ("The run was resumed at" in printed) == bool(told)
    assert told in printed


def test_an_algorithm_has_settings_of_its_own_which_may_be_changed(run, monkeypatch):
    need_sb3()
    need_matplotlib()
    from ptne_env.training import TRAINERS, sb3

    seen = []

    def train(configuration, out, progress):
        seen.append(vars(configuration))
        raise ValueError("it has seen enough")

    monkeypatch.setattr(sb3, "train", train)
    for words in ("", " --steps 10 --set epochs=3"):
        assert "it has seen enough" in run(f"train energy --algorithm sb3-sac{words}").err
    first, second = seen
    assert first.items() >= TRAINERS["sb3-sac"].defaults.items()
    assert second == first | {"steps": 10, "epochs": 3}


def test_seeds_of_another_run_in_the_same_folder_are_refused(run, tmp_path):
    """Otherwise the pattern of the printed command would compare both runs as seeds of one policy."""
    need_jax()
    from ptne_env.training.configuration import Configuration, write_record

    write_record(tmp_path / "seed-7" / "configuration.json", Configuration("energy", hidden=(8,), seed=7))
    printed = run(f"train energy --seeds 1 --out {tmp_path}").err
    assert f"{tmp_path}/seed-7 holds another run: hidden is [8] there and [64, 64] here" in printed


def test_a_training_says_whether_its_last_fifth_still_gained(run, monkeypatch):
    need_jax()
    need_matplotlib()
    from ptne_env.training import jax_ppo
    from ptne_env.training.configuration import RunSummary
    from ptne_env.training.curve import write_learning_curve

    def train(configuration, out, progress):
        digits = [[1.0], [1.5], [2.0], [2.0], [2.0 + (0.0, 0.1, -0.5)[configuration.seed]]]
        write_learning_curve(out, 1000 * np.arange(1, 6), digits)
        return RunSummary(5000, 0, 1.0, digits[-1][0])

    monkeypatch.setattr(jax_ppo, "train", train)
    printed = run("train energy --seeds 3").out
    assert "2.00 digits on 200 validation episodes, after 1 s; policy.npz written to trained/seed-0" in printed
    assert "The last fifth of the training gained 0.00 digits\n" in printed
    assert "The last fifth of the training gained 0.10 digits: more --steps gain more\n" in printed
    assert "The last fifth of the training lost 0.50 digits: try another --seed or a smaller learning_rate\n" in printed
    assert "ptne compare energy --policy 'static,trained=trained/seed-*/policy.npz'" in printed
