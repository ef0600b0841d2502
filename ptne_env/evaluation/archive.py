"""Archives of published results: a folder of results, with the files of learned policies, as one ``.tar.xz``.

``tar --extract --file FILE`` gives the folder back.
"""

from __future__ import annotations

import lzma
import re
import tarfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from io import BytesIO
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

from ptne_env import learn as policies
from ptne_env.evaluation.policy_specs import learned_file
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.store import Store
from ptne_env.shared.files import DamagedFileError, require_file, write_atomically

SUFFIX = ".tar.xz"
"""The end of the name of every archive."""

LARGEST = 1 << 28
"""Most bytes of an archive, packed and unpacked."""

MEMBERS = 10_000
"""Most files in an archive."""

_MEMORY = 1 << 27
"""Most bytes that decompression may need; the strongest preset of xz needs half of them."""

_NAME = re.compile(r"(?a:results\.json|jobs/[0-9a-f]{64}\.json|policies/[0-9a-f]{64}\.onnx)")


def policy_copy(folder: Path, digest: str) -> Path:
    """The copy of a policy file in a folder of results, by the SHA-256 of its content."""
    return folder / "policies" / f"{digest}.onnx"


def pack(results: Results, folder: Path, path: Path, *, metrics: Collection[str] | None = None) -> None:
    """Write results, their stored jobs and the files of their learned policies into one file, atomically.

    Equal results give equal bytes.

    Args:
        results: of a run.
        folder: with its stored jobs.
        path: of the archive, which ends in ``.tar.xz``.
        metrics: to be kept, as :meth:`~ptne_env.evaluation.results.Results.of_metrics`; all if left out. A check
            verifies these alone.

    Raises:
        ValueError: for another name, when a policy was an object, for metrics as ``of_metrics``, or when there is more
            than an archive may hold.
        FileNotFoundError: when a job is not stored, or the file of a policy is missing.
        DamagedFileError: when a stored job is damaged.
        OSError: when the archive cannot be written.
    """
    if not path.name.endswith(SUFFIX):
        raise ValueError(f"{path} is no name of an archive: it must end in {SUFFIX}")
    kept = results if metrics is None else results.of_metrics(metrics)
    files = {"results.json": kept.to_json().encode()}
    store = Store(folder)
    for job in [*results.jobs, *chain.from_iterable(results.trials.values())]:
        if (job.track.name, job.policy.name) in results.failures:
            continue  # nothing is stored
        if job.key is None:
            raise ValueError(
                f"policy {job.policy.name!r} is an object, which nothing can make again: name a file or law"
            )
        result = store.load(job.key)
        shown = result if metrics is None else result.of_metrics(metrics)
        files[f"jobs/{job.key}.json"] = store.text(job, shown).encode()
    for source in (source for policy in results.policies.values() for source in policy.training_seeds):
        if (name := learned_file(source)) is not None:
            content = (policies.shipped_path(name) or Path(name)).read_bytes()
            files[f"policies/{sha256(content).hexdigest()}.onnx"] = content
    content = _tar(files)
    if len(files) > MEMBERS or len(content) > LARGEST:
        raise ValueError(
            f"{len(files)} files are more than an archive holds: publish fewer policies, tracks or metrics"
        )
    write_atomically(path, lzma.compress(content, preset=9))


def _tar(files: Mapping[str, bytes]) -> bytes:
    buffer = BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in sorted(files.items(), key=lambda item: (item[0] != "results.json", item[0])):
            member = tarfile.TarInfo(name)  # without the time and the user
            member.size = len(content)
            archive.addfile(member, BytesIO(content))
    return buffer.getvalue()


@contextmanager
def unpacked(results: Path) -> Iterator[Path]:
    """The folder of an archive, for the time of the context; another path as it is.

    An archive is data: the names of its files are those of results, so nothing is written elsewhere, and its size and
    the memory of its decompression are limited.

    Raises:
        FileNotFoundError: when there is no such archive.
        DamagedFileError: when it is damaged, something else, or larger than :data:`LARGEST` or :data:`MEMBERS`.
    """
    if not results.name.endswith(SUFFIX) or results.is_dir():
        yield results
        return
    require_file(results)
    with TemporaryDirectory(prefix="ptne-") as temporary:
        folder = Path(temporary) / results.name  # which messages show
        for name, content in _files(results).items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        yield folder


def _files(path: Path) -> dict[str, bytes]:
    """The content of an archive by name."""
    found: dict[str, bytes] = {}
    try:
        with tarfile.open(fileobj=BytesIO(_decompressed(path)), mode="r:") as archive:
            for member in archive:
                if len(found) == MEMBERS:
                    raise DamagedFileError(f"{path} has more than {MEMBERS} files: publish a smaller run")
                if not _NAME.fullmatch(member.name) or not member.isreg() or member.issparse():
                    raise DamagedFileError(
                        f"{path} is no archive of results: {member.name!r:.80} in it is neither results.json nor a "
                        "file of jobs/ or policies/"
                    )
                if member.name in found:
                    raise DamagedFileError(f"{path} is no archive of results: {member.name} is in it twice")
                file = archive.extractfile(member)
                content = b"" if file is None else file.read()
                if len(content) != member.size:
                    raise DamagedFileError(f"{path} is cut off in {member.name}")
                found[member.name] = content
    except (tarfile.TarError, OverflowError, RecursionError) as error:
        raise DamagedFileError(f"{path} is no archive of results: it is damaged or something else ({error})") from error
    if "results.json" not in found:
        raise DamagedFileError(f"{path} is no archive of results: there is no results.json in it")
    return found


def _decompressed(path: Path) -> bytes:
    if path.exists() and not path.is_file():  # a pipe or a device may never end
        raise DamagedFileError(f"{path} is no archive of results: it is no file")
    if path.stat().st_size > LARGEST:
        raise DamagedFileError(f"{path} is larger than {LARGEST >> 20} MiB: publish a smaller run")
    decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MEMORY)
    try:
        content = decompressor.decompress(path.read_bytes(), max_length=LARGEST + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise DamagedFileError(f"{path} is no archive of results: it is damaged or something else ({error})") from error
    if len(content) > LARGEST:
        raise DamagedFileError(f"{path} holds more than {LARGEST >> 20} MiB: publish a smaller run")
    if not decompressor.eof or decompressor.unused_data:
        raise DamagedFileError(f"{path} is cut off, or something follows it: copy it again")
    return content
