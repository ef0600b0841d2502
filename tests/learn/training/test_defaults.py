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


@pytest.mark.skipif(not SOAK, reason="takes a minute for each training; PTNE_SOAK=1 runs it")
@pytest.mark.parametrize(
    ("algorithm", "has_defaults", "least"),
    [("PPO", False, 2.0), ("PPO", True, 4.0), ("SAC", True, 4.0), ("TD3", True, 4.0)],
)
def test_learners_gain_digits_under_the_default_interface(algorithm, has_defaults, least, learners):
    (training,) = [
        each
        for each in learners.TRAININGS
        if (each.algorithm, each.interface, each.has_defaults) == (algorithm, "learner", has_defaults)
    ]
    assert training.digits(seed=0)[0] > least
