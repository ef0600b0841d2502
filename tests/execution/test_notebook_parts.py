"""Parts that are defined in a program or a notebook, which other processes cannot import."""

from processes import run_python

DEFINITIONS = """
import numpy as np

from functools import cached_property
from pathlib import Path
from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario, laws
from ptne_env.evaluation import METRICS
from ptne_env.execution import Runner, Workers
from ptne_env.games import AffineGame

SCALE = 1.0


class Contest(AffineGame):
    pull: float = 0.5
    offset = -np.arange(5.0)

    @cached_property
    def matrix(self):
        return SCALE * (np.eye(5) - self.pull / 4 * (1 - np.eye(5)))


class Mine(laws.Static):
    pass


def run(jobs=1):
    scenario = get_scenario("energy", name="contest", game=Contest(0.25), start="random")
    three = PolicySpec("three", FactorySpec.of(Mine, kappa=3.0))
    policies = ["static", "__main__:Mine", three, PolicySpec("own", Mine)]
    results = evaluate(policies, scenario, episodes=2, run=Runner(Path("out"), Workers(jobs)))
    assert not results.failures, results.failures
    return [record for record in results.records if not METRICS[record["metric"]].is_timing]
"""

SAME = """
first = run()
assert run(jobs=2) == first


class Contest(Contest):
    @cached_property
    def matrix(self):
        return SCALE * (np.eye(5) - 2 * self.pull / 4 * (1 - np.eye(5)))


again = run(jobs=2)
assert again == run() != first
"""

LOCKED = """
import threading

LOCK = threading.Lock()


class Contest(Contest):
    def __post_init__(self):
        with LOCK:
            super().__post_init__()


try:
    run(jobs=2)
except ValueError as error:
    print(error)
"""


def test_workers_get_the_present_definitions_and_one_that_cannot_be_sent_is_named(tmp_path):
    done = run_python("-W", "error", "-c", DEFINITIONS + SAME + LOCKED, folder=tmp_path)
    assert not (tmp_path / "out").exists()  # a change of these definitions would not be seen
    assert "cannot be sent to other processes (TypeError: cannot pickle '_thread.lock' object)" in done.stdout
    assert "define it in a module, or run one job at a time" in done.stdout
