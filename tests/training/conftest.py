"""One short training run that the tests of training, export and loading share."""

import pytest
from extras import need_sb3

need_sb3()

from ptne_env.training import ppo

# A few seconds on one core, and more than three digits.
ARGUMENTS = ppo.Arguments("random-energy", steps=100_000, envs=32, validation_episodes=50)


@pytest.fixture(scope="session")
def run(tmp_path_factory, build_once):
    """The folder of the run, its summary and the calls of ``progress``."""

    def build():
        out, reports = tmp_path_factory.mktemp("run"), []
        return out, ppo.train(ARGUMENTS, out, lambda *report: reports.append(report)), reports

    return build_once("training", build)
