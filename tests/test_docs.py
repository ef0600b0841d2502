"""The documents agree with the code: programs run, links lead to files, commands and names exist."""

import dataclasses
import importlib
import importlib.util
import itertools
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from extras import need_jax
from processes import run_python

import ptne_env
from ptne_env.cli import app
from ptne_env.evaluation.trajectories import ARRAYS
from ptne_env.shared.parts import FactorySpec
from ptne_env.suites import get_suite
from ptne_env.world.catalogue import CATALOGUE
from ptne_env.world.rewards import TERMS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "ptne_env"
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES = [*DOCUMENTS, *sorted(ROOT.glob("[!R]*.md")), *sorted(ROOT.glob("[be]*/*.md"))]
JAX = ROOT / "docs" / "jax.md"
PARTS = ROOT / "docs" / "adding-parts.md"
DATA = ROOT / "docs" / "data.md"
ECOSYSTEM = ROOT / "docs" / "ecosystem.md"
REQUIREMENTS = ROOT / "examples" / "ecosystem" / "requirements"
ARCHITECTURE = ROOT / "docs" / "architecture.md"
ENVIRONMENT = ROOT / "docs" / "environment.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def by_path(document):
    return document.relative_to(ROOT).as_posix()


def blocks(document, language):
    return [body for kind, body in BLOCK.findall(document.read_text("utf-8")) if kind == language]


def prose(document):
    """The text without its code blocks."""
    return BLOCK.sub("", document.read_text("utf-8"))


def table(document, header):
    """The rows of the table whose header starts with ``header``, each a list of cells."""
    lines = iter(prose(document).splitlines())
    for line in lines:
        if line.startswith(f"| {header} |"):
            next(lines)
            rows = itertools.takewhile(lambda row: row.startswith("|"), lines)
            return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    raise AssertionError(f"{document.name} has no table that starts with {header!r}")


PROGRAMS = [
    pytest.param(code, id=f"{document.stem}-{index}")
    for document in DOCUMENTS
    for index, code in enumerate(blocks(document, "python"))
    if document not in (PARTS, JAX, DATA)
]


@pytest.mark.parametrize("code", PROGRAMS)
def test_code_runs_as_printed_without_a_warning(code, tmp_path, monkeypatch):
    if "stable_baselines3" in code:
        pytest.importorskip("stable_baselines3", reason="needs the extra 'sb3'")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "document", "exec"), {"__name__": "__main__"})  # noqa: S102 - our own programs
    assert list(tmp_path.iterdir()) == []


def test_the_code_about_parts_runs_as_one_program(tmp_path):
    """In a process of its own, because it registers a metric."""
    run_python("-W", "error", "-c", "\n".join(blocks(PARTS, "python")), folder=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_training_on_jax_runs_and_its_policy_can_be_compared(tmp_path):
    """In a process of its own, because it changes a setting of JAX."""
    need_jax()
    (code,) = blocks(JAX, "python")
    assert "updates=1500)\n" in code
    run_python("-W", "error", "-c", code.replace("updates=1500)\n", "updates=2)\n"), folder=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_code_about_data_writes_the_files_that_it_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(blocks(DATA, "python"))
    exec(compile(code, "document", "exec"), {"__name__": "__main__"})  # noqa: S102 - our own program
    named = re.findall(r"(?:save|savefig)\(\"([\w.]+)\"\)", code)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(named)
    assert len(named) == 6


def test_the_table_of_arrays_is_complete():
    rows = {name: row[1] for row in table(DATA, "Array") for name in re.findall(r"`(\w+)`", row[0])}
    assert list(rows) == list(ARRAYS)
    run = ptne_env.record("static", "robots", episodes=2)
    sizes = {"F": 401, "B": 2, "L": len(run.links), "2": 2, "N": 5, "n": 10}
    for name, shape in rows.items():
        assert getattr(run, name).shape == tuple(sizes[axis] for axis in re.findall(r"\w+", shape))


def commands(document):
    """The lines of console blocks and the inline code of a document, each split as a shell does."""
    lines = [line for kind in ("console", "sh") for body in blocks(document, kind) for line in body.splitlines()]
    lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose(document))]
    return [words for line in lines if line.isprintable() and (words := _split(line))]


def _split(line):
    try:
        return shlex.split(line, comments=True)
    except ValueError:  # inline code that is no command and has a lone quotation mark
        return []


def parse(arguments):
    """Parse the arguments of ``ptne`` without running the command."""
    group = typer.main.get_command(app)
    group.callback = lambda **_: None
    for command in group.commands.values():
        command.callback = lambda **parameters: parameters
    return group.main(arguments, standalone_mode=False)


