"""Forged results: a check refuses or reports each, without a traceback and without running code that they name."""

import copy
import os

import numpy as np
import pytest
from cheats.archive import write_archive
from cheats.row_mixing_onnx import row_mixing_file
from forgeries import FORGED_MODULE, KINDS, MARK, forgeries, read_published, write_published
from small_suite import written

from ptne_env.evaluation import get_suite, run_suite
from ptne_env.evaluation.check import check
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface

TRACKS = ("coarse-step", "unseen-graphs")
FORGED = 200
EVERY = 1 if os.environ.get("PTNE_SOAK") else 4
"""The share of the forged results that are checked."""


@pytest.fixture(scope="module")
def published(tmp_path_factory, build_once):
    """Results of two tracks with numbers, n/a and a failure, and a copy of them in memory."""

    def build():
        folder = tmp_path_factory.mktemp("published")
        policy = folder / "mixed.onnx"
        layout = make_encoder(get_suite("ptne-v1").track("coarse-step").world, Interface("physical")).layout
        policy.write_bytes(row_mixing_file(layout))
        policies = ["grounded", "ppo-random-energy", str(policy)]
        written(run_suite("ptne-v1", policies, tracks=TRACKS, episodes=2, folder=folder), folder)
        return folder

    return read_published(build_once("published", build))


@pytest.fixture
def working_folder(tmp_path, monkeypatch):
    """A working folder with the module and the archive that forged results load."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "forged_module.py").write_text(FORGED_MODULE, encoding="utf-8")
    write_archive("forged.zip", MARK)
    return tmp_path


def verdict(folder, sample=1):
    """How a check ends: "passes", "refused" or "reported"."""
    try:
        return "passes" if check(folder, sample=sample).passes() else "reported"
    except (ValueError, FileNotFoundError):
        return "refused"


def test_the_true_results_pass(published, working_folder):
    assert {"failures", "not_applicable"} <= {key for key, value in published["results"].items() if value}
    write_published(published, working_folder / "true")
    assert verdict(working_folder / "true") == "passes"


def test_every_kind_of_forgery_fits(published):
    alone = (kinds for kinds, _ in forgeries(published, np.random.default_rng(0), len(KINDS)) if len(kinds) == 1)
    assert {kind for (kind,) in alone} == set(KINDS)


@pytest.mark.parametrize("part", range(4))  # several workers share the results
def test_forged_results_are_refused_or_reported(published, working_folder, part):
    found = list(forgeries(published, np.random.default_rng(1), FORGED))[part :: 4 * EVERY]
    for index, (kinds, forged) in enumerate(found):
        folder = working_folder / str(index)
        write_published(forged, folder)
        # A change that leaves all tables as they are shows when its job runs again.
        assert verdict(folder) != "passes" or verdict(folder, sample=100) != "passes", kinds
        assert not (working_folder / MARK).exists(), f"{kinds}: code ran"


def test_tables_that_follow_from_forged_jobs_are_reported(published, working_folder):
    folder = working_folder / "forged"
    forged = copy.deepcopy(published)
    for job in forged["jobs"].values():
        if job["job"]["policy"]["target"] == "ptne_env.laws:Grounded":
            job["samples"]["digits"] = [digits + 1 for digits in job["samples"]["digits"]]
    write_published(forged, folder)
    written(run_suite("ptne-v1", ["grounded", "ppo-random-energy"], tracks=TRACKS, episodes=2, folder=folder), folder)
    rebuilt = check(folder, sample=100)
    assert rebuilt.differences == ()
    assert {one.job.policy.name for one in rebuilt.repetitions if one.difference > 0} == {"grounded"}
