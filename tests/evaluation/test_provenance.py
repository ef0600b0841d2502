"""The hashes of what a job depends on: they change with it, nothing is imported for them, and gaps are named."""

import functools
import importlib
import json
import pickle
import sys
from base64 import b64encode
from zipfile import ZipFile

import pytest
from processes import run_python
from ptne_env.evaluation.policy_specs import ARCHIVE
from small_suite import BASE, stored

from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import Suite, Track, get_policy_spec, jobs, run_suite
from ptne_env.evaluation.provenance import file_hashes, source_hashes, unhashed, versions
from ptne_env.perception.observation import Interface

SUITE = Suite("mine", (Track("ring", BASE, "The base."),), episodes=1)
LAW = "from ptne_env import laws\n\ndef make(layout):\n    return laws.Static(layout)\n"


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes files of a project, whose folder is on the path."""
    monkeypatch.syspath_prepend(tmp_path)
    versions()  # imports modules of its own
    before = set(sys.modules)

    def write_files(texts):
        for name, text in texts.items():
            path = tmp_path / f"{name}.py"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")

    yield write_files
    for name in set(sys.modules) - before:
        del sys.modules[name]


def key(target, **arguments):
    policy = PolicySpec("mine", FactorySpec.of(target, **arguments), Interface("physical"))  # else the module is asked for one
    return jobs.Job(SUITE.tracks[0], policy, 0, SUITE.episode_set("ring")).key


PROJECTS = {
    "partial": (
        {"mine": f"from functools import partial\n{LAW}\nbuilt = partial(make)\n"},
        "mine:built",
        {"mine": f"from functools import partial\n{LAW}\nbuilt = partial(make, 1)\n"},
    ),
    "callable instance": (
        {"mine": "class Make:\n    kappa = 1\n\nbuilt = Make()\n"},
        "mine:built",
        {"mine": "class Make:\n    kappa = 2\n\nbuilt = Make()\n"},
    ),
    "imported module": (
        {"mine": "import gains\n", "gains": "KAPPA = 1\n"},
        "mine:make",
        {"gains": "KAPPA = 2\n"},
    ),
    "module imported by an imported module": (
        {"mine": "from gains import KAPPA\n", "gains": "def get():\n    import numbers_\n", "numbers_": "KAPPA = 1\n"},
        "mine:make",
        {"numbers_": "KAPPA = 2\n"},
    ),
    "module of a package": (
        {"own/__init__": "", "own/laws": "from own import gains\n", "own/gains": "KAPPA = 1\n"},
        "own.laws:make",
        {"own/gains": "KAPPA = 2\n"},
    ),
    "package of a module": (
        {"own/__init__": "KAPPA = 1\n", "own/laws": LAW},
        "own.laws:make",
        {"own/__init__": "KAPPA = 2\n"},
    ),
    "relative import": (
        {"own/__init__": "", "own/laws": "from . import gains\n", "own/gains": "KAPPA = 1\n"},
        "own.laws:make",
        {"own/gains": "KAPPA = 2\n"},
    ),
    "relative import of a package": (
        {
            "own/__init__": "from .laws import make\n",
            "own/laws": "from .gains import KAPPA\n",
            "own/gains": "K = 1\n",
        },
        "own:make",
        {"own/gains": "K = 2\n"},
    ),
    "folder without __init__": (
        {"own/laws": "import own.gains\n", "own/gains": "KAPPA = 1\n"},
        "own.laws:make",
        {"own/gains": "KAPPA = 2\n"},
    ),
    "import by a call": (
        {"mine": "import importlib\ngains = importlib.import_module('gains')\n", "gains": "KAPPA = 1\n"},
        "mine:make",
        {"gains": "KAPPA = 2\n"},
    ),
    "relative import by a call": (
        {
            "own/__init__": "",
            "own/laws": "from importlib import import_module\ngains = import_module('.gains', __package__)\n",
            "own/gains": "KAPPA = 1\n",
        },
        "own.laws:make",
        {"own/gains": "KAPPA = 2\n"},
    ),
    "part that is named": (
        {"mine": "TARGET = 'gains:Gain'\n", "gains": "KAPPA = 1\n"},
        "mine:make",
        {"gains": "KAPPA = 2\n"},
    ),
}


@pytest.mark.parametrize("project", PROJECTS)
def test_a_change_of_a_project_makes_another_job_and_imports_nothing(write, project):
    files, target, change = PROJECTS[project]
    write(files)
    modules = set(sys.modules)
    before = key(target)
    assert key(target) == before
    write({"unrelated": "KAPPA = 1\n"})
    assert key(target) == before
    write(change)
    assert key(target) != before
    assert set(sys.modules) == modules


def test_files_of_one_name_in_two_folders_are_apart(write):
    write({"one/parts": "K = 1\n", "two/parts": "K = 1\n", "mine": "import one.parts, two.parts\n"})
    hashes = file_hashes(FactorySpec.of("mine:make"))
    assert set(hashes) == {"mine", "one.parts", "two.parts"}
    before = key("mine:make")
    write({"two/parts": "K = 2\n"})
    assert key("mine:make") != before


def test_a_data_file_that_a_source_names_is_hashed(write, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    write({"mine": "PATHS = (Path(__file__).parent / 'weights.bin', 'here.bin', 'elsewhere')\n"})
    beside, here = tmp_path / "weights.bin", tmp_path / "elsewhere" / "here.bin"
    keys = {key("mine:make")}
    for path in (beside, here):
        for content in (b"1", b"2"):
            path.write_bytes(content)
            keys.add(key("mine:make"))
    assert len(keys) == 5
    assert set(file_hashes(FactorySpec.of("mine:make"))) == {"mine", "mine/weights.bin", "here.bin"}


def test_files_and_folders_in_arguments_are_hashed(write, tmp_path):
    write({"mine": LAW})
    (tmp_path / "weights").mkdir()
    keys = {key("mine:make", files=[str(tmp_path / "weights")])}
    for name in ("one", "two"):
        (tmp_path / "weights" / name).write_bytes(b"1")
        keys.add(key("mine:make", files=[str(tmp_path / "weights")]))
        keys.add(key("mine:make", file=str(tmp_path / "weights" / name)))
    (tmp_path / "weights" / "two").write_bytes(b"2")
    assert len(keys | {key("mine:make", files=[str(tmp_path / "weights")])}) == 6
    part = FactorySpec.of("ptne_env.world.graphs:cycle", players=str(tmp_path / "weights"))
    assert file_hashes(part) == {}  # parts of the library read no folders


@pytest.mark.parametrize("content", [b"cmy_net\nNet\n.", pickle.PROTO + b"\x04\x8c\x06my_net\x8c\x03Net\x93."])
def test_modules_that_an_archive_names_are_hashed(write, tmp_path, content):
    path = tmp_path / "model.zip"
    with ZipFile(path, "w") as archive:
        item = {":type:": "a class", ":serialized:": b64encode(content).decode()}
        archive.writestr("data", json.dumps({"policy_class": item, "seed": 3}))
    make = functools.partial(key, ARCHIVE, path=str(path))
    write({"my_net": "import my_layers\n", "my_layers": "WIDTH = 3\n"})
    before = make()
    assert make() == before
    write({"my_layers": "WIDTH = 4\n"})
    assert make() != before
    assert "my_net" not in sys.modules
    path.write_bytes(path.read_bytes()[:-9])  # loading it names the damage
    assert set(file_hashes(FactorySpec.of(ARCHIVE, path=str(path)))) == {str(path)}


def test_a_link_to_another_folder_in_a_folder_cannot_be_hashed(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write({"mine": ""})
    for name in ("weights", "elsewhere"):
        (tmp_path / name).mkdir()
    (tmp_path / "weights" / "more").symlink_to("../elsewhere")
    assert list(unhashed(file_hashes(FactorySpec.of("mine:make", folder="weights")))) == ["weights/more"]


def test_texts_that_are_no_names_of_files_do_no_harm(write):
    texts = ["", ".", "..", "/", "a\0b", "a\nb", "x" * 300, "x" * 100_000, "~", "*", "\ud800"]
    write({"mine": f"TEXTS = {texts!r}\n"})
    assert set(file_hashes(FactorySpec.of("mine:make", texts=texts))) == {"mine"}


def test_hashes_do_not_depend_on_the_place_of_the_project(tmp_path):
    program = (
        "from ptne_env import FactorySpec\n"
        "from ptne_env.evaluation.provenance import file_hashes\n"
        "print(sorted(file_hashes(FactorySpec.of('mine:make')).items()))\n"
    )
    printed = []
    for folder, current in (("one", "."), ("two", "two")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text("import parts\nPATH = 'weights.bin'\n", encoding="utf-8")
        (tmp_path / folder / "parts.py").write_text(LAW, encoding="utf-8")
        (tmp_path / folder / "weights.bin").write_bytes(b"1")
        run = run_python("-P", "-c", program, folder=tmp_path / current, modules=[tmp_path / folder])
        printed.append(run.stdout)
    assert printed[0] == printed[1]
    assert "mine/weights.bin" in printed[0]


def test_modules_of_python_and_of_the_library_are_known_by_their_versions():
    for target in (
        "builtins:dict",
        "os:system",
        "functools:partial",
        "json.decoder:JSONDecoder",
        "ptne_env.laws:Static",
    ):
        assert file_hashes(FactorySpec.of(target)) == {}
    assert set(file_hashes(FactorySpec.of("networkx:path_graph", n=3))) == {"networkx"}


@pytest.mark.parametrize(
    ("files", "target", "name", "reason"),
    [
        ({}, "no_such_module:make", "no_such_module", "no such module"),
        ({"mine": "import sys\nsys.path.append('x')\nimport hidden\n"}, "mine:make", "hidden", "no such module"),
        ({"mine": "def make(:\n"}, "mine:make", "mine", "cannot be parsed"),
        ({"mine": f"x = {'-' * 100_000}1\n"}, "mine:make", "mine", "cannot be parsed"),
    ],
)
def test_a_source_that_cannot_be_hashed_is_named(write, files, target, name, reason):
    write(files)
    hashes = file_hashes(FactorySpec.of(target))
    assert list(unhashed(hashes)) == [name]
    assert reason in unhashed(hashes)[name]


def test_modules_without_a_source_are_named(write, tmp_path, monkeypatch):
    (tmp_path / "compiled.pyc").write_bytes(b"")
    assert unhashed(file_hashes(FactorySpec.of("compiled:make"))) == {"compiled": "its source is missing"}
    write({"mine": LAW})
    monkeypatch.setattr("pathlib.Path.read_bytes", lambda path: (_ for _ in ()).throw(PermissionError(13, "denied")))
    assert unhashed(file_hashes(FactorySpec.of("mine:make"))) == {"mine": "denied"}


def test_an_import_that_may_fail_need_not_be_found(write):
    write({"mine": "try:\n    import no_such_module\nexcept ImportError:\n    pass\n"})
    assert unhashed(file_hashes(FactorySpec.of("mine:make"))) == {}


def test_main_has_a_source_in_a_script_and_none_in_a_notebook(tmp_path):
    program = (
        "from ptne_env import FactorySpec\n"
        "from ptne_env.evaluation.provenance import file_hashes, unhashed\n"
        "hashes = file_hashes(FactorySpec.of('__main__:make'))\n"
        "print(sorted(hashes), sorted(unhashed(hashes)))\n"
    )
    (tmp_path / "script.py").write_text(program, encoding="utf-8")
    for arguments, printed in ((["script.py"], "['__main__'] []"), (["-c", program], "['__main__'] ['__main__']")):
        assert run_python(*arguments, folder=tmp_path).stdout.strip() == printed


def test_jobs_that_cannot_be_hashed_are_not_stored_unless_they_are_run_again(write, tmp_path):
    write({"mine": f"import sys\nsys.path.append({str(tmp_path / 'hidden')!r})\nimport gains\n{LAW}"})
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "gains.py").write_text("", encoding="utf-8")
    with pytest.raises(ValueError, match=r"gains cannot be hashed: no such module is found\); --rerun"):
        run_suite(SUITE, ["mine:make"], folder=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    for _ in range(2):
        run_suite(SUITE, ["mine:make"], folder=tmp_path / "out", rerun=True)
    assert len(stored(tmp_path / "out")) == 4
    run_suite(SUITE, ["mine:make"])  # without a folder nothing can be stale


def test_the_modules_of_the_parts_of_a_track_are_hashed(write):
    write({"parts": "from ptne_env import graphs\n\ndef ring():\n    return graphs.cycle(5)\n"})
    ring = BASE.replace(topology=FactorySpec.of("parts:ring"))
    suite = Suite("mine", (Track("mine", ring, "Own graph."), Track("ring", BASE, "The base.")))

    def keys():
        policy = get_policy_spec("static")
        return {track.name: jobs.Job(track, policy, 0, suite.episode_set(track.name)).key for track in suite.tracks}

    before = keys()
    write({"parts": "from ptne_env import graphs\n\ndef ring():\n    return graphs.path(5)\n"})
    changed = keys()
    assert changed["ring"] == before["ring"]
    assert changed["mine"] != before["mine"]


def test_the_module_of_a_metric_is_hashed(write):
    write({"gauge": "def seven(rollout):\n    return 7.0\n"})
    seven = importlib.import_module("gauge").seven
    before = source_hashes([seven])
    assert set(before) == {"gauge"}
    write({"gauge": "def seven(rollout):\n    return 8.0\n"})
    assert source_hashes([seven]).keys() == before.keys()
    assert source_hashes([seven]) != before
    assert set(unhashed(source_hashes([functools.partial(seven)]))) == {"a partial"}