@pytest.mark.parametrize("document", PAGES, ids=by_path)
def test_commands_scripts_and_make_targets_exist(document):
    targets = re.findall(r"^([\w-]+)(?: \w+)*:", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    for first, *words in commands(document):
        if first == "ptne" and len(words) > 1:
            parse(words)
        elif first == "make" and words:
            assert words[0] in targets
        elif first in ("python", "python3") and words and words[0] != "-m":
            assert (ROOT / words[0]).is_file() or words[0].endswith("NAME.py"), words
        elif first in ("python", "python3") and len(words) > 1 and words[1] != "venv":
            assert importlib.util.find_spec(words[1]), words


@pytest.mark.parametrize("document", PAGES, ids=by_path)
def test_links_and_named_tests_exist(document):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", prose(document))
    assert [link for link in links if "://" not in link and not (document.parent / link).exists()] == []
    tests = "".join(path.read_text("utf-8") for path in (ROOT / "tests").rglob("*.py"))
    named = re.findall(r"\b(test_\w+)\b(?!\.py)", prose(document))
    assert [name for name in named if not name.endswith("_") and f"def {name}(" not in tests] == []


def exists(file, name):
    """Whether a file of the package or of ``baselines/paper`` exists and, if given, ``name`` is in that module."""
    path = Path("baselines" if file.startswith("paper/") else PACKAGE.name, file)
    if not (ROOT / path).is_file():
        return False
    owner = importlib.import_module(".".join(path.with_suffix("").parts))
    *parents, last = name.split(".") if name else [None]
    for parent in parents:
        owner = getattr(owner, parent, None)
    fields = {field.name for field in dataclasses.fields(owner)} if dataclasses.is_dataclass(owner) else set()
    return last is None or hasattr(owner, last) or last in fields


def test_the_walk_of_a_step_is_the_one_that_the_code_takes():
    """Every stop of the table is called by ``env.step``, after the stop before; the last one is where it returns."""
    env, calls = ptne_env.parallel_env("random-energy", channel=FactorySpec.of("channel:noise", std=0.1)), []
    env.reset(seed=0)

    def record(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(PACKAGE):
            calls.append((path.relative_to(PACKAGE).as_posix(), frame.f_code.co_name))

    actions = {agent: np.zeros(env.action_space(agent).shape, np.float32) for agent in env.agents}
    sys.setprofile(record)
    try:
        env.step(actions)
    finally:
        sys.setprofile(None)
    rows = table(ARCHITECTURE, "Stop")
    cells = [re.findall(r"`(.*?)`", where) for _, where, _ in rows]
    stops = [(file, name) for file, *names in cells for name in names]
    assert len(rows) == 10
    assert stops.pop() == calls[0]
    walk = iter(calls)
    assert [stop for stop in stops if stop not in walk] == []


def test_files_and_objects_of_the_paper_map_exist():
    rows = [line.split("|") for line in prose(ROOT / "docs" / "paper-map.md").splitlines() if line.count("|") == 5]
    named = re.findall(r"`([\w/]+\.py)(?:::([\w.]+))?`", " ".join(row[3] for row in rows))
    assert len(named) > 40
    assert [f"{file}::{name}" for file, name in named if not exists(file, name)] == []
    tests = re.findall(r"`([\w/]+\.py)`", " ".join(row[4] for row in rows))
    assert [file for file in tests if not (ROOT / "tests" / file).is_file()] == []
    items = " ".join(row[1] for row in rows)
    numbers = set()
    for first, last in re.findall(r"\((\d+)[a-c]?\)(?:–\((\d+)[a-c]?\))?", items):
        numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(range(1, 52))  # every equation of the paper


@pytest.mark.parametrize(("kind", "column"), [("scaled", 2), ("physical", 3)])
def test_observation_table_is_the_layout(kind, column):
    expected = {row[0].strip("`"): row[column] for row in table(ENVIRONMENT, "Slice") if row[column] != "–"}
    slices = ptne_env.parallel_env("energy", interface=kind).layout.slices
    assert expected == {name: f"{part.start}:{part.stop}" for name, part in slices.items()}


def test_scenarios_of_the_table_are_in_the_catalogue():
    """A new scenario need not have a row: ``ptne list`` explains all of them."""
    assert {row[0].split("`")[1] for row in table(ENVIRONMENT, "Scenario")} <= set(CATALOGUE)


def test_the_protocol_has_the_numbers_of_episodes_of_tracks():
    said = " ".join((ROOT / "docs/protocol.md").read_text(encoding="utf-8").split())
    own = [f"{track.episodes} of `{track.name}`" for track in get_suite("ptne-v1").tracks if track.episodes]
    assert own
    assert f"{get_suite('ptne-v1').episodes} episodes per track ({', '.join(own)})" in said


def test_the_table_of_frameworks_has_the_versions_that_make_ecosystem_installs():
    rows = [row for row in table(ECOSYSTEM, "Framework") if row[1] != "–"]
    told = {row[2].split("/ecosystem/")[1].split("_")[0]: row[1].split()[-1] for row in rows}
    pins = {path.stem: path.read_text("utf-8").split()[0].split("==")[1] for path in REQUIREMENTS.glob("*.txt")}
    assert told == pins


def test_reward_and_info_tables_are_complete():
    assert table(ENVIRONMENT, "Term") == [[f"`{name}`", term.meaning] for name, term in TERMS.items()]
    rows = {row[0].strip("`"): row[1] for row in table(ENVIRONMENT, "Key of an agent's info")}
    of_terms = rows.pop("reward_<term>")
    documented = rows | {f"reward_{term}": of_terms for term in TERMS}
    env = ptne_env.parallel_env("energy", reward=dict.fromkeys(TERMS, 1.0), max_cycles=1)
    first = env.reset(seed=0)[1]
    last = env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})[4]
    for infos in (first, last):
        assert {name: value.dtype.name for name, value in infos["player_0"].items()} == documented
