"""The import of the package: its cost, its public names and the registered environments."""

import ast
import importlib
import re
import sys
import tomllib
from pathlib import Path

import gymnasium
import pettingzoo
import pytest
from processes import run_python

import ptne_env

SOURCE = Path(ptne_env.__file__)
HEAVY = (
    *("torch", "matplotlib", "scipy.stats", "stable_baselines3", "pandas", "networkx"),
    *("jax", "torchrl", "tensordict"),
)

PUBLIC = {
    alias.asname: node.module
    for node in ast.walk(ast.parse(SOURCE.read_text(encoding="utf-8")))
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
    if alias.asname
}
"""The names that type checkers see, and the module of each."""


def modules_after(statement):
    """The names of all modules in a fresh interpreter after a statement."""
    return set(run_python("-c", f"{statement}\nimport sys\nprint(*sys.modules)").stdout.split())


def test_importing_the_package_imports_no_heavy_module():
    loaded = modules_after("import ptne_env")
    assert "ptne_env.envs" in loaded
    assert not loaded & {*HEAVY, "ptne_env.world.world"}


def test_making_an_environment_imports_no_extra():
    loaded = modules_after("import ptne_env\nptne_env.parallel_env('energy').reset(seed=1)")
    assert "ptne_env.envs.parallel" in loaded
    assert not loaded & (set(HEAVY) - {"networkx"})


@pytest.mark.parametrize(
    ("framework", "module", "advice"),
    [
        ("torchrl", "ptne_env.envs.torchrl", r'pip install "ptne-env\[torchrl\]"'),
        ("stable_baselines3", "ptne_env.envs.sb3", r'pip install "ptne-env\[sb3\]"'),
    ],
)
def test_an_adapter_without_its_framework_says_how_to_install_it(framework, module, advice, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == framework]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, framework, None)
    monkeypatch.delitem(sys.modules, module, raising=False)
    with pytest.raises(ImportError, match=advice):
        importlib.import_module(module)


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_a_public_name_is_the_object_that_type_checkers_see(name):
    home = importlib.import_module(PUBLIC[name])
    assert getattr(ptne_env, name) is getattr(home, name)


def test_a_star_import_brings_the_names_that_type_checkers_see():
    assert {*ptne_env.__all__, "__version__"} == set(PUBLIC) == set(dir(ptne_env))


def test_only_public_modules_and_names_are_attributes():
    assert ptne_env.games is importlib.import_module("ptne_env.games")
    for missing in ("nothing_of_the_kind", "_private", "Games"):
        with pytest.raises(AttributeError, match=f"'ptne_env' has no attribute '{missing}'"):
            getattr(ptne_env, missing)


def test_exactly_the_catalogue_is_registered_with_pettingzoo():
    parallel = {name for name in pettingzoo.parallel_registry if name.startswith("ptne/")}
    assert parallel == {f"ptne/{scenario}-v0" for scenario in ptne_env.CATALOGUE}
    assert {name for name in pettingzoo.aec_registry if name.startswith("ptne/")} == parallel


def test_exactly_the_catalogue_is_registered_with_gymnasium():
    joint = {name for name in gymnasium.registry if name.startswith("ptne/")}
    assert joint == {f"ptne/{scenario}{view}-v0" for scenario in ptne_env.CATALOGUE for view in ("", "-joint")}


def test_gymnasium_makes_an_environment_by_its_module_and_name():
    statement = "import gymnasium\nenv = gymnasium.make('ptne_env:ptne/energy-joint-v0')\nenv.reset(seed=3)"
    assert "ptne_env.envs.gymnasium" in modules_after(statement)


LAYERS = tomllib.loads((SOURCE.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
RANKS = {
    module: rank
    for rank, names in enumerate(reversed(LAYERS["contracts"][0]["layers"]))
    for module in names.split(" | ")
}
MESSAGES = {
    "ptne_env.evaluation.comparison": "ptne_env.execution.Runner",
}
"""Messages that tell users of a layer above; the contract names them."""


def rank_of(module):
    """The place of a module in the layers, of the lowest 0; -1 for the package itself."""
    return RANKS.get(".".join(module.split(".")[:2]), -1)


def strings_of(path):
    """All strings of a module but its docstrings, which may tell of anything."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    told = {node.value for node in nodes if isinstance(node, ast.Expr)}
    return [node.value for node in nodes if isinstance(node, ast.Constant) and node not in told]


def test_no_string_names_a_module_of_a_layer_above():
    folder, above = SOURCE.parent, {}
    for path in folder.rglob("*.py"):
        module = ".".join(path.relative_to(folder.parent).with_suffix("").parts)
        assert "parents[" not in path.read_text(encoding="utf-8")  # which leads to a file of another folder
        names = [
            name for text in strings_of(path) if isinstance(text, str) for name in re.findall(r"ptne_env\.[\w.]+", text)
        ]
        if higher := {name for name in names if rank_of(name) > rank_of(module) >= 0}:
            above[module] = higher
    assert "ptne_env.learn" in above.pop("ptne_env.shared.parts")  # the one table that names all layers
    assert above == {module: {name} for module, name in MESSAGES.items()}


def test_every_folder_of_the_package_is_a_layer():
    folders = {f"ptne_env.{path.parent.name}" for path in SOURCE.parent.glob("*/__init__.py")}
    assert folders == set(RANKS)
