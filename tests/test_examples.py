"""The examples run, with fewer episodes and shorter trainings than they print."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from processes import run_python

import ptne_env

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))


def test_readme_lists_every_example():
    listed = re.findall(r"^\| \[(\w+\.py)\]\(\1\) \|", (FOLDER / "README.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(listed) == [path.name for path in EXAMPLES]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_without_a_warning(example, tmp_path):
    source = example.read_text("utf-8")
    if "stable_baselines3" in source:
        pytest.importorskip("stable_baselines3", reason="needs the extra 'sb3'")
    source = re.sub(r"(?i)\b(episodes ?= ?)\d+", r"\g<1>2", source).replace("learn(150_000)", "learn(4_000)")
    copy = tmp_path / example.name
    copy.write_text(source, encoding="utf-8")
    done = run_python("-W", "error", copy, folder=tmp_path)
    assert done.stdout
    assert done.stderr == ""


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
