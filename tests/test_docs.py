"""The documents agree with the code: programs run, links lead to files, and names and numbers exist."""

import ast
import dataclasses
import importlib.util
import inspect
import itertools
import math
import re
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typer
from processes import run_python

import ptne_env
from ptne_env.cli import app
from ptne_env.evaluation import POLICIES, get_suite
from ptne_env.evaluation.suite import world_names
from ptne_env.learn import shipped
from ptne_env.theory.paper.numbers import PRINTED
from ptne_env.world.catalogue import CATALOGUE
from ptne_env.world.rewards import TERMS
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "ptne_env"
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PAGES = [*DOCUMENTS, *sorted(ROOT.glob("[!R]*.md")), *sorted((ROOT / "baselines").glob("*.md"))]
PARTS = ROOT / "docs" / "adding-parts.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def text_of(document):
    return document.read_text(encoding="utf-8")


def blocks(document, language):
    return [body for kind, body in BLOCK.findall(text_of(document)) if kind == language]


def prose(document):
    """The text without its code blocks."""
    return BLOCK.sub("", text_of(document))


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
    """The output of a program in a fresh interpreter, in which every warning is an error."""
    done = run_python("-W", "error", "-c", code, folder=folder, modules=[ROOT / "examples"])
    assert done.stderr == ""
    return done.stdout


def ptne(words, folder):
    """The output of a command, run like its script, which does not import from the current folder by itself."""
    return run_python("-P", "-W", "error", "-m", "ptne_env.cli", *words[1:], folder=folder, modules=[ROOT]).stdout


# --- programs ---------------------------------------------------------------------------------------------------------

PROGRAMS = [
    pytest.param(code, id=f"{document.stem}-{index}")
    for document in DOCUMENTS
    for index, code in enumerate(blocks(document, "python"))
    if document != PARTS
]


