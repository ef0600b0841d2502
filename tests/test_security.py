"""The promises of SECURITY.md about code of strangers, and the effects that it warns of."""

import base64
import json
import re
import shlex
import sys
import zipfile
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from extras import need_jax, need_sb3
from processes import run_python
from small_suite import write_results
from typer.testing import CliRunner

from ptne_env import Scenario, get_scenario
from ptne_env.cli import app, options
from ptne_env.evaluation import Track, get_policy_spec
from ptne_env.evaluation.results import read_results
from ptne_env.shared.parts import foreign_targets
from ptne_env.suites import Suite, run_suite
from ptne_env.world.world import World

TEXT = (Path(__file__).parents[1] / "SECURITY.md").read_text(encoding="utf-8")
SMALL = Suite("small", (Track("ring", get_scenario("energy", steps=60, deadline=0.1), "The base."),), episodes=1)
CALLED = []


def mark(**arguments):
    """A function that a stranger's file might call."""
    CALLED.append(arguments)
    return arguments


@pytest.fixture(autouse=True)
def nothing_called():
    CALLED.clear()


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """A folder with files of a stranger as the current folder; their code makes the folder ``ran`` in it."""
    ran = str(tmp_path / "ran")
    (tmp_path / "evil.py").write_text(f"import os\n\nos.mkdir({ran!r})\n", encoding="utf-8")
    serialised = base64.b64encode(f"cos\nmkdir\n(V{ran}\ntR.".encode()).decode()  # a pickle that calls os.mkdir
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {":type:": "type", ":serialized:": serialised}}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])  # commands add the current folder
    yield tmp_path
    sys.modules.pop("evil", None)


def ran(words):
    """Whether code of the stranger ran in a command, and the error of the command."""
    error = CliRunner().invoke(app, shlex.split(words)).exception
    return Path("ran").exists(), error


COMMANDS = {
    "policy": "compare energy --policy static,evil:make",
    "archive": "compare energy --policy evil.zip",
    "pattern": "compare energy --policy mine=ev*.zip",
    "suite": "compare --suite evil:suite",
    "scenario": "compare evil:scenario --policy static",
    "law": "certify energy --law evil:Law",
    "scenario of certify": "certify evil:suite/track",
    "scenario of render": "render evil:suite/track static --out run.html",
    "policy of render": "render energy evil:make --out run.html",
    "archive of render": "render energy evil.zip --out run.html",
    "training": "train evil:suite/track --out out",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_ask_before_they_run_code_from_outside_the_library(command, evil):
    if command == "training":
        need_jax()
    if command in ("archive", "pattern", "archive of render"):
        need_sb3()
    happened, error = ran(COMMANDS[command])
    assert not happened
    assert re.search(
        r"'(ev\*\.zip|evil\.zip|evil:\w+)' would run code from outside the library: say --trust", str(error)
    )
    happened, _ = ran(f"{COMMANDS[command]} --trust")
    assert happened


@pytest.mark.parametrize("answer", [True, False])
def test_a_terminal_is_asked_before_code_runs(answer, monkeypatch):
    asked = []

    def confirm(text, *, abort, err):
        asked.append(text)
        if abort and not answer:
            raise typer.Abort

    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(typer, "confirm", confirm)
    assert options.require_trust([], trust=False) is False
    assert options.require_trust(["evil:make"], trust=True) is True
    assert asked == []
    with nullcontext() if answer else pytest.raises(typer.Abort):
        assert options.require_trust(["evil:make", "\x1b[2Kfine.zip"], trust=False) is True
    assert asked == [r"'evil:make', '\x1b[2Kfine.zip' will run code from outside the library. Do you trust it?"]


def test_modules_of_the_current_folder_are_found_after_trust_alone(evil):
    program = (
        "import os, sys\n"
        "from ptne_env.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    print(os.getcwd() in sys.path)\n"
    )
    printed = [
        run_python("-P", "-c", program, "-q", *command, folder=evil).stdout.strip()
        for command in (["certify", "energy"], ["certify", "energy", "--law", "evil:Law", "--trust"])
    ]
    assert printed == ["False", "True"]


def test_no_process_of_a_command_imports_modules_of_the_current_folder(tmp_path):
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    here.mkdir()
    elsewhere.mkdir()
    (elsewhere / "trusted.py").write_text("from ptne_env.laws import Grounded\n", encoding="utf-8")
    for name in ("joblib", "multiprocessing", "numpy", "ptne_env"):
        text = f"import os\n\nos.mkdir({str(tmp_path / name)!r})\n"
        (here / f"{name}.py").write_text(text, encoding="utf-8")
    command = "compare energy --episodes 1 --no-report --jobs 2 --policy static,trusted:Grounded --trust"
    program = "import sys; del sys.path[0]; from ptne_env.cli import main; main()"
    run_python("-c", program, "-q", *command.split(), folder=here, modules=[elsewhere])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "here"]


CALL = {"target": "test_security:mark", "arguments": {"word": "called"}}


@pytest.fixture(scope="module")
def data():
    return run_suite(SMALL, ["grounded"]).to_dict()


@pytest.fixture
def results(data, tmp_path):
    """Writes the results of a run with a change, and with a checksum that fits, which needs no secret."""

    return partial(write_results, tmp_path, data)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data["policies"][0]["training_seeds"].__setitem__(0, CALL),
        lambda data: data["policies"][0]["training_seeds"][0]["arguments"].update(kappa=[1.0, [CALL]]),
        lambda data: data["tracks"][0]["scenario"].update(game=CALL),
        lambda data: data["tracks"][0]["scenario"]["topology"]["arguments"].update(graph=CALL),
        lambda data: data["tracks"][0].update(teammates={"policy": CALL, "players": [0]}),
    ],
)
def test_reading_results_runs_nothing_that_they_name_without_trust(change, results):
    with pytest.raises(ValueError, match="names code from outside the library, which needs trust=True: test_security:"):
        read_results(results(change))
    assert CALLED == []


def test_an_archive_in_results_is_foreign_and_results_of_the_library_need_no_trust(results):
    archive = {"target": "ptne_env.learn.sb3_archive:load_archive", "arguments": {"path": "model.zip"}}
    folder = results(lambda data: data["policies"][0]["training_seeds"].__setitem__(0, archive))
    with pytest.raises(ValueError, match=archive["target"]):
        read_results(folder)
    assert "grounded" in read_results(results()).policies


def test_a_world_calls_the_addresses_of_its_scenario_with_their_arguments():
    data = get_scenario("energy").to_dict()
    data["game"] = CALL
    scenario = Scenario.from_dict(data)
    assert not CALLED
    assert foreign_targets(scenario.game) == ["test_security:mark"]
    with pytest.raises(ValueError, match="built a dict where a Game or GameFamily is needed"):
        World(scenario)
    assert CALLED == [{"word": "called"}]


def test_an_archive_is_not_opened_unless_it_is_trusted(evil):
    for policy in ("evil.zip", "mine=ev*.zip"):
        with pytest.raises(ValueError, match="executes code that is stored in it"):
            get_policy_spec(policy)
    assert not (evil / "ran").exists()


def test_every_promise_names_tests_that_exist():
    rows = [line for line in TEXT.splitlines() if line.startswith("| ")][2:]
    assert len(rows) >= 6
    source = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.rglob("test_*.py"))
    for row in rows:
        names = re.findall(r"`(test_\w+)`", row)
        assert names
        assert [name for name in names if f"def {name}(" not in source] == []
