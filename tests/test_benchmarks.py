"""The benchmarks run and write complete results; their figures are not tested."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from extras import need_sb3
from processes import run_python

from ptne_env import learn as policies

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


def test_import_times_are_printed_for_every_statement(capsys, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    imports = importlib.import_module("benchmarks.imports")
    monkeypatch.setattr(imports, "STATEMENTS", {"nothing": "pass", "a pause": "import time; time.sleep(0.3)"})
    imports.main(["--repeats", "1"])
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    elapsed = {row[1].strip(): float(row[2]) for row in rows}
    assert elapsed["a pause"] >= 0.3
    assert elapsed["nothing"] >= 0


def test_shares_of_rollouts_are_printed_for_every_law(capsys, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    rollouts = importlib.import_module("benchmarks.rollouts")
    monkeypatch.setattr(rollouts, "POLICIES", ("static", "adaptive"))
    rollouts.main(["--episodes", "4", "--repeats", "1", "--track", "coarse-step"])
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    assert [row[1].strip() for row in rows] == ["static", "adaptive"]
    figures = [float(cell) for cell in rows[0][2:-1]]
    assert sum(figures[:-1]) - figures[5] == pytest.approx(figures[-1], abs=len(figures))


@pytest.fixture
def trainings(monkeypatch):
    need_sb3()
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.training")


def test_the_settings_before_are_those_of_the_shipped_policies(trainings):
    for name, steps in trainings.SHIPPED_STEPS.items():
        arguments, metadata = trainings.shipped(name), policies.load(f"ppo-{name}").metadata
        assert metadata.scenarios == arguments.scenarios
        assert steps <= metadata.steps < steps + 50 * 128 * 5  # whole rollouts of five players


def test_faster_configurations_learn_from_a_third_of_the_samples(trainings):
    for name in trainings.SHIPPED_STEPS:
        before, now = trainings.shipped(name), trainings.Arguments.from_toml(name)
        assert 3 * now.steps * now.epochs <= before.steps * before.epochs
        assert (now.scenarios, now.interface, now.action_mode) == (before.scenarios, "local", "input")
        assert now.validation_episodes == before.validation_episodes


def test_the_parts_of_a_training_add_up_and_it_is_not_repeated(trainings, tmp_path, monkeypatch):
    few = trainings.shipped("random-energy", steps=200, envs=2, rollout=20, minibatches=4, validation_episodes=2)
    measured = trainings.measure(few, tmp_path)
    parts = trainings.shares([measured, measured])
    assert min(parts.values()) > 0
    assert sum(parts.values()) == pytest.approx(measured["cpu"])
    assert measured["rollouts"] > measured["environment"] + measured["policy"]
    monkeypatch.setattr(trainings.ppo, "train", lambda *_: pytest.fail("it trains again"))
    assert trainings.measure(few, tmp_path) == measured
    with pytest.raises(ValueError, match="holds another run: seed is 0 there and 1 here"):
        trainings.measure(replace(few, seed=1), tmp_path)


def test_every_choice_is_measured_alone_and_leaves_torch_as_it_was(trainings, monkeypatch, capsys):
    default = trainings.shipped
    monkeypatch.setattr(trainings, "shipped", lambda *names, **changes: default(*names, envs=8, rollout=8, **changes))
    trainings.print_choices(1)
    rows = capsys.readouterr().out.splitlines()[1:]
    assert [row[:40].strip() for row in rows] == list(trainings.CHOICES)
    assert all(float(figure) > 0 for row in rows for figure in row[40:].split())
    assert trainings.torch.get_num_threads() == 1
    assert trainings.Distribution._validate_args