@pytest.mark.parametrize("code", PROGRAMS)
def test_code_runs_as_printed_without_a_warning(code, tmp_path):
    run(code, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_code_about_parts_runs_as_one_program(tmp_path):
    printed = run("\n".join(blocks(PARTS, "python")), tmp_path)
    assert "<Results of own-parts-v1: heavy-ball, zero-input, static, oracle on contest, clipped, seed 0>" in printed
    assert list(tmp_path.iterdir()) == []


def test_readme_loop_prints_the_promised_distance(tmp_path):
    loop = blocks(ROOT / "README.md", "python")[0]
    assert "laws.Static(env.layout, kappa=2.0)" in loop
    assert float(run(loop, tmp_path)) == pytest.approx(6.5e-5, rel=0.01)


def test_readme_is_short_and_names_the_example_in_one_file_first():
    readme = ROOT / "README.md"
    assert len(readme.read_bytes()) <= 8000
    for document in (readme, ROOT / "docs" / "index.md"):
        links = re.findall(r"\]\(([^)]*\.(?:py|md))\)", prose(document))
        assert links[0].endswith("examples/in_one_file.py")


def test_parts_in_the_document_are_those_of_the_example():
    example = definitions(text_of(ROOT / "examples" / "own_parts.py"))
    printed = {}
    for code in blocks(PARTS, "python"):
        printed |= definitions(code)
    shared = sorted(set(example) & set(printed))
    assert shared == ["BeautyContest", "Clipped", "HeavyBall", "suite", "wheel"]
    assert [name for name in shared if example[name] != printed[name]] == []


def definitions(code):
    return {node.name: ast.dump(node) for node in ast.parse(code).body if hasattr(node, "name")}


# --- commands ---------------------------------------------------------------------------------------------------------


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
    """The name of the command and its parameters, from the arguments of ``ptne``, without running it."""
    group = typer.main.get_command(app)
    group.callback = lambda **_: None
    for name, command in group.commands.items():
        command.callback = lambda name=name, **parameters: (name, parameters)
    return group.main(arguments, standalone_mode=False)


def options():
    """Every option of ``ptne`` and of its commands."""
    group = typer.main.get_command(app)
    parameters = [parameter for command in (group, *group.commands.values()) for parameter in command.params]
    return {"--help", *(option for parameter in parameters for option in parameter.opts)}


def by_path(document):
    return document.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("document", PAGES, ids=by_path)
def test_commands_exist_with_the_named_scenarios_tracks_and_policies(document):
    for arguments in [words[1:] for words in commands(document) if words[0] == "ptne"]:
        if arguments and arguments[-1].startswith("--"):  # inline code that names an option
            assert arguments.pop() in options()
        if len(arguments) < 2:  # inline code that names a command
            assert set(arguments) <= set(typer.main.get_command(app).commands)
            continue
        _, parameters = parse(arguments)
        scenarios, policies = parameters.get("scenario") or (), parameters.get("policy") or ()
        tracks = [track.name for track in get_suite("ptne-v1").tracks] if parameters.get("suite") else world_names()
        places = [scenarios] if isinstance(scenarios, str) else [*scenarios, *(parameters.get("track") or ())]
        named = {name for name in places if not (":" in name or name.rpartition("/")[2].isupper())}
        assert named <= set(tracks), arguments
        policies = [policies] if isinstance(policies, str) else policies
        names = {name for names in policies for name in names.split(",") if not re.search(r"[:.=]", name)}
        assert names <= set(POLICIES) | set(shipped()), arguments


@pytest.mark.parametrize("arguments", ["compare --scenarios energy", "contrast", "render energy", "train --out DIR"])
def test_an_unknown_command_or_option_is_an_error_here(arguments):
    with pytest.raises(Exception, match=r"(?i)no such|missing"):
        parse(arguments.split())


@pytest.mark.parametrize("document", PAGES, ids=by_path)
def test_options_scripts_and_make_targets_exist(document):
    named = commands(document)
    assert {words[0].partition("=")[0] for words in named if words[0].startswith("--")} <= options()
    targets = re.findall(r"^(\w+):", text_of(ROOT / "Makefile"), re.MULTILINE)
    assert {words[1] for words in named if words[0] == "make" and len(words) > 1} <= set(targets)
    for words in named:
        if words[0] in ("python", "python3") and words[1:] and words[1:2] != ["-m"]:
            assert (ROOT / words[1]).is_file(), words
        elif words[0] in ("python", "python3") and words[2:] and words[2] != "venv":
            assert importlib.util.find_spec(words[2]), words


# --- printed results --------------------------------------------------------------------------------------------------


def test_tour_prints_its_tables_and_writes_its_files(tmp_path):
    tour = ROOT / "docs" / "tour.md"
    (policy,) = [code for code in blocks(tour, "python") if "class Ramp" in code]
    assert "`my_policy.py`:" in prose(tour)
    (tmp_path / "my_policy.py").write_text(policy, encoding="utf-8")
    lines = "".join(blocks(tour, "console")).splitlines()
    first, page, _, small, whole, check = [shlex.split(line) for line in lines if re.match("ptne [a-z]", line)]
    for command, printed in zip((first, small), blocks(tour, "text"), strict=True):
        assert lines_not_in(ptne(command, tmp_path), printed) == []
    assert (tmp_path / "results" / "comparison" / "report.html").is_file()
    ptne(page, tmp_path)
    assert (tmp_path / page[-1]).is_file()
    ptne([*whole, "--track", "nominal", "--track", "hold", "--episodes", "2"], tmp_path)
    assert (tmp_path / "results" / "ptne-v1" / "report.html").is_file()
    ptne([*check, "--sample", "1"], tmp_path)


def lines_not_in(output, quoted):
    """The lines of ``quoted`` with which no line of ``output`` starts, in the same order."""
    lines = iter([words_of(line) for line in output.splitlines()])
    return [
        words
        for words in filter(None, map(words_of, quoted.splitlines()))
        if not any(len(line) >= len(words) and all(map(agree, line, words)) for line in lines)
    ]


def test_certificate_in_the_theory_is_the_output_of_its_command(tmp_path):
    document, command = ROOT / "docs" / "theory.md", "ptne certify energy --noise 0.001 --delay 3"
    assert f"Printed by `{command}`" in prose(document)
    printed = ptne(command.split(), tmp_path)
    assert words_of(printed[printed.index("energy: Static") :]) == words_of(blocks(document, "text")[0])


def words_of(text):
    """The words of printed tables without the rules and without the values in the column of times."""
    words, timed = [], False
    for line in text.splitlines():
        row = [word for word in line.split() if not set(word) <= {"─"}]
        if row[:1] == ["policy"]:
            timed = row[-1:] == ["decision"]
        elif timed and len(row) >= 4 and not row[0].startswith("["):
            row.pop()
        words += row
    return words


def agree(ours, theirs):
    try:
        a, b = (float(word.strip("[],")) for word in (ours, theirs))
    except ValueError:
        return ours == theirs
    return math.isclose(a, b, rel_tol=0.02, abs_tol=1e-12)  # below 1e-12 all is rounding


def test_readme_table_is_that_of_the_leaderboards():
    leaderboard = {row[0]: [row[1], *row[3:5]] for row in table(ROOT / "baselines" / "ptne-v1.md", "track")}
    rows = table(ROOT / "README.md", "Track")
    assert len(rows) >= 5
    for track, *entries in rows:
        assert entries == leaderboard[track]


# --- links and names --------------------------------------------------------------------------------------------------


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
        nodes = ast.walk(ast.parse(text_of(path)))
        names = {node.name for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}
        result[path.relative_to(ROOT).as_posix()] = names
    return result


@pytest.mark.parametrize("document", PAGES, ids=by_path)
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
    counts |= {"Problem": 1, "Example": 2, "Fig.": 10}
    assert "Table I " in items
    assert [
        f"{kind} {k}"
        for kind in counts
        for k in range(1, counts[kind] + 1)
        if f" {kind} {k} " not in f"{items} ".replace(",", " ")
    ] == []


def test_paper_map_lists_the_labels_with_their_printed_numbers():
    rows = table(ROOT / "docs" / "paper-map.md", "Printed")
    assert {label: number for number, labels in rows for label in re.findall(r"`(\w+)`", labels)} == PRINTED


def test_texts_name_printed_numbers_and_no_labels_of_the_source():
    names_here = {"Problem", "NonQuadraticGame"}  # a word, and a class
    labels = {label for label in PRINTED if len(label) > 5} - names_here
    texts = {path: text_of(path) for path in [*PAGES, *PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.html")]}
    named = {by_path(path): sorted(labels & set(re.findall(r"\w+", text))) for path, text in texts.items()}
    assert {path for path, found in named.items() if found} == {"docs/paper-map.md", "ptne_env/theory/paper/numbers.py"}
    equations = {int(number) for text in texts.values() for number in re.findall(r"\beqs?\. \((\d+)\)", text)}
    assert {9, 10, 15, 50} <= equations <= set(range(1, 52))


def test_architecture_names_every_module_and_package():
    text = text_of(ROOT / "docs" / "architecture.md")
    modules = [path.name for path in PACKAGE.glob("[!_]*.py")]
    packages = [f"{path.parent.name}/" for path in PACKAGE.glob("*/__init__.py")]
    assert [name for name in modules + packages if f"`{name}" not in text] == []


# --- tables -----------------------------------------------------------------------------------------------------------

ENVIRONMENT = ROOT / "docs" / "environment.md"


def first_cells(document, header):
    return [row[0].strip("`") for row in table(document, header)]


@pytest.mark.parametrize("kind", ["physical", "local"])
def test_observation_table_is_the_layout(kind):
    column = {"physical": 2, "local": 3}[kind]
    expected = {row[0].strip("`"): row[column] for row in table(ENVIRONMENT, "Slice") if row[column] != "–"}
    scalar = [name for name, scenario in CATALOGUE.items() if World(scenario).game.action_dims == (1,) * 5]
    assert len(scalar) > 9  # the others have another number of players or components
    for scenario in scalar:
        slices = ptne_env.parallel_env(scenario, interface=kind).layout.slices
        assert expected == {name: f"{part.start}:{part.stop}" for name, part in slices.items()}


def test_shapes_in_the_document_are_those_of_the_spaces():
    facts = {row[0]: row[1] for row in table(ENVIRONMENT, "Property")}
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
    assert first_cells(ENVIRONMENT, "Scenario") == list(CATALOGUE)


def test_factories_in_the_document_exist():
    for name in first_cells(ENVIRONMENT, "Factory"):
        module, _, attribute = name.partition(":")
        assert callable(getattr(importlib.import_module(module), attribute))


@pytest.mark.parametrize("described", [ptne_env.parallel_env, Scenario])
def test_docstrings_describe_every_argument(described):
    """The documents have no tables of arguments and refer to these docstrings."""
    kinds = {parameter.name: parameter.kind for parameter in inspect.signature(described).parameters.values()}
    stars = {name: "**" if kind is inspect.Parameter.VAR_KEYWORD else "" for name, kind in kinds.items()}
    described_names = re.findall(r"^ {4}([\w*]+): ", inspect.getdoc(described), re.MULTILINE)
    assert [name for name in stars if stars[name] + name not in described_names] == []


def test_protocol_has_all_tracks_and_laws():
    document = ROOT / "docs" / "protocol.md"
    tracks = [name.strip("` ") for cell in first_cells(document, "Track") for name in cell.split(",")]
    assert tracks == [track.name for track in get_suite("ptne-v1").tracks]
    assert first_cells(document, "Law") == list(POLICIES)


def test_reward_and_info_tables_are_complete():
    assert [row[0].split("`")[1] for row in table(ENVIRONMENT, "Term")] == list(TERMS)
    rows = {row[0].strip("`"): row[1] for row in table(ENVIRONMENT, "Key of an agent's info")}
    of_terms = rows.pop("reward_<term>")
    documented = rows | {f"reward_{term}": of_terms for term in TERMS}
    env = ptne_env.parallel_env("energy", reward=dict.fromkeys(TERMS, 1.0), max_cycles=1)
    first = env.reset(seed=0)[1]
    last = env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})[4]
    for infos in (first, last):
        assert {name: value.dtype.name for name, value in infos["player_0"].items()} == documented
