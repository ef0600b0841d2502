"""Results and policies on disk: cut off, foreign, of the future, on a read-only and on a full disk."""

import contextlib
import errno
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ptne_env
from ptne_env import Scenario
from ptne_env import learn as policies
from ptne_env.bench import Suite, run_suite
from ptne_env.bench.check import check
from ptne_env.bench.files import read_results
from ptne_env.bench.store import Store
from ptne_env.evaluation import Track
from ptne_env.evaluation.provenance import content_hash
from ptne_env.evaluation.results import FORMAT
from ptne_env.shared.files import read_json, write_atomically
from ptne_env.world.world import World

WORLD = ptne_env.get_scenario("random-energy", steps=120, deadline=0.2)
SMALL = Suite("small-v1", (Track("ring", WORLD, "The base."),), episodes=4)


@contextlib.contextmanager
def tmpfs(folder, size="256k", *options):
    """A small disk of its own, where this process may mount one."""
    folder.mkdir(exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", ",".join((f"size={size}", *options)), "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own command
    except FileNotFoundError:
        pytest.skip("there is no mount command here")
    if done.returncode:
        pytest.skip(f"this user cannot mount a tmpfs: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)  # noqa: S603, S607 - our own command


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def results(tmp_path):
    write_atomically(tmp_path / "results.json", run_suite(SMALL, ["grounded"], folder=tmp_path).to_json())
    return tmp_path / "results.json"


def test_results_are_read_with_their_format_and_checksum(results):
    data = read_json(results, "results")
    assert data["format"] == FORMAT
    assert data["checksum"] == content_hash(
        {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    )
    assert check(results, suite=SMALL).passes()


def test_results_that_are_cut_off_at_any_length_are_refused(results):
    whole = results.read_bytes()
    for length in [*range(0, len(whole) - 2, 997), len(whole) - 2]:
        results.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="results.json is not a file of results: it is cut off"):
            check(results, suite=SMALL)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe\x00", "cut off, damaged or something else"),
        (b"PK\x03\x04", "cut off, damaged or something else"),
        (b"[]", "expected a JSON object, got list"),
        (b"{}", "it has no format, jobs, suite"),
        (b"[" * 100_000, "cut off, damaged or something else"),
        (b'{"format": 4, "suite": {}, "jobs": []}', "is of format 4, this library reads 5: use the version"),
        (b'{"format": 5, "suite": {}, "jobs": []}', "was damaged or changed after it was written"),
        (b'{"format": 5, "suite": NaN, "jobs": [], "checksum": ""}', "NaN is not JSON"),
    ],
)
def test_foreign_and_future_results_are_refused(tmp_path, content, message):
    path = tmp_path / "results.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        check(path, suite=SMALL)


def changed(value, data):
    """A JSON value with one thing in it replaced or left out."""
    change = data.draw(st.sampled_from(("go on", "go on", "go on", "leave out", "replace")))
    if change != "replace" and isinstance(value, dict) and value:
        name = data.draw(st.sampled_from(sorted(value)))
        if change == "go on":
            return {**value, name: changed(value[name], data)}
        return {key: item for key, item in value.items() if key != name}
    if change != "replace" and isinstance(value, list) and value:
        index = data.draw(st.integers(0, len(value) - 1))
        middle = [changed(value[index], data)] if change == "go on" else []
        return [*value[:index], *middle, *value[index + 1 :]]
    plain = st.none() | st.booleans() | st.integers(-3, 50) | st.floats() | st.text(max_size=3)
    return data.draw(plain | st.lists(plain, max_size=2) | st.dictionaries(st.text(max_size=3), plain, max_size=2))


@given(st.data())
def test_a_change_anywhere_in_results_is_noticed(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("changed") / "results.json"
    keys = ["split", "episodes", "policies", "tuned_laws", "trials", "versions"]
    keys += ["records", "not_applicable", "failures", "leaderboard"]
    suite = {"target": "a", "list": [1.5, {"b": 2}]}
    content = {"format": FORMAT, "suite": suite, "jobs": [{"key": "x"}], "seed": 0, **dict.fromkeys(keys, 1)}
    whole = {**content, "checksum": content_hash(content)}
    altered = changed(whole, data)
    if isinstance(altered, dict):
        altered["timings"] = []  # which the checksum leaves out
        whole["timings"] = []
    path.write_text(json.dumps(altered), encoding="utf-8")
    if json.dumps(without_none(altered), sort_keys=True) == json.dumps(without_none(whole), sort_keys=True):
        assert read_results(path)
    else:
        with pytest.raises(ValueError, match="results.json "):
            read_results(path)


def without_none(value):
    if isinstance(value, dict):
        return {key: without_none(item) for key, item in value.items() if item is not None}
    return [without_none(item) for item in value] if isinstance(value, list) else value


@settings(max_examples=200)
@given(st.data())
@pytest.mark.filterwarnings("ignore:.*short of the deadline")
def test_a_changed_scenario_is_another_one_or_refused(data):
    name = data.draw(st.sampled_from(("energy", "energy-switching", "ev-charging")))
    altered = changed(ptne_env.CATALOGUE[name].to_dict(), data)
    try:
        scenario = Scenario.from_json(json.dumps(altered))
        World(scenario)  # which refuses numbers out of range
    except ValueError as error:
        assert str(error)  # noqa: PT017 - it has to say something
    else:
        assert Scenario.from_json(scenario.to_json()) == scenario


def test_a_job_under_the_name_of_another_is_run_again(results):
    store = Store(results.parent)
    jobs = run_suite(SMALL, ["grounded"], folder=results.parent).jobs
    first, second = (store.path(job.key) for job in jobs[:2])
    kept = first.read_bytes()
    first.write_bytes(second.read_bytes())
    assert store.find(jobs[0]) is None
    with pytest.raises(ValueError, match="is damaged, or of another job .*: run the suite again, which replaces it"):
        check(results, suite=SMALL, sample=100)
    run_suite(SMALL, ["grounded"], folder=results.parent)
    assert json.loads(first.read_bytes())["samples"] == json.loads(kept)["samples"]


def test_a_policy_that_cannot_be_read_is_not_called_damaged(tmp_path, monkeypatch):
    path = tmp_path / "policy.onnx"
    path.write_bytes(policies.shipped_path(policies.shipped()[0]).read_bytes())

    def fail(self):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))

    monkeypatch.setattr(Path, "read_bytes", fail)
    with pytest.raises(PermissionError, match="Permission denied.*policy.onnx"):
        policies.load(path)


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # as a file object raises it: without a name


