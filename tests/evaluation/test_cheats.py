"""Policies that cheat: each is caught, gains nothing, is found on fresh episodes, or is named as not enforceable."""

import dataclasses
import inspect
import json
import os
import re
import sys
import time

import pytest
from cheats import file_channel, hostile
from cheats.archive import write_archive
from cheats.row_mixing_onnx import row_mixing_file
from small_suite import SMALL, stored, written

from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import run_suite
from ptne_env.evaluation.check import check
from ptne_env.learn import process
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.world import distances

RING = dataclasses.replace(SMALL, tracks=SMALL.tracks[:1])
BLIND = {
    "stack-frames": "stack_frames:StackFrames",
    "objects": "stack_frames:Objects",
    "world-writing": "world_writing:WorldWriting",
    "patching": "patching:Patching",
    "patching-at-import": "patching_at_import:Grounded",
}
"""Cheats that look for the world or the metrics in their process."""

MIXING = {
    "row-mixing": ("row_mixing:RowMixing", {}),
    "row-mixing-late": ("row_mixing:RowMixing", {"first": 100}),
    "row-mixing-in-some-episodes": ("row_mixing:RowMixing", {"every": 3}),
    "row-mixing-in-large-batches": ("row_mixing:RowMixing", {"smallest": 20}),
    "row-mixing-through-memory": ("row_mixing:ThroughMemory", {}),
    "module-state": ("module_state:ModuleState", {}),
}
"""Cheats that let the rows of a batch talk."""

REFUSED = {
    "not finite": ("NotFinite", "Infinite", "OneNaN"),
    "of shape": ("FewRows", "ManyRows", "Transposed", "Empty", "Nothing", "Broadcast"),
    "float": ("Text", "Objects", "Bombs", "Bytes"),
    "Error": ("Raises", "RaisesEscapes", "RaisesLong", "RaisesLayoutError", "Memory"),
    "Exit|Interrupt|StopIteration": ("Exits", "Interrupts", "Stops"),
    "process ended": ("UnpicklableError", "EndsProcess", "Crashes", "Closes"),
    "longer than": ("NeverReturns",),
}
"""What the reason of a failure says: hostile policies."""

HARMLESS = ("Prints", "LeavesThread", "LeavesProcess")
"""Hostile policies whose answers are honest."""

UNTESTED = ("EndsParent", "ChangesResults", "Forges", "Complex", "Booleans", "Masked")
"""Those with a test of their own, or without a promise."""


def spec(name, target, **arguments):
    return PolicySpec(name, FactorySpec.of(f"cheats.{target}", **arguments), Interface("physical"))


def digits(results, policy):
    return results.samples["ring", policy]["digits"].tolist()


def mixing_file(folder):
    """The path of a policy file that mixes rows."""
    path = folder / "mixing.onnx"
    path.write_bytes(row_mixing_file(make_encoder(RING.tracks[0].world, Interface("physical")).layout))
    return path


@pytest.fixture(scope="module")
def honest():
    """Results of the laws."""
    return run_suite(RING, ["grounded"])


def test_cheats_that_look_for_the_world_find_nothing(honest, monkeypatch):
    monkeypatch.setattr(distances, "player_distances", distances.player_distances)  # a patch ends with this test
    results = run_suite(RING, ["grounded", *(spec(name, target) for name, target in BLIND.items())])
    for name in BLIND:
        assert digits(results, name) == digits(honest, "grounded")
    for law in ("static", "zero-input", "oracle", "grounded"):
        assert digits(results, law) == digits(honest, law)
    assert "cheats.patching_at_import" not in sys.modules


def test_cheats_that_mix_rows_fail_the_audit(honest, tmp_path):
    specs = [spec(name, target, **arguments) for name, (target, arguments) in MIXING.items()]
    results = run_suite(RING, [*specs, str(mixing_file(tmp_path))], folder=tmp_path)
    for name in (*MIXING, "mixing"):
        assert "not row-wise" in results.failures["ring", name]
    assert digits(results, "static") == digits(honest, "static")
    assert len(stored(tmp_path)) == 3  # the reference policies: nothing is kept of a cheat


@pytest.mark.parametrize(
    ("target", "reason"),
    [("CountsLinks", "decides differently"), ("NeedsLinks", "cannot be built from them: a player has no neighbours")],
)
def test_policies_that_use_links_of_others_fail_unless_they_declare_it(target, reason):
    declared = dataclasses.replace(
        spec("declared", f"other_links:{target}"), interface=Interface("physical", "union")
    )
    results = run_suite(RING, [spec("hidden", f"other_links:{target}"), declared])
    assert list(results.failures) == [("ring", "hidden")]
    assert re.search(f"it uses links of other players.*{reason}", results.failures["ring", "hidden"])


