"""One short training run that the tests of training, export and loading share."""

import pytest
from extras import need_sb3

need_sb3()

from ptne_env.training import ppo

# Small enough for a minute on one core, large enough to gain digits beyond doubt.
ARGUMENTS = ppo.Arguments("random-energy", steps=400_000, envs=64, validation_episodes=50)


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    reports = []
    summary = ppo.train(ARGUMENTS, out, lambda *report: reports.append(report))
    return out, summary, reports
