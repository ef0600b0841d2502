"""A Ray cluster of two nodes on this machine, one of which is killed in the middle. Run by ``make ray``."""

import contextlib
import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest

from ptne_env.evaluation.results import read_results
from ptne_env.execution import Workers

ray = pytest.importorskip("ray")
pytestmark = pytest.mark.filterwarnings("default")  # Ray's own

TRACKS, POLICIES = ("nominal", "switching-physical"), ("grounded", "adaptive", "ppo")


@pytest.fixture
def cluster(monkeypatch):
    """A head with one core and a second node with one more."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.second = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def kill_second(cluster):
    """Kill the second node with all its processes, as if the machine had lost its power."""
    (raylet,) = cluster.second.all_processes["raylet"]
    workers = Path(f"/proc/{raylet.process.pid}/task/{raylet.process.pid}/children").read_text(encoding="utf-8").split()
    cluster.remove_node(cluster.second, allow_graceful=False)
    for worker in workers:  # they would finish their tasks before they miss their node
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(worker), signal.SIGKILL)


def mark(folder, number):
    """Leave a mark of every start, and take a while."""
    (Path(folder) / f"{number}-{uuid.uuid4()}").touch()
    time.sleep(1)
    return number**2, ray.get_runtime_context().get_node_id()


def test_a_dead_node_costs_only_its_running_tasks(cluster, tmp_path):
    tasks = [(str(tmp_path), number) for number in range(12)]
    found, nodes = {}, set()
    for index, (result, node) in Workers(-1, cluster.address).run(mark, tasks):
        found[index] = result
        nodes.add(node)
        if len(found) == 4:
            assert len(nodes) == 2  # both work
            time.sleep(0.5)  # in the middle of a task
            kill_second(cluster)
    assert found == {number: number**2 for number in range(12)}
    assert len(tasks) < len(list(tmp_path.iterdir())) <= len(tasks) + 2  # something was lost and done again, not all


def test_a_suite_whose_node_was_killed_ends_like_a_local_one(cluster, tmp_path):
    command = [sys.executable, "-m", "ptne_env.cli", "compare", *TRACKS, "--suite", "ptne-v1"]
    command += ["--policy", ",".join(POLICIES), "--episodes", "40", "--no-report"]
    remote = [*command, "--out", str(tmp_path / "ray"), "--ray", cluster.address]
    with (tmp_path / "errors").open("w+") as errors:
        process = subprocess.Popen(remote, stdout=subprocess.DEVNULL, stderr=errors)  # noqa: S603
        while len(list(tmp_path.glob("ray/jobs/*.json"))) < 3 and process.poll() is None:
            time.sleep(0.05)
        assert process.poll() is None
        kill_second(cluster)
        assert process.wait(timeout=300) == 0, (tmp_path / "errors").read_text()
    local = [*command, "--out", str(tmp_path / "local"), "--jobs", "2"]
    subprocess.run(local, check=True, stdout=subprocess.DEVNULL, timeout=300)  # noqa: S603
    first, second = (read_results(tmp_path / name).to_dict() for name in ("ray", "local"))
    assert first["checksum"] == second["checksum"]
