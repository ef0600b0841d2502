"""The documents say what is true: their code runs, their links lead somewhere, their names and numbers exist."""

import ast
import dataclasses
import importlib.util
import inspect
import itertools
import math
import re
import runpy
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typer
from matplotlib import image
from processes import run_python

import ptne_env
from ptne_env.catalogue import CATALOGUE
from ptne_env.cli import app
from ptne_env.experiments import ENTRIES
from ptne_env.experiments.suite import get_suite
from ptne_env.policies import shipped
from ptne_env.rewards import TERMS
from ptne_env.scenario import Scenario
from ptne_env.world import World

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "ptne_env"
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES = [*DOCUMENTS, *sorted(ROOT.glob("[!R]*.md")), *sorted((ROOT / "baselines").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(document, language):
    return [body for kind, body in BLOCK.findall(document.read_text(encoding="utf-8")) if kind == language]


def prose(document):
    """The text without its code blocks."""
    return BLOCK.sub("", document.read_text(encoding="utf-8"))


def table(document, header):
    """The rows of the table whose header starts with ``header``, each a list of cells."""
    lines = iter(prose(document).splitlines())
    for line in lines:
        if line.startswith(f"| {header} |"):
            next(lines)
            rows = itertools.takewhile(lambda row: row.startswith("|"), lines)
            return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    raise AssertionError(f"{document.name} has no table that starts with {header!r}")


def run(code, folder):
    """The output of a program that may name parts of the examples; every warning is an error."""
    done = run_python("-W", "error", "-c", code, folder=folder, modules=[ROOT / "examples"])
    assert done.stderr == ""
    return done.stdout


PYTHON = [
    pytest.param(code, id=f"{document.stem}-{index}")
    for document in DOCUMENTS
    for index, code in enumerate(blocks(document, "python"))
]


@pytest.mark.parametrize("code", PYTHON)
def test_code_runs_as_printed_without_a_warning(code, tmp_path):
    run(code, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_readme_has_the_loop_and_it_prints_the_promised_distance(tmp_path):
    loop = blocks(ROOT / "README.md", "python")[0]
    assert "laws.Static(env.layout, kappa=2.0)" in loop
    assert float(run(loop, tmp_path)) == pytest.approx(6.5e-5, rel=0.01)


def told_commands(document):
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
    """What ``ptne`` makes of its arguments, without doing it: the name of the command and its parameters."""
    group = typer.main.get_command(app)
    group.callback = lambda **_: None
    for name, command in group.commands.items():
        command.callback = lambda name=name, **parameters: (name, parameters)
    return group.main(arguments, standalone_mode=False)


def options():
    """Every option of ``ptne`` and of its commands."""
    group = typer.main.get_command(app)
    return {option for one in (group, *group.commands.values()) for each in one.params for option in each.opts} | {
        "--help"
    }


@pytest.mark.parametrize("document", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_are_those_of_the_command_line(document):
    for arguments in [words[1:] for words in told_commands(document) if words[0] == "ptne"]:
        if arguments and arguments[-1].startswith("--"):  # an option is only named
            assert arguments.pop() in options()
        if len(arguments) < 2:  # a command is only named
            assert set(arguments) <= set(typer.main.get_command(app).commands)
            continue
        _, parameters = parse(arguments)
        scenarios, suite = parameters.get("scenario") or (), parameters.get("suite")
        for scenario in [scenarios] if isinstance(scenarios, str) else scenarios:
            assert scenario in CATALOGUE or scenario.isupper() or scenario.startswith("ptne-v1/"), arguments
        tracks = [track.name for track in get_suite(suite).tracks] if suite == "ptne-v1" else ()
        assert set(parameters.get("track") or ()) <= set(tracks), arguments
        names = (parameters.get("policies") or "").split(",")
        assert {name for name in names if name and ":" not in name} <= set(ENTRIES) | set(shipped()), arguments


@pytest.mark.parametrize("arguments", ["compare --scenarios energy", "contrast", "render energy", "train --out DIR"])
def test_a_command_that_does_not_exist_would_be_noticed(arguments):
    with pytest.raises(Exception, match=r"(?i)no such|missing"):
        parse(arguments.split())


@pytest.mark.parametrize("document", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_options_scripts_and_make_targets_exist(document):
    commands = told_commands(document)
    told = {words[0].partition("=")[0] for words in commands if words[0].startswith("--")}
    assert told <= options()
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {words[1] for words in commands if words[0] == "make" and len(words) > 1} <= set(targets)
    for words in commands:
        if words[0] in ("python", "python3") and words[1:] and words[1:2] != ["-m"]:
            assert (ROOT / words[1]).is_file(), words
        elif words[0] in ("python", "python3") and words[2:] and words[2] != "venv":
            assert importlib.util.find_spec(words[2]), words


def test_the_tour_leads_where_it_says(tmp_path):
    tour = ROOT / "docs" / "tour.md"
    (policy,) = [code for code in blocks(tour, "python") if "class Ramp" in code]
    assert "`my_policy.py`:" in prose(tour)
    (tmp_path / "my_policy.py").write_text(policy, encoding="utf-8")
    lines = "".join(blocks(tour, "console")).splitlines()
    first, film, _, small, whole, again = [shlex.split(line) for line in lines if re.match("ptne [a-z]", line)]
    tables = blocks(tour, "text")
    for command, told in ((first, tables[0]), (small, tables[1])):
        assert starts_of_lines(told, ptne(command, tmp_path)) == []
    assert (tmp_path / "results" / "report" / "index.html").is_file()
    ptne(film, tmp_path)
    assert (tmp_path / film[-1]).is_file()
    ptne([*whole, "--track", "nominal", "--track", "hold", "--episodes", "2"], tmp_path)
    assert (tmp_path / "results" / "ptne-v1" / "report" / "index.html").is_file()
    ptne([*again, "--sample", "1"], tmp_path)


def starts_of_lines(told, printed):
    """The lines of ``told`` that no line of ``printed`` starts with, in the same order."""
    lines = iter([_words(line) for line in printed.splitlines()])
    return [
        words
        for words in filter(None, map(_words, told.splitlines()))
        if not any(len(line) >= len(words) and all(map(_agree, line, words)) for line in lines)
    ]


def ptne(words, folder):
    """The output of a command; like its script, it does not import modules from the current folder by itself."""
    return run_python("-P", "-W", "error", "-m", "ptne_env.cli", *words[1:], folder=folder, modules=[ROOT]).stdout


def test_parts_in_the_document_are_those_of_the_example():
    example = definitions((ROOT / "examples" / "own_parts.py").read_text(encoding="utf-8"))
    told = {}
    for code in blocks(ROOT / "docs" / "adding-parts.md", "python"):
        told |= definitions(code)
    shared = sorted(set(example) & set(told))
    assert shared == ["BeautyContest", "Clipped", "HeavyBall", "suite", "wheel"]
    assert [name for name in shared if example[name] != told[name]] == []


def definitions(code):
    return {node.name: ast.dump(node) for node in ast.parse(code).body if hasattr(node, "name")}


def test_the_list_of_examples_is_complete():
    text = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    assert [path.name for path in (ROOT / "examples").glob("*.py") if path.name not in text] == []


def test_the_site_builds_without_a_warning_has_everything_and_needs_no_network(tmp_path):
    """As ``make docs`` builds it. A link that leads nowhere, in a document or a docstring, is a warning."""
    (recipe,) = re.findall(r"sphinx-build (.*) \. \$\(OUT\)/site", (ROOT / "Makefile").read_text(encoding="utf-8"))
    run_python("-m", "sphinx", *recipe.split(), ROOT, tmp_path, folder=ROOT)
    html = {
        path.relative_to(tmp_path).with_suffix("").as_posix(): path.read_text(encoding="utf-8")
        for path in tmp_path.rglob("*.html")
    }
    assert {page.relative_to(ROOT).with_suffix("").as_posix() for page in PAGES} <= set(html)
    assert "docs/index.html" in html["index"]

    reference = "".join(text for name, text in html.items() if name.startswith("docs/api/"))
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in PACKAGE.rglob("[!_]*.py")]
    silent = [name for name in modules if f'id="module-{name}"' not in reference and not name.endswith("_v0")]
    assert silent == ["ptne_env.cli"]  # whose reference is --help
    for public in (ptne_env.parallel_env, ptne_env.ObservationLayout, ptne_env.laws.Static):
        assert f'id="{public.__module__}.{public.__qualname__}"' in reference
    assert "TypeAliasForwardRef" not in reference

    mathematics = ROOT / "docs" / "mathematics.md"
    formulas = re.findall(r"\$[^$]+\$", prose(mathematics)) + blocks(mathematics, "math")
    assert html["docs/mathematics"].count("<math ") == len(formulas) > 100
    assert [formula for formula in formulas if formula[0] == "$" and re.search(r"\\[,;!{}]", formula)] == []  # GitHub
    for text in html.values():
        assert re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"(?:https?:)?//", text) == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.stem)
def test_relative_links_lead_to_a_file(document):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", prose(document))
    missing = [link for link in links if "://" not in link and not (document.parent / link).exists()]
    assert missing == []


@cache
def functions_by_file():
    """The names of all test functions, by file relative to the project's folder."""
    result = {}
    for path in (ROOT / "tests").rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        names = {node.name for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}
        result[path.relative_to(ROOT).as_posix()] = names
    return result


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.stem)
def test_named_tests_exist(document):
    everything = set().union(*functions_by_file().values())
    text = prose(document)
    wrong = [
        f"{file}::{name}"
        for file, name in re.findall(r"(tests/[\w/]+\.py)::(\w+)", text)
        if name not in functions_by_file().get(file, ())
    ]
    wrong += [name for name in re.findall(r"\b(test_\w+)\b(?!\.py)", text) if name not in everything]
    assert wrong == []


def exists(file, name):
    """Whether ``file`` (of the project or the package) exists and, if it is given, ``name`` is in that module."""
    if (ROOT / file).is_file() and not name:
        return True
    path = PACKAGE / file.removeprefix("ptne_env/")
    if not path.is_file():
        return False
    if not name:
        return True
    owner = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    *parents, last = name.split(".")
    for parent in parents:
        owner = getattr(owner, parent, None)
    fields = {field.name for field in dataclasses.fields(owner)} if dataclasses.is_dataclass(owner) else set()
    return hasattr(owner, last) or last in fields


def test_files_and_objects_named_in_the_paper_map_exist():
    text = prose(ROOT / "docs" / "paper-map.md")
    named = [found for found in re.findall(r"`((?:\w+/)*\w+\.py)(?:::([\w.]+))?`", text) if "tests/" not in found[0]]
    assert len(named) > 40
    assert [f"{file}::{name}" for file, name in named if not exists(file, name)] == []


def test_paper_map_has_every_equation_theorem_and_figure_of_the_paper():
    rows = [line for line in prose(ROOT / "docs" / "paper-map.md").splitlines() if line.startswith("|")]
    items = " ".join(row.split("|")[1] for row in rows)
    numbers = set()
    for first, last in re.findall(r"\((\d+)[a-c]?\)(?:–\((\d+)[a-c]?\))?", items):
        numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(range(1, 52))
    counts = {"Definition": 1, "Assumption": 4, "Lemma": 1, "Proposition": 1, "Theorem": 4, "Corollary": 1, "Remark": 6}
    counts |= {"Problem": 1, "Example": 2, "Table": 1, "Fig.": 10}
    assert [
        f"{kind} {k}"
        for kind in counts
        for k in range(1, counts[kind] + 1)
        if f" {kind} {k} " not in f"{items} ".replace(",", " ")
    ] == []


def test_architecture_names_every_module():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    modules = {path.name for path in PACKAGE.rglob("*.py")} - {"__init__.py", "_version.py"}
    assert sorted(name for name in modules if name not in text and not name.endswith("_v0.py")) == []


@pytest.mark.parametrize("kind", ["physical", "local"])
def test_observation_table_is_the_layout(kind):
    rows = table(ROOT / "docs" / "environment.md", "Slice")
    column = {"physical": 2, "local": 3}[kind]
    told = {row[0].strip("`"): row[column] for row in rows if row[column] != "–"}
    scalar = [name for name, scenario in CATALOGUE.items() if World(scenario).game.action_dims == (1,) * 5]
    assert len(scalar) > 9  # the others have another number of players or components
    for scenario in scalar:
        slices = ptne_env.parallel_env(scenario, interface=kind).layout.slices
        assert told == {name: f"{part.start}:{part.stop}" for name, part in slices.items()}


def test_shapes_told_are_those_of_the_spaces():
    facts = {row[0]: row[1] for row in table(ROOT / "docs" / "environment.md", "Property")}
    physical, local, gains = (
        ptne_env.parallel_env("energy", **arguments)
        for arguments in ({}, {"interface": "local"}, {"action_mode": "gains"})
    )
    shapes = [env.observation_space("player_0").shape for env in (physical, local)]
    assert re.findall(r"\(\d+,\)", facts["Observation shape and values"]) == [str(shape) for shape in shapes]
    shapes = [env.action_space("player_0").shape for env in (physical, gains)]
    assert re.findall(r"\(\d+,\)", facts["Action shape and values"]) == [str(shape) for shape in shapes]
    assert re.findall(r"\(\d+,\)", facts["State shape"]) == [str(physical.state_space.shape)]


def test_scenario_table_is_the_catalogue():
    rows = table(ROOT / "docs" / "environment.md", "Scenario")
    assert [row[0].strip("`") for row in rows] == list(CATALOGUE)
    for row in rows:
        module = importlib.import_module(f"ptne_env.{row[1].strip('`')}")
        assert module.parallel_env().scenario == CATALOGUE[row[0].strip("`")]


def test_argument_tables_are_the_signatures():
    document = ROOT / "docs" / "environment.md"
    told = {row[0].strip("`"): row[1].strip("`") for row in table(document, "Argument")}
    parameters = inspect.signature(ptne_env.parallel_env).parameters.values()
    assert told == {p.name: repr(p.default).replace("'", '"') for p in parameters if p.kind is not p.VAR_KEYWORD}
    told = {row[0].strip("`"): row[1].strip("`") for row in table(document, "Field")}
    fields = {field.name: field.default for field in dataclasses.fields(Scenario)}
    assert list(told) == list(fields)
    for name, default in fields.items():
        if default is dataclasses.MISSING:
            assert told[name] == "the scenario's"
        else:
            assert getattr(CATALOGUE["energy"].replace(**{name: ast.literal_eval(told[name])}), name) == default


def test_protocol_tells_all_tracks_and_laws():
    document = ROOT / "docs" / "protocol.md"
    tracks = [name.strip("` ") for row in table(document, "Track") for name in row[0].split(",")]
    assert tracks == [track.name for track in get_suite("ptne-v1").tracks]
    laws = {row[0].strip("`"): (row[1].strip("`"), row[2].strip("`")) for row in table(document, "Law")}
    parts = {name: entry.to_dict()["policy"] for name, entry in ENTRIES.items()}
    assert laws == {
        name: (part["target"].partition(":")[2], ", ".join(f"{k}={v:g}" for k, v in part["arguments"].items()))
        for name, part in parts.items()
    }


def test_reward_and_info_tables_are_complete():
    document = ROOT / "docs" / "environment.md"
    assert [row[0].split("`")[1] for row in table(document, "Term")] == list(TERMS)
    env = ptne_env.parallel_env("energy", steps=400, max_cycles=1)
    env.reset(seed=0)
    *_, infos = env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})
    assert {row[0].strip("`") for row in table(document, "Key of an agent's info")} == set(infos["player_0"])


