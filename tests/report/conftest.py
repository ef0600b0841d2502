"""Small results that all tests of the report share."""

import pytest

from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario
from ptne_env.evaluation import Track
from ptne_env.learn import shipped_path
from ptne_env.suites import Suite, run_suite


@pytest.fixture(scope="session")
def hostile():
    """A name that a page must show as text."""
    return "</script><script>alert(1)</script><b>&\"'"


@pytest.fixture(scope="session")
def comparison(hostile):
    """Results on a fixed and on a switching graph, with an oracle and a hostile name."""
    mine = PolicySpec(hostile, FactorySpec.of("law:static", kappa=1.0))
    names = ["static", "grounded", "zero-input", "oracle", mine]
    return evaluate(names, ["energy", "energy-switching"], episodes=6)


@pytest.fixture(scope="session")
def suite():
    """Results of a suite of two tracks; on one of them a learned policy cannot act."""
    world = get_scenario("random-energy", steps=200, slots=4)
    robots = world.replace(game=FactorySpec.of("game:robots"))
    tiny = Suite("tiny", (Track("plain", world, "Nothing."), Track("robots", robots, "Robots.")), episodes=6)
    return run_suite(tiny, [shipped_path("ppo-nominal"), "grounded", "adaptive"])
