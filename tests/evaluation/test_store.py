"""Stored jobs: written atomically, not run again, and found by everything that their numbers depend on."""

import json
import random

import numpy as np
import pytest
from ptne_env.evaluation.store import Store
from ptne_env.evaluation.suite import REFERENCES
from small_suite import SMALL, stored, without_timings

from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.evaluation import Suite, Track, get_policy_spec, jobs, run_suite
from ptne_env.evaluation.provenance import content_hash
from ptne_env.shared.files import DamagedFileError


def test_stored_jobs_are_not_run_again(tmp_path, monkeypatch):
    first = run_suite(SMALL, ["grounded"], folder=tmp_path)
    monkeypatch.setattr(jobs.Job, "compute", lambda job: pytest.fail("run again"))
    second = run_suite(SMALL, ["grounded"], folder=tmp_path)
    assert first.records == second.records  # timings too
    assert first.samples.keys() == second.samples.keys()
    for place, samples in first.samples.items():
        for metric, values in samples.items():
            np.testing.assert_array_equal(values, second.samples[place][metric])


def test_nothing_is_stored_without_a_folder_or_of_an_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_suite(SMALL, ["grounded"], tracks=["ring"], episodes=1)
    assert not any(tmp_path.iterdir())
    results = run_suite(SMALL, [PolicySpec("mine", laws.Grounded)], tracks=["ring"], episodes=1, folder=tmp_path)
    assert len(stored(tmp_path)) == len(REFERENCES)
    assert {job.policy.name: job.key is None for job in results.jobs}["mine"]


def test_a_failed_job_is_not_stored(tmp_path):
    job = jobs.Job(SMALL.tracks[0], get_policy_spec("static"), 0, SMALL.episode_set("ring", 1))
    Store(tmp_path).save(job, jobs.JobResult({}, {}, None, "step 3: no number"))
    assert not any(tmp_path.iterdir())


STRANGE = (True, 3, "1.5", [], {}, [1.5], {"a": 1.5}, "")
"""JSON values that stand nowhere in a stored result."""


def altered(value, randomness):
    """A JSON value with something strange in it, or with something added or left out."""
    if isinstance(value, dict | list) and value and randomness.random() < 0.85:
        place = randomness.choice(list(value) if isinstance(value, dict) else range(len(value)))
        change = randomness.choice(("go on", "go on", "leave out", "add"))
        copy = value.copy()
        if change == "go on":
            copy[place] = altered(value[place], randomness)
        elif change == "leave out":
            del copy[place]
        elif isinstance(value, dict):
            copy[f"{place}x"] = randomness.choice((value[place], None))
        else:
            copy.insert(place, value[place])
        return copy
    return randomness.choice([strange for strange in STRANGE if strange != value])


def with_checksum(data):
    return {**data, "checksum": content_hash({key: value for key, value in data.items() if key != "checksum"})}


def damaged(whole, randomness):
    """Bytes of a stored result with a random damage; where its form is damaged, half of them have a right checksum."""
    kind = randomness.choice(("flip", "cut", "form", "form"))
    if kind == "cut":
        start, stop = sorted(randomness.sample(range(len(whole)), 2))
        return whole[:start] + randomness.choice((b"", whole[stop:]))
    if kind == "flip":
        changed = bytearray(whole)
        for _ in range(randomness.choice((1, 1, 8))):
            changed[randomness.randrange(len(whole))] ^= 1 << randomness.randrange(8)
        return bytes(changed)
    data = altered(json.loads(whole), randomness)
    return json.dumps(with_checksum(data) if isinstance(data, dict) and randomness.random() < 0.5 else data).encode()


def a_job(folder):
    """A stored job whose result has numbers and nulls."""
    results = run_suite(SMALL, ["grounded"], tracks=["ring"], folder=folder)
    return Store(folder), next(job for job in results.jobs if job.policy.name == "zero-input")