def test_the_comparison_in_the_readme_is_what_its_command_prints(tmp_path):
    # To renew it, paste the output of the command, piped; the last column of the last table is the machine's.
    assert "Printed by `ptne compare --scenario energy`" in prose(ROOT / "README.md")
    told = blocks(ROOT / "README.md", "text")[0]
    printed = run(
        "from ptne_env.cli import main; import sys; sys.argv[1:] = ['compare', '--scenario', 'energy']; main()",
        tmp_path,
    )
    expected, found = _words(printed), _words(told)
    assert len(found) == len(expected)
    for ours, theirs in zip(found, expected, strict=True):
        assert _agree(ours, theirs), (ours, theirs)


def test_the_certificate_in_the_theory_is_what_its_command_prints(tmp_path):
    arguments = ["certify", "energy", "--noise", "0.001", "--delay", "3"]
    assert f"Printed by `ptne {' '.join(arguments)}`" in prose(ROOT / "docs" / "theory.md")
    told = blocks(ROOT / "docs" / "theory.md", "text")[0]
    printed = run(f"from ptne_env.cli import main; import sys; sys.argv[1:] = {arguments}; main()", tmp_path)
    assert _words(printed[printed.index("energy: Static") :]) == _words(told)


def _words(text):
    """The words of a comparison without the rules and without the values in the column of times."""
    words, timed = [], False
    for line in text.splitlines():
        row = [word for word in line.split() if not set(word) <= {"─"}]
        if row[:1] == ["policy"]:
            timed = line.rstrip().endswith("µs per decision")
        elif timed and len(row) >= 4 and not row[0].startswith("["):
            row.pop()
        words += row
    return words


def _agree(ours, theirs):
    try:
        a, b = (float(word.strip("[],")) for word in (ours, theirs))
    except ValueError:
        return ours == theirs
    return math.isclose(a, b, rel_tol=0.02, abs_tol=1e-12)  # below twelve digits all is rounding


def test_the_picture_of_a_run_can_be_made_again(tmp_path):
    script = runpy.run_path(str(ROOT / "docs" / "make_pictures.py"))
    script["draw_run"](tmp_path / "run.png")
    ours, shipped = image.imread(tmp_path / "run.png"), image.imread(ROOT / "docs" / "images" / "run.png")
    assert ours.shape == shipped.shape
    assert np.abs(ours - shipped).mean() < 0.05  # fonts differ between machines, curves do not
