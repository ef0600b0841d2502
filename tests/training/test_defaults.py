"""Learners of Stable-Baselines3 gain digits, with the settings of the library and without any."""

import importlib
import re
from pathlib import Path

import pytest
from affine_games import SOAK
from extras import need_sb3
from processes import run_python

need_sb3()

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def learners(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.learners")


def test_the_training_in_the_readme_gains_four_digits(tmp_path):
    # A shorter training than that of the document would not show it: some seconds of one core.
    (code,) = [code for code in re.findall(r"```python\n(.*?)```", README, re.DOTALL) if "defaults.PPO" in code]
    assert float(run_python("-W", "error", "-c", code, folder=tmp_path).stdout) > 4.0


@pytest.mark.skipif(not SOAK, reason="takes a minute for each algorithm; PTNE_SOAK=1 runs it")
@pytest.mark.parametrize("algorithm", ["PPO", "SAC", "TD3"])
def test_learners_gain_digits_without_settings_and_more_with_those_of_the_library(algorithm, learners):
    plain, with_defaults = (
        training.digits(seed=0)[0]
        for training in learners.TRAININGS
        if training.algorithm == algorithm and training.interface == "learner"
    )
    assert plain > 2.0
    assert with_defaults > plain