@pytest.mark.parametrize("call", ["fsync", "fdopen", "chmod"])
def test_a_full_disk_is_an_error_with_the_file_name_and_keeps_the_old_file(tmp_path, monkeypatch, call):
    path = tmp_path / "results.json"
    write_atomically(path, "old")

    def fail(*_, **__):
        raise FULL

    monkeypatch.setattr(Path if call == "chmod" else os, call, fail)
    with pytest.raises(OSError, match="No space left on device.*results.json'$") as caught:
        write_atomically(path, "new")
    monkeypatch.undo()
    assert caught.value.errno == errno.ENOSPC
    assert contents(tmp_path) == {Path("results.json"): b"old"}


def test_a_disk_quota_keeps_the_old_file(tmp_path):
    code = (
        "import resource, signal, sys\n"
        "from pathlib import Path\n"
        "from ptne_env.shared.files import write_atomically\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "write_atomically(Path(sys.argv[1]), 'x' * 4097)\n"
    )
    path = tmp_path / "results.json"
    write_atomically(path, "old")
    done = subprocess.run(  # noqa: S603 - our own code
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False
    )
    assert f"[Errno {errno.EFBIG}] File too large: '{path}'" in done.stderr
    assert contents(tmp_path) == {Path("results.json"): b"old"}
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 4096  # ours is as it was


def test_a_full_disk_keeps_stored_jobs_and_the_run_goes_on_with_room(tmp_path):
    whole = tmp_path / "whole"
    jobs = run_suite(SMALL, ["grounded", "adaptive"], folder=whole).jobs
    with tmpfs(tmp_path / "small", "64k") as folder:
        filler = folder / "filler"
        pages = -(-max(map(len, contents(whole).values())) // 4096)
        filler.write_bytes(bytes(64 * 1024 - 4096 * (2 * pages + 1)))  # room for two jobs or three
        with pytest.raises(OSError, match="No space left on device: '.*json'"):
            run_suite(SMALL, ["grounded", "adaptive"], folder=folder)
        kept = contents(folder / "jobs")
        assert 0 < len(kept) < len(jobs)
        for name, content in kept.items():
            assert without_timings(content) == without_timings((whole / "jobs" / name).read_bytes())
        filler.unlink()
        run_suite(SMALL, ["grounded", "adaptive"], folder=folder)
        assert contents(folder / "jobs").items() >= kept.items()
        assert contents(folder / "jobs").keys() == contents(whole / "jobs").keys()


def without_timings(content):
    return {key: value for key, value in json.loads(content).items() if key not in ("timings", "checksum")}


def test_a_read_only_disk_is_an_error_with_the_file_name_and_can_be_read(tmp_path):
    with tmpfs(tmp_path / "disk", "1m") as folder:
        results = run_suite(SMALL, ["grounded"], folder=folder)
        write_atomically(folder / "results.json", results.to_json())
        before = contents(folder)
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)  # noqa: S603, S607 - our own command
        with pytest.raises(OSError, match="Read-only file system: '.*results.json'"):
            write_atomically(folder / "results.json", "new")
        with pytest.raises(OSError, match="cannot write .*jobs/.*json: Read-only file system"):
            run_suite(SMALL, ["grounded", "adaptive"], folder=folder)
        assert check(folder, suite=SMALL).passes()  # reading needs no writing
        assert run_suite(SMALL, ["grounded"], folder=folder).records == results.records  # nor do stored jobs
        assert contents(folder) == before


def test_a_device_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = subprocess.Popen(["cat", str(pipe)], stdout=subprocess.PIPE)  # noqa: S603, S607 - our own command
    write_atomically(pipe, "through the pipe")
    assert reader.communicate(timeout=30)[0] == b"through the pipe"
    assert pipe.is_fifo()


def test_a_folder_in_the_way_is_named(tmp_path):
    (tmp_path / "results.json").mkdir()
    with pytest.raises(IsADirectoryError, match="results.json"):
        write_atomically(tmp_path / "results.json", "x")


def test_signed_results_without_a_key_are_refused_by_its_name(tmp_path):
    content = {"format": FORMAT, "suite": {}, "jobs": [], "policies": [], "seed": 0, "split": "test"}
    path = tmp_path / "results.json"
    path.write_text(json.dumps({**content, "checksum": content_hash(content)}), encoding="utf-8")
    with pytest.raises(ValueError, match="it has no episodes"):
        read_results(path)