def test_a_cheat_that_rebuilds_games_from_seeds_is_found_by_a_check(tmp_path):
    suite = dataclasses.replace(RING, episodes=20)
    cheat = spec("seed-rebuilding", "seed_rebuilding:SeedRebuilding", episodes=20)
    results = run_suite(suite, [cheat], folder=tmp_path)
    assert min(digits(results, "seed-rebuilding")[0]) > 7  # no audit sees it: it is row-wise
    written(results, tmp_path)
    found = check(tmp_path, suite=suite, sample=100, trust=True)
    assert {one.job.policy.name for one in found.repetitions if one.knows_episodes} == {"seed-rebuilding"}
    assert not found.passes()


def test_a_cheat_that_fails_on_fresh_episodes_is_found_by_a_check(tmp_path):
    suite = dataclasses.replace(RING, episodes=20)
    results = run_suite(suite, [spec("cheat", "seed_rebuilding:PublishedAlone", episodes=20)], folder=tmp_path)
    assert min(digits(results, "cheat")[0]) > 7
    found = check(written(results, tmp_path), suite=suite, sample=100, trust=True)
    assert {one.job.policy.name for one in found.repetitions if not one.passes()} == {"cheat"}


def test_decisions_that_pass_through_a_file_are_not_enforceable(tmp_path, monkeypatch):
    name = f"{tmp_path.parent.name}-{tmp_path.name}.sqlite"
    try:
        results = run_suite(RING, [spec("file-channel", "file_channel:FileChannel", file=name)])
    finally:
        (file_channel.FOLDER / name).unlink(missing_ok=True)
    assert results.samples["ring", "file-channel"]["digits"].min() > 7  # docs/protocol.md says so


def test_a_policy_that_changes_stored_jobs_is_found_by_a_check(tmp_path):
    run_suite(RING, ["grounded"], folder=tmp_path)
    cheat = spec("changes-results", "hostile:ChangesResults", folder=str(tmp_path))
    run_suite(RING, ["grounded", cheat], folder=tmp_path)
    written(run_suite(RING, ["grounded"], folder=tmp_path), tmp_path)
    twelve = [
        path
        for path in stored(tmp_path).values()
        if json.loads(path.read_text())["samples"].get("digits") == [12.0] * 5
    ]
    assert twelve
    found = check(tmp_path, suite=RING, sample=100)
    assert len([one for one in found.repetitions if one.difference > 0]) >= len(twelve) - 1
    assert not found.passes()


def test_all_hostile_policies_are_tested():
    classes = {
        name for name, value in vars(hostile).items() if inspect.isclass(value) and issubclass(value, hostile.Hostile)
    }
    listed = {name for names in REFUSED.values() for name in names}
    assert classes - {"Hostile"} == {*listed, *HARMLESS, *UNTESTED}


@pytest.mark.parametrize("reason", REFUSED)
def test_a_hostile_answer_costs_its_own_job_only(honest, reason, monkeypatch):
    monkeypatch.setattr(process, "PATIENCE", 3.0 if reason == "longer than" else 60.0)  # it includes a slow start
    names = REFUSED[reason] if os.environ.get("PTNE_SOAK") else REFUSED[reason][:2]  # processes start slowly
    results = run_suite(RING, [spec(name, f"hostile:{name}") for name in names])
    for name in names:
        assert any(part in results.failures["ring", name] for part in reason.split("|")), results.failures["ring", name]
        assert results.failures["ring", name].isprintable()
    assert digits(results, "static") == digits(honest, "static")


def test_a_policy_that_writes_to_its_pipe_fails_in_time(honest, monkeypatch):
    monkeypatch.setattr(process, "PATIENCE", 3.0)
    started = time.monotonic()
    results = run_suite(RING, [spec("forges", "hostile:Forges")])
    assert ("ring", "forges") in results.failures
    assert time.monotonic() - started < 20


def test_policies_with_threads_processes_and_output_change_nothing(honest, capfd):
    results = run_suite(RING, [spec(name, f"hostile:{name}") for name in HARMLESS])
    for name in HARMLESS:
        assert digits(results, name) == digits(honest, "grounded")
    output = capfd.readouterr()
    assert "\x1b" not in output.out + output.err


def test_an_archive_runs_nothing_without_trust(tmp_path):
    write_archive(tmp_path / "evil.zip", tmp_path / "mark")
    with pytest.raises(ValueError, match="trust"):
        run_suite(RING, [str(tmp_path / "evil.zip")])
    with pytest.raises(ValueError, match="trust"):
        run_suite(RING, [f"mine={tmp_path}/evil*"])
    assert not (tmp_path / "mark").exists()
