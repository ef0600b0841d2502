"""What importing the package costs, offers and tells the registries."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import gymnasium
import pettingzoo
import pytest

import ptne_env

SOURCE = Path(ptne_env.__file__)
HEAVY = ("torch", "matplotlib", "plotly", "scipy.stats", "stable_baselines3", "pandas", "onnxruntime", "networkx")

PUBLIC = {
    alias.asname: node.module
    for node in ast.walk(ast.parse(SOURCE.read_text(encoding="utf-8")))
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
    if alias.asname
}
"""What type checkers see: the names, and where each comes from."""


def modules_after(statement):
    """The names of all modules that a fresh interpreter holds after a statement."""
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    return set(done.stdout.split())


def test_importing_the_package_imports_no_heavy_module():
    loaded = modules_after("import ptne_env")
    assert "ptne_env.registration" in loaded  # what was measured is the import
    assert not loaded & {*HEAVY, "ptne_env.world"}


def test_making_an_environment_imports_nothing_of_the_extras():
    loaded = modules_after("import ptne_env\nptne_env.parallel_env('energy').reset(seed=1)")
    assert "ptne_env.envs.parallel" in loaded
    assert not loaded & (set(HEAVY) - {"networkx"})


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_every_public_name_is_the_one_that_type_checkers_see(name):
    home = importlib.import_module(PUBLIC[name])
    assert getattr(ptne_env, name) is getattr(home, name)
    assert name in dir(ptne_env)


def test_what_type_checkers_see_is_what_a_star_import_brings():
    assert {*ptne_env.__all__, "__version__"} == set(PUBLIC)


def test_modules_of_the_package_are_attributes_and_other_names_are_not():
    assert ptne_env.games is importlib.import_module("ptne_env.games")
    for missing in ("nothing_of_the_kind", "_private", "Games"):
        with pytest.raises(AttributeError, match=f"'ptne_env' has no attribute '{missing}'"):
            getattr(ptne_env, missing)


def test_exactly_the_catalogue_is_registered():
    parallel = {name for name in pettingzoo.parallel_registry if name.startswith("ptne/")}
    assert parallel == {f"ptne/{scenario}-v0" for scenario in ptne_env.CATALOGUE}
    assert {name for name in pettingzoo.aec_registry if name.startswith("ptne/")} == parallel
    joint = {name for name in gymnasium.registry if name.startswith("ptne/")}
    assert joint == {f"ptne/{scenario}-joint-v0" for scenario in ptne_env.CATALOGUE}


def test_a_fresh_interpreter_makes_environments_by_the_module_s_name():
    statement = "import gymnasium\nenv = gymnasium.make('ptne_env:ptne/energy-joint-v0')\nenv.reset(seed=3)"
    assert "ptne_env.envs.gymnasium" in modules_after(statement)