def test_a_damaged_result_is_refused_or_gives_exactly_the_stored_numbers(tmp_path):
    (store, task), damages = a_job(tmp_path), 3000
    path = store.path(task.key)
    whole, stored = path.read_bytes(), store.load(task.key).to_dict()
    randomness, refused = random.Random(7), 0  # noqa: S311 - damages
    for _ in range(damages):
        content = damaged(whole, randomness)
        path.write_bytes(content)
        found = store.find(task)
        refused += found is None
        assert found is None or json.dumps(found.to_dict()) == json.dumps(stored), content
    assert refused > 0.9 * damages  # the others add a null, which means the same, or change white space


def change(**values):
    """A change of the content of a stored result, with a right checksum; a function changes the value before."""

    def apply(path):
        data = json.loads(path.read_bytes())
        data |= {key: value(data[key]) if callable(value) else value for key, value in values.items()}
        path.write_text(json.dumps(with_checksum(data)), encoding="utf-8")

    return apply


def replace_by_folder(path):
    path.unlink()
    path.mkdir()
    (path / "file").touch()


DAMAGES = {
    "empty": lambda path: path.write_bytes(b""),
    "no object": lambda path: path.write_bytes(b"[]"),
    "other bytes": lambda path: path.write_bytes(b"\xff\xfe\x00"),
    "deep": lambda path: path.write_bytes(b'{"samples": ' + 100_000 * b"["),
    "another key": lambda path: path.write_text(path.read_text(encoding="utf-8").replace("timings", "tidings", 1)),
    "a folder": replace_by_folder,
    "no timings": change(timings={}),
    "a timing that is no number": change(timings=lambda timings: dict.fromkeys(timings, "3")),
    "a metric too few": change(samples=lambda samples: dict(list(samples.items())[1:])),
    "an episode too few": change(samples=lambda samples: {name: values[1:] for name, values in samples.items()}),
    "a boolean": change(samples=lambda samples: samples | {"digits": [True, *samples["digits"][1:]]}),
    "a reason with numbers": change(not_applicable="it has no clock"),
    "a reason that is no text": change(not_applicable=3, samples={}, timings={}),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_job_is_run_again(tmp_path, damage):
    store, job = a_job(tmp_path)
    path = store.path(job.key)
    whole = path.read_text(encoding="utf-8")
    damage(path)
    with pytest.raises(DamagedFileError, match=path.name):
        store.load(job.key)
    run_suite(SMALL, ["grounded"], tracks=["ring"], folder=tmp_path)
    assert without_timings(path.read_text(encoding="utf-8")) == without_timings(whole)


def test_a_file_that_cannot_be_read_is_an_error(tmp_path):
    (tmp_path / "jobs").write_text("a file in place of the folder", encoding="utf-8")
    with pytest.raises(NotADirectoryError, match="jobs"):
        run_suite(SMALL, ["grounded"], folder=tmp_path)
    assert (tmp_path / "jobs").is_file()


def keys(suite=SMALL, policies=("grounded",), **arguments):
    specs = [*map(get_policy_spec, policies), *REFERENCES]
    sets = {track.name: suite.episode_set(track.name, **arguments) for track in suite.tracks}
    return {jobs.Job(track, spec, 0, sets[track.name]).key for track in suite.tracks for spec in specs}


def test_a_job_depends_on_everything_that_its_numbers_depend_on(monkeypatch):
    usual = keys()
    assert keys() == usual
    slower = tuple(Track(t.name, t.scenario.replace(gain=19.0), t.change) for t in SMALL.tracks)
    for change in (
        {"seed": 1},
        {"split": "validation"},
        {"episodes": 4},
        {"suite": Suite("small-v2", SMALL.tracks, 5)},
        {"suite": Suite("small-v1", slower, 5)},
    ):
        assert not usual & keys(**change)
    other = PolicySpec("grounded", FactorySpec.of("ptne_env.laws:Grounded", kappa=3.0))
    assert len(usual & keys(policies=[other])) == 2 * len(REFERENCES)
    monkeypatch.setattr(jobs, "versions", lambda: {"ptne_env": "another"})
    assert not usual & keys()
