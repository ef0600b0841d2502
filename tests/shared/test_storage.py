"""Files on disk: scenarios that were changed, full disks, devices and folders in the way."""

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
from ptne_env.shared.files import write_atomically
from ptne_env.world.world import World


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


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
