import errno
import os
import stat
import subprocess
from pathlib import Path

import pytest

from ptne_env.shared.files import (
    DamagedFileError,
    read_file,
    read_json,
    require_file,
    require_writable,
    write_atomically,
)


def test_folders_are_made_and_text_is_written_as_utf8(tmp_path):
    path = tmp_path / "a" / "b" / "file.txt"
    write_atomically(path, "κ")
    assert path.read_bytes() == "κ".encode()
    assert [found.name for found in path.parent.iterdir()] == ["file.txt"]


def test_the_file_gets_the_permissions_of_any_new_file(tmp_path):
    write_atomically(tmp_path / "ours", "x")
    (tmp_path / "plain").write_text("x", encoding="utf-8")
    modes = {stat.S_IMODE(os.stat(tmp_path / name).st_mode) for name in ("ours", "plain")}  # noqa: PTH116 - plain stat
    assert len(modes) == 1


@pytest.mark.parametrize(
    "call",
    [
        "fsync",
        pytest.param("fdopen", marks=pytest.mark.skipif(os.name == "nt", reason="Windows keeps files that are open")),
        "chmod",
    ],
)
def test_a_full_disk_is_an_error_with_the_file_name_and_keeps_the_old_file(tmp_path, monkeypatch, call):
    path = tmp_path / "file"
    write_atomically(path, "old")

    def fail(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # as a file object raises it: without a name

    monkeypatch.setattr(Path if call == "chmod" else os, call, fail)
    with pytest.raises(OSError, match="No space left on device.*file'$"):
        write_atomically(path, "new")
    monkeypatch.undo()
    assert path.read_text(encoding="utf-8") == "old"
    assert [found.name for found in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = subprocess.Popen(["cat", str(pipe)], stdout=subprocess.PIPE)  # noqa: S603, S607 - our own command
    write_atomically(pipe, "through the pipe")
    assert reader.communicate(timeout=30)[0] == b"through the pipe"
    assert pipe.is_fifo()


def test_a_missing_file_is_called_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no file '.*missing'"):
        require_file(tmp_path / "missing")
    with pytest.raises(IsADirectoryError, match="is a folder: name a file"):
        require_file(tmp_path)
    (tmp_path / "there").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("there")
    assert read_file(tmp_path / "link", largest=5) == b"12345"
    with pytest.raises(DamagedFileError, match="there has more than 0 MiB"):
        read_file(tmp_path / "there", largest=4)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("read", [require_file, read_file, lambda path: read_json(path, "a note")])
def test_a_pipe_is_refused_before_it_is_read(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DamagedFileError, match="pipe' is a pipe or a device: name a regular file"):
        read(tmp_path / "pipe")


def test_a_link_stays_and_its_target_is_written(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / "file", tmp_path / "link"
    link.symlink_to("elsewhere/file")
    for text in ("new", "newer"):  # at first, the target does not exist
        write_atomically(link, text)
        assert link.is_symlink()
        assert target.read_text(encoding="utf-8") == text
    assert [found.name for found in target.parent.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe\x00", "cut off, damaged or something else"),
        (b'{"a": 1', "cut off, damaged or something else"),
        (b"[" * 100_000, "cut off, damaged or something else"),
        (b"[]", "expected a JSON object, got list"),
        (b'{"a": NaN}', "NaN is not JSON"),
    ],
)
def test_a_damaged_json_file_is_refused_by_name(tmp_path, content, message):
    path = tmp_path / "file.json"
    path.write_bytes(content)
    with pytest.raises(DamagedFileError, match=f"file.json is not a note: .*{message}"):
        read_json(path, "a note")


def test_an_obstacle_to_writing_is_found_beforehand(tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    for path in (tmp_path / "new", tmp_path / "a" / "b" / "new", tmp_path / "file"):
        require_writable(path)
    assert [found.name for found in tmp_path.iterdir()] == ["file"]
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        require_writable(tmp_path)
    with pytest.raises(NotADirectoryError, match="file is not a folder"):
        require_writable(tmp_path / "file" / "a" / "new")
    (tmp_path / "link").symlink_to(tmp_path / "file" / "below")
    with pytest.raises(NotADirectoryError, match="file is not a folder"):
        require_writable(tmp_path / "link")


def test_a_file_that_cannot_be_made_is_found_beforehand(tmp_path, monkeypatch):
    long = "x" * 250  # as long as a name may be, but not as long as that of the temporary file
    with pytest.raises(OSError, match=f"cannot write .*{long}: File name too long"):
        require_writable(tmp_path / long)

    def refuse(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("tempfile.NamedTemporaryFile", refuse)  # tests may run as root, which may write everywhere
    with pytest.raises(PermissionError, match=r"cannot write .*new: Permission denied \(in the folder"):
        require_writable(tmp_path / "a" / "new")
    assert list(tmp_path.iterdir()) == []
