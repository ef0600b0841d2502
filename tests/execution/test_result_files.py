"""Files of results: all that repeats them, and files that are damaged or of another form."""

import errno
import json

import pytest

import ptne_env
from ptne_env import evaluate
from ptne_env.execution.result_files import read_json, read_results, require_writable, results_of
from ptne_env.shared.files import DamagedFileError


@pytest.fixture(scope="module")
def results():
    return evaluate(["static", "random"], ["energy"], episodes=3, seed=2)


def test_json_holds_everything_and_no_nan_and_reads_back(results, tmp_path):
    data = json.loads(results.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in the file"))
    assert data["versions"]["ptne_env"] == ptne_env.__version__
    assert {"simd", "blas"} <= data["arithmetic"].keys()
    assert data["policies"][0]["training_seeds"][0]["arguments"] == {"kappa": 2.0}
    again = results_of(data)
    assert again.records == results.records
    assert again.to_json() == results.to_json()
    assert again.tracks == results.tracks
    assert again.policies == results.policies
    (tmp_path / "results.json").write_text(results.to_json(), encoding="utf-8")
    assert read_results(tmp_path) == data


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[: len(text) // 2], "cut off"),
        (lambda text: text.replace('"seed":2', '"seed":3', 1), "damaged or changed"),
        (lambda text: text.replace('"format":', '"format":9', 1), "no file of results of format"),
        (lambda text: "{}", "no file of results"),
        (lambda text: text + " " * 2**25, "larger than 32 MiB"),
    ],
)
def test_damaged_foreign_and_huge_files_are_refused(results, tmp_path, change, message):
    path = tmp_path / "results.json"
    path.write_text(change(results.to_json()), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_results(path)


@pytest.mark.parametrize("change", [{"policies": 3}, {"tracks": [{}]}, {"episodes": {}}, {"samples": {"energy": 1}}])
def test_data_of_another_form_are_no_results(results, change):
    with pytest.raises(ValueError, match="not results"):
        results_of(json.loads(results.to_json()) | change)


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

    monkeypatch.setattr("tempfile.mkstemp", refuse)  # tests may run as root, which may write everywhere
    with pytest.raises(PermissionError, match=r"cannot write .*new: Permission denied \(in the folder"):
        require_writable(tmp_path / "a" / "new")
    assert list(tmp_path.iterdir()) == []
