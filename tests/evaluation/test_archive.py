"""Archives of published results: a check reads them like the folder, and foreign ones are data."""

import dataclasses
import json
import lzma
import shutil
import tarfile
from io import BytesIO
from pathlib import Path

import pytest
from small_suite import SMALL, written

from ptne_env import PolicySpec, laws
from ptne_env.evaluation import archive, get_suite, run_suite
from ptne_env.evaluation import check as check_module
from ptne_env.evaluation.archive import pack, policy_copy, unpacked
from ptne_env.evaluation.check import Repetition, check
from ptne_env.evaluation.leaderboard import NEEDED
from ptne_env.evaluation.provenance import content_hash
from ptne_env.evaluation.results import read_results
from ptne_env.evaluation.sources import file_hash
from ptne_env.evaluation.store import Store
from ptne_env.learn import shipped_path
from ptne_env.shared.files import DamagedFileError


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Results with a learned policy of two training seeds, their folder, and the folder of the policy files."""
    folder = tmp_path_factory.mktemp("run")
    for seed, name in enumerate(("ppo-random-energy", "ppo-random-energy-switching")):
        (folder / f"seed-{seed}").mkdir()
        shutil.copy(shipped_path(name), folder / f"seed-{seed}" / "policy.onnx")
    pattern = f"mine={folder}/seed-*/policy.onnx"
    results = run_suite(SMALL, ["grounded", pattern], tracks=["ring"], folder=folder / "results")
    written(results, folder / "results")
    return results, folder / "results", folder


@pytest.fixture
def packed(run, tmp_path):
    path = tmp_path / "small-v1.tar.xz"
    pack(run[0], run[1], path)
    return path


@pytest.fixture
def away(run, packed):
    """Removes the policy files of the run for the time of a test."""
    moved = run[2].with_name("moved")
    moved.mkdir()
    for seed in (0, 1):
        (run[2] / f"seed-{seed}").rename(moved / f"seed-{seed}")
    yield
    for seed in (0, 1):
        (moved / f"seed-{seed}").rename(run[2] / f"seed-{seed}")
    moved.rmdir()


def members(path):
    """The files of an archive by name."""
    with tarfile.open(path) as file:
        return {member.name: file.extractfile(member).read() for member in file}


def write(path, files):
    """An archive of files, or of members of any kind, with their content."""
    buffer = BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as file:
        for member, content in files:
            info = member if isinstance(member, tarfile.TarInfo) else tarfile.TarInfo(member)
            if not info.size:
                info.size = len(content)
                file.addfile(info, BytesIO(content))
            else:  # more than there is
                file.fileobj.write(info.tobuf(tarfile.GNU_FORMAT))
    path.write_bytes(lzma.compress(buffer.getvalue()))


def passed(job, *_):
    """The outcome of a job that is not run again, to save time."""
    return Repetition(job, 0.0, None, None, None, None, knows_episodes=False)


@pytest.fixture
def unrepeated(monkeypatch):
    """Passes every job that a check would run again."""
    monkeypatch.setattr(check_module, "_repeat", passed)


@pytest.mark.usefixtures("away")
def test_a_check_repeats_jobs_of_an_archive_without_its_folder(run, packed, monkeypatch):
    repeat, repeated = check_module._repeat, []

    def repeat_some(job, *rest):
        if job.policy.name == "mine" and job.training_seed == 0:  # its file decides in processes, which take time
            return passed(job)
        repeated.append(job)
        return repeat(job, *rest)

    monkeypatch.setattr(check_module, "_repeat", repeat_some)
    outcome = check(packed, suite=SMALL, sample=99)
    assert outcome.passes()
    assert not outcome.left_out
    assert len(outcome.repetitions) == len(run[0].jobs) == len(repeated) + 1 == 6
    assert {repetition.difference for repetition in outcome.repetitions} == {0.0}


def test_an_archive_is_the_folder_and_its_policies(run, packed, tmp_path):
    found = members(packed)
    assert json.loads(found.pop("results.json")) == json.loads(run[0].to_json())
    policies = {name: found.pop(name) for name in list(found) if name.startswith("policies/")}
    assert sorted(policies.values()) == sorted(path.read_bytes() for path in run[2].glob("seed-*/policy.onnx"))
    assert found == {f"jobs/{path.name}": path.read_bytes() for path in (run[1] / "jobs").iterdir()}
    pack(run[0], run[1], tmp_path / "again.tar.xz")
    assert (tmp_path / "again.tar.xz").read_bytes() == packed.read_bytes()


@pytest.mark.usefixtures("unrepeated")
def test_some_metrics_alone_can_be_published(run, tmp_path):
    path = tmp_path / "part.tar.xz"
    pack(run[0], run[1], path, metrics=NEEDED)
    outcome = check(path, suite=SMALL, sample=1)
    assert outcome.passes()
    assert "regret" in outcome.left_out
    assert NEEDED.isdisjoint(outcome.left_out)
    found = members(path)
    shown = {record["metric"] for record in json.loads(found["results.json"])["records"]}
    assert shown == NEEDED | {"digits_cvar"}
    assert json.loads(found["results.json"])["leaderboard"] == json.loads(run[0].to_json())["leaderboard"]
    with unpacked(path) as folder:  # a run needs every metric
        assert all(Store(folder).find(job) is None for job in run[0].jobs)


@pytest.mark.parametrize(
    ("metrics", "message"),
    [(NEEDED - {"digits"}, "leaderboards need digits"), (NEEDED | {"luck"}, "no measured metrics: luck")],
)
def test_metrics_that_cannot_be_published_alone_are_refused(run, tmp_path, metrics, message):
    with pytest.raises(ValueError, match=message):
        pack(run[0], run[1], tmp_path / "part.tar.xz", metrics=metrics)
    assert not any(tmp_path.iterdir())


def test_what_cannot_be_packed_leaves_the_old_archive(run, packed, tmp_path):
    old = packed.read_bytes()
    with pytest.raises(ValueError, match=r"must end in \.tar\.xz"):
        pack(run[0], run[1], tmp_path / "small.zip")
    with pytest.raises(FileNotFoundError):
        pack(run[0], tmp_path / "elsewhere", packed)
    objects = run_suite(SMALL, [PolicySpec("own", laws.Static)], tracks=["ring"], episodes=1, folder=tmp_path / "own")
    with pytest.raises(ValueError, match="'own' is an object"):
        pack(objects, tmp_path / "own", packed)
    assert packed.read_bytes() == old


def improve_a_job(files):
    name = next(name for name in files if name.startswith("jobs/"))
    data = json.loads(files[name])
    data["samples"]["regret"][0] += 1.0
    data["checksum"] = content_hash({key: value for key, value in data.items() if key != "checksum"})
    files[name] = json.dumps(data).encode()


def change_results(change):
    def apply(files):
        data = json.loads(files["results.json"])
        change(data)
        checked = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
        files["results.json"] = json.dumps(data | {"checksum": content_hash(checked)}).encode()

    return apply


def hide_a_metric(data):
    data["records"] = [record for record in data["records"] if record["metric"] != "digits_after_hold"]


def excuse_a_law(data):
    law = next(policy for policy in data["policies"] if policy["name"] == "grounded")
    law["training_seeds"][0]["files"] = {"lost.onnx": "0" * 64}


@pytest.mark.parametrize(
    ("forge", "message"),
    [
        (improve_a_job, "records[ring, "),
        (change_results(lambda data: data["records"][0].update(mean=12.0)), "records[ring, "),
        (change_results(lambda data: data["records"].pop()), "records is "),
        (change_results(hide_a_metric), "it has no records of digits_after_hold"),
        (change_results(lambda data: data["records"].clear()), "is damaged"),
        (change_results(excuse_a_law), "files of policy 'grounded' are not those"),
        (lambda files: files.pop(next(name for name in files if name.startswith("jobs/"))), "is missing"),
    ],
)
@pytest.mark.usefixtures("unrepeated")
def test_a_forged_archive_is_refused_or_reported(packed, forge, message):
    files = members(packed)
    forge(files)
    write(packed, files.items())
    try:
        outcome = check(packed, suite=SMALL, sample=1)
    except (ValueError, FileNotFoundError) as error:
        assert message in str(error)  # noqa: PT017 - either is right
    else:
        assert outcome.differences[0].startswith(message)
        assert not outcome.passes()


@pytest.mark.usefixtures("away")
def test_jobs_of_missing_policy_files_are_named_and_not_repeated(run, packed):
    files = [(name, content) for name, content in members(packed).items() if not name.startswith("policies/")]
    write(packed, files)
    outcome = check(packed, suite=SMALL, sample=99)
    assert outcome.agrees()
    assert not outcome.passes()
    paths = [run[2].with_name("moved") / f"seed-{seed}" / "policy.onnx" for seed in (0, 1)]
    assert outcome.missing == tuple(
        f"policy 'mine': the file {run[2]}/seed-{seed}/policy.onnx is not here (expected SHA-256 {file_hash(path)})"
        for seed, path in enumerate(paths)
    )
    assert {one.job.policy.name for one in outcome.repetitions} == {"grounded", "zero-input", "static", "oracle"}


@pytest.mark.usefixtures("away", "unrepeated")
def test_a_copy_with_another_content_is_missing(run, packed):
    with unpacked(packed) as folder:
        for copy in (folder / "policies").iterdir():
            copy.write_bytes(copy.read_bytes() + b"x")
        assert len(check(folder, suite=SMALL, sample=1).missing) == 2


@pytest.mark.usefixtures("unrepeated")
def test_a_policy_file_that_was_replaced_is_an_error_without_a_copy(run, packed):
    file = run[2] / "seed-0" / "policy.onnx"
    old = file.read_bytes()
    try:
        file.write_bytes((run[2] / "seed-1" / "policy.onnx").read_bytes())
        with pytest.raises(ValueError, match="files of policy 'mine' are not those that were run"):
            check(run[1], suite=SMALL, sample=1)
        assert check(packed, suite=SMALL, sample=99).passes()
    finally:
        file.write_bytes(old)


def special(name, kind, **values):
    member = tarfile.TarInfo(name)
    member.type = kind
    for key, value in values.items():
        setattr(member, key, value)
    return member


KEY = "0" * 64


@pytest.mark.parametrize(
    ("member", "message"),
    [
        ("../results.json", "'../results.json' in it is neither"),
        ("/results.json", "'/results.json' in it is neither"),
        (f"jobs/../../{KEY}.json", "in it is neither"),
        (f"jobs/{KEY}.json/x", "in it is neither"),
        (f"jobs/{KEY}.json\n", "in it is neither"),
        (f"policies/{KEY}.zip", "in it is neither"),
        (special(f"jobs/{KEY}.json", tarfile.SYMTYPE, linkname="/etc/passwd"), "in it is neither"),
        (special(f"jobs/{KEY}.json", tarfile.LNKTYPE, linkname="results.json"), "in it is neither"),
        (special(f"jobs/{KEY}.json", tarfile.FIFOTYPE), "in it is neither"),
        (special(f"jobs/{KEY}.json", tarfile.DIRTYPE), "in it is neither"),
        (
            special(f"jobs/{KEY}.json", tarfile.REGTYPE, pax_headers={"GNU.sparse.map": "0,9", "GNU.sparse.size": "9"}),
            "in it is neither",
        ),
        (special(f"jobs/{KEY}.json", tarfile.REGTYPE, size=1 << 40), "cut off|unexpected end of data"),
        ("results.json", "results.json is in it twice"),
    ],
)
def test_an_archive_with_anything_else_is_refused(tmp_path, member, message):
    path = tmp_path / "bad.tar.xz"
    write(path, [("results.json", b"{}"), (member, b"")])
    with pytest.raises(DamagedFileError, match=message), unpacked(path):
        pass
    assert [found.name for found in tmp_path.iterdir()] == ["bad.tar.xz"]


def test_a_truncated_or_changed_archive_is_refused(packed):
    whole = packed.read_bytes()
    for content in (
        *(whole[: len(whole) * part // 20] for part in range(20)),
        *(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :] for place in range(0, len(whole), 9973)),
        whole + b"x",
        whole + whole,
        b"{}",
        lzma.compress(b""),
        lzma.compress(b"no tar" * 999),
    ):
        packed.write_bytes(content)
        with pytest.raises(DamagedFileError, match="small-v1.tar.xz"), unpacked(packed):
            pass


def test_an_archive_that_takes_too_much_is_refused(packed, monkeypatch):
    whole = packed.read_bytes()
    monkeypatch.setattr(archive, "LARGEST", 1 << 24)
    packed.write_bytes(lzma.compress(bytes(archive.LARGEST + 1), preset=0))
    assert packed.stat().st_size < 1 << 14
    with pytest.raises(DamagedFileError, match="holds more than 16 MiB"), unpacked(packed):
        pass
    packed.write_bytes(whole)
    for name, limit, message in (
        ("LARGEST", 1 << 10, "is larger than"),
        ("MEMBERS", 3, "has more than 3 files"),
        ("_MEMORY", 1 << 20, "Memory usage limit exceeded"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(archive, name, limit)
            with pytest.raises(DamagedFileError, match=message), unpacked(packed):
                pass


def test_a_digest_that_is_no_hash_names_no_file(run, packed):
    files = members(packed)
    secret = policy_copy(packed.parent, "x")
    change_results(
        lambda data: next(one for one in data["policies"] if one["name"] == "mine")["training_seeds"][0].update(
            files={str(run[2] / "seed-0" / "policy.onnx"): f"../../{secret}"}
        )
    )(files)
    write(packed, files.items())
    with pytest.raises(ValueError, match="files of policy 'mine' are not those"):
        check(packed, suite=SMALL, sample=1)


def test_more_than_an_archive_holds_is_not_packed(run, tmp_path, monkeypatch):
    for name in ("MEMBERS", "LARGEST"):
        with monkeypatch.context() as patch:
            patch.setattr(archive, name, 5)
            with pytest.raises(ValueError, match="9 files are more than an archive holds"):
                pack(run[0], run[1], tmp_path / "large.tar.xz")
    assert not any(tmp_path.iterdir())


def test_archives_in_the_repository_take_at_most_20_mb_and_are_of_its_suites():
    found = sorted((Path(__file__).parents[2] / "baselines").glob("*.tar.xz"))
    assert sum(path.stat().st_size for path in found) <= 20e6
    for path in found:
        with unpacked(path) as folder:
            suite = read_results(folder / "results.json")["suite"]
        assert suite["content_hash"] == get_suite(path.name.removesuffix(".tar.xz")).content_hash


def test_failed_jobs_are_not_in_an_archive(run, tmp_path):
    job = next(job for job in run[0].jobs if job.policy.name == "grounded")
    failed = dataclasses.replace(run[0], failures={("ring", "grounded"): "step 3: no number"})
    pack(failed, run[1], tmp_path / "failed.tar.xz")
    assert f"jobs/{job.key}.json" not in members(tmp_path / "failed.tar.xz")
