"""The benchmarks run and write complete results; their figures are not tested."""

import importlib
import json
import sys
from pathlib import Path

import pytest
from processes import run_python

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def results(tmp_path_factory, build_once):
    path = tmp_path_factory.mktemp("speed") / "folder" / "speed.json"

    def build():
        done = run_python("-m", "benchmarks.speed", "--quick", "--json", path, folder=ROOT)
        assert "Growth with environments" in done.stdout
        return json.loads(path.read_text(encoding="utf-8"))

    return build_once("speed", build)


@pytest.fixture
def peers(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.peers")


def test_quick_run_measures_everything(results):
    assert {"machine", "plan", "comparisons", "targets", "laws", "parts_microseconds", "players", "batch"} <= set(
        results
    )
    assert results["plan"]["quick"]
    assert {"single", "vector 8", "vector 16"} <= set(results["comparisons"])


def test_every_rate_is_a_median_within_its_range(results):
    rates = [
        rate
        for comparison in results["comparisons"].values()
        for kind in ("agent_steps_per_second", "times_as_fast")
        for rate in comparison[kind].values()
    ]
    rates += [*results["laws"].values(), *(row["agent_steps_per_second"] for row in results["batch"])]
    assert rates
    for rate in rates:
        assert 0 < rate["low"] <= rate["median"] <= rate["high"]


def test_our_environments_are_measured_without_peers(results):
    for comparison in results["comparisons"].values():
        assert {"ptne_env, physical", "ptne_env, local"} <= set(comparison["agent_steps_per_second"])


def test_a_peer_is_compared_or_named_as_missing(results):
    compared = {comparison["peer"] for comparison in results["comparisons"].values()} - {None}
    peers = {"mpe2": "MPE2 simple_spread", "vmas": "VMAS dispersion", "torchrl": "TorchRL's PettingZooWrapper"}
    for module, peer in peers.items():
        named = any(f"pip install {module}" in note for note in results["notes"])
        assert named != any(name.startswith(peer) for name in compared)


def test_steps_are_judged_beside_a_copy_of_the_bytes_that_they_must_move(results):
    copy = "a copy of the bytes of a step"
    judged = [row for row in results["targets"] if copy in row["name"]]
    assert [row["at_most"] for row in judged] == [True, True]
    for name in ("vector 8", "vector 16"):
        assert copy in results["comparisons"][name]["agent_steps_per_second"]


def test_growth_is_measured_compiled_and_by_numpy(results):
    for row in (*results["players"], *results["batch"]):
        assert min(row["nanoseconds_per_agent_step"], row["nanoseconds_by_numpy"]) > 0
    for row in results["batch"]:
        for path in ("bytes_per_env", "bytes_per_env_by_numpy"):
            assert 0 < row[path]["held"] <= row[path]["peak"]


def test_rows_by_players_count_operations_and_bytes(results):
    cycle, complete = (
        next(row for row in results["players"] if row["players"] == 10 and row["graph"] == graph)
        for graph in ("cycle", "complete")
    )
    assert (cycle["neighbours"], complete["neighbours"]) == (2, 9)
    assert complete["operations"] - cycle["operations"] == 7 * 10  # one difference per neighbour and component
    assert complete["bytes"] - cycle["bytes"] == 4 * 7 * (10 + 1)  # its float32, and that of the weight


@pytest.mark.parametrize(
    ("module", "build", "command"),
    [
        ("mpe2", lambda peers: peers.mpe2(), "pip install mpe2"),
        ("vmas", lambda peers: peers.vmas(2), "pip install vmas"),
        ("supersuit", lambda peers: peers.supersuit(2), "pip install mpe2 supersuit"),
    ],
)
def test_a_missing_peer_names_the_command_that_installs_it(peers, monkeypatch, module, build, command):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(peers.MissingPeerError, match=command):
        build(peers)
