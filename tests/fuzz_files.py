"""Arbitrary bytes as files of results and policies, guided by coverage; needs atheris (``pip install atheris``).

``python tests/fuzz_files.py -max_total_time=60``, with the options of libFuzzer. For all bytes a reader returns
or raises a documented error.
"""

import contextlib
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["ptne_env", "json"]):
    from ptne_env import learn as policies
    from ptne_env.evaluation.results import read_results
    from ptne_env.evaluation.store import Store
    from ptne_env.learn import Metadata, probe

probe.refusal = lambda *_: None  # a process for every input would take too long, and libFuzzer has limits of its own
FILE = Path(tempfile.mkdtemp()) / "file.onnx"
STORE, KEY = Store(FILE.parent), "key"


def read(path):
    """Read the file as each kind of file."""
    with contextlib.suppress(ValueError):
        read_results(path)
    with contextlib.suppress(ValueError):
        STORE.load(KEY)
    with contextlib.suppress(policies.PolicyFileError):
        policies.load(path)
    with contextlib.suppress(policies.PolicyFileError, UnicodeDecodeError):
        Metadata.from_json(path.read_text(encoding="utf-8"))


def test_one_input(data):
    """The target of libFuzzer."""
    FILE.write_bytes(data)
    STORE.path(KEY).write_bytes(data)
    read(FILE)


if __name__ == "__main__":
    STORE.path(KEY).parent.mkdir()
    corpus = FILE.parent / "corpus"
    corpus.mkdir()
    for name in policies.shipped():
        policy = policies.shipped_path(name).read_bytes()
        (corpus / name).write_bytes(policy)
        (corpus / f"{name}.json").write_text(policies.load(name).metadata.to_json(), encoding="utf-8")
    (corpus / "results").write_text('{"format": 3, "suite": {}, "jobs": [], "checksum": "0"}', encoding="utf-8")
    (corpus / "job").write_text('{"job": {}, "samples": {"digits": [1.5, null]}, "checksum": "0"}', encoding="utf-8")
    atheris.Setup([*sys.argv, str(corpus)], test_one_input)
    atheris.Fuzz()
