"""The examples run, with fewer episodes and shorter trainings than they print."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from processes import run_python

import ptne_env

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted([*FOLDER.glob("*.py"), *FOLDER.glob("*.ipynb")])


def test_readme_lists_every_example():
    listed = re.findall(
        r"^\| \[(\w+\.(?:py|ipynb))\]\(\1\) \|", (FOLDER / "README.md").read_text("utf-8"), re.MULTILINE
    )
    assert sorted(listed) == [path.name for path in EXAMPLES]


def quick_copy(example, folder):
    """A copy with fewer episodes, environments and agent-steps; the test is skipped where a library is missing."""
    source = example.read_text("utf-8")
    if "stable_baselines3" in source:
        pytest.importorskip("stable_baselines3", reason="needs the extra 'sb3'")
    source = re.sub(r"(?i)\b(episodes ?= ?)\d+", r"\g<1>2", source).replace("learn(150_000", "learn(2_000")
    source = re.sub(r"num_envs=(32|20)\b", "num_envs=4", source)
    copy = folder / example.name
    copy.write_text(source, encoding="utf-8")
    return copy


@pytest.mark.parametrize("example", [each for each in EXAMPLES if each.suffix == ".py"], ids=lambda path: path.stem)
def test_example_runs_without_a_warning(example, tmp_path):
    done = run_python("-W", "error", quick_copy(example, tmp_path), folder=tmp_path)
    assert done.stdout
    assert done.stderr == ""


def test_the_notebook_runs_to_its_picture_and_stores_no_output(tmp_path):
    nbclient = pytest.importorskip("nbclient", reason="needs the extra 'test'")
    import nbformat  # of nbclient

    notebook = nbformat.read(quick_copy(FOLDER / "tour.ipynb", tmp_path), as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs for cell in cells)
    nbclient.NotebookClient(notebook, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert "my PPO" in cells[-2].outputs[0].text
    assert "image/png" in cells[-1].outputs[0].data


def test_in_one_file_is_the_library():
    law = ptne_env.laws.Static
    env = ptne_env.parallel_env("energy-switching-transformed", start="paper", interface=law.interface)
    observations, _ = env.reset(seed=0)
    policy = law(env.layout, kappa=2.0)
    trajectory = [env.estimates]
    while env.agents:
        actions, _ = policy.predict(np.stack(list(observations.values())))
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
        trajectory.append(env.estimates)
    example = runpy.run_path(str(FOLDER / "in_one_file.py"))
    np.testing.assert_allclose(example["play"](), trajectory, rtol=1e-9, atol=1e-9)
    t, s, steps = example["clock"]()
    clock = env.world.clock
    np.testing.assert_allclose([t[:-1], s[:-1], steps], [clock.t[:-1], clock.s[:-1], clock.theta[:-1]], atol=1e-12)
    np.testing.assert_allclose(example["NASH_EQUILIBRIUM"], env.nash_equilibrium, rtol=1e-12)
