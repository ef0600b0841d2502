"""Running a suite: cells are kept whole, interrupted runs go on, results can be repeated."""

import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from extras import need_sb3

import ptne_env
from ptne_env import FactorySpec, PolicySpec, laws
from ptne_env.experiments import benchmark
from ptne_env.experiments.benchmark import Store, check, get_participant, run_suite
from ptne_env.experiments.leaderboard import leaderboard
from ptne_env.experiments.suite import ANCHORS, Suite, Track, get_suite
from ptne_env.policies import PolicyFileError

ARGUMENTS = ("compare", "--suite", "ptne-v1", "--policies", "grounded,adaptive", "--episodes", "20", "--no-report")
ARGUMENTS += ("--track", "nominal", "--track", "switching-physical", "--track", "mixed-team")
CELLS = 3 * 5


def start(folder, *, jobs=1):
    """The command line in a process group of its own."""
    command = [
        sys.executable,
        "-W",
        "error",
        "-m",
        "ptne_env.cli",
        *ARGUMENTS,
        "--out",
        str(folder),
        "--jobs",
        str(jobs),
    ]
    return subprocess.Popen(  # noqa: S603
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def finish(process):
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors


def cells(folder):
    return {path.name: path for path in (folder / "cells").glob("*.json")}


def without_timings(text):
    return json.dumps({key: value for key, value in json.loads(text).items() if key != "timings"})


def outcome(folder):
    """Every file of a results folder, without timings."""
    files = {name: without_timings(path.read_text(encoding="utf-8")) for name, path in cells(folder).items()}
    return files | {"results.json": without_timings((folder / "results.json").read_text(encoding="utf-8"))}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    finish(start(folder))
    assert len(cells(folder)) == CELLS
    return outcome(folder)


@pytest.mark.parametrize(("kills", "jobs"), [(3, 1), (1, 2)])
def test_a_run_that_was_killed_ends_like_an_undisturbed_one(undisturbed, tmp_path, kills, jobs):
    randomness = random.Random(kills)  # noqa: S311 - moments to kill at
    for _ in range(kills):
        before = {name: path.stat().st_mtime_ns for name, path in cells(tmp_path).items()}
        process = start(tmp_path, jobs=jobs)
        wanted = len(before) + randomness.randint(1, 3)
        while len(cells(tmp_path)) < wanted and process.poll() is None:
            time.sleep(0.005)
        time.sleep(randomness.uniform(0, 0.05))
        assert process.poll() is None, process.stderr.read()
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        after = cells(tmp_path)
        assert wanted <= len(after) < CELLS
        assert before == {name: after[name].stat().st_mtime_ns for name in before}  # nothing was lost or done twice
        for path in after.values():
            json.loads(path.read_text(encoding="utf-8"))
    finish(start(tmp_path, jobs=jobs))
    assert outcome(tmp_path) == undisturbed


def test_two_runs_at_once_on_one_folder_do_not_corrupt_it(undisturbed, tmp_path):
    both = [start(tmp_path), start(tmp_path)]
    for process in both:
        finish(process)
    assert outcome(tmp_path) == undisturbed


BASE = ptne_env.get_scenario("random-energy", steps=120, deadline=0.2)
OTHER = BASE.replace(
    topology=FactorySpec.of("ptne_env.switching:fixed", graph=FactorySpec.of("ptne_env.graphs:complete", players=5))
)
SMALL = Suite("small", 1, (Track("ring", BASE, "The base."), Track("complete", OTHER, "All links.")), episodes=5)


def results_of(run, folder):
    (folder / "results.json").write_text(leaderboard(run).to_json(), encoding="utf-8")
    return folder / "results.json"


def test_cells_that_are_there_are_not_run_again(tmp_path, monkeypatch):
    first = run_suite(SMALL, ["grounded"], tmp_path)
    monkeypatch.setattr(benchmark.Cell, "compute", lambda cell: pytest.fail("run again"))
    second = run_suite(SMALL, ["grounded"], tmp_path)
    for one, other in zip(first.measured, second.measured, strict=True):
        assert one.samples.keys() == other.samples.keys()
        for metric in one.samples:
            np.testing.assert_array_equal(one.samples[metric], other.samples[metric])


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[: len(text) // 2],
        lambda text: text.replace('"digits": [', '"digits": [0.5, ', 1),
        lambda text: "[]",
        lambda text: '{"samples": 3}',
    ],
)
def test_a_damaged_cell_is_run_again(tmp_path, damage):
    run = run_suite(SMALL, ["grounded"], tmp_path)
    path = Store(tmp_path).path(run.cells[0])
    whole = path.read_text(encoding="utf-8")
    path.write_text(damage(whole), encoding="utf-8")
    run_suite(SMALL, ["grounded"], tmp_path)
    assert without_timings(path.read_text(encoding="utf-8")) == without_timings(whole)


def keys(folder, suite=SMALL, **arguments):
    arguments = {"policies": ["grounded"], **arguments}
    return {cell.key for cell in run_suite(suite, arguments.pop("policies"), folder, **arguments).cells}


def test_a_cell_depends_on_everything_that_its_numbers_depend_on(tmp_path, monkeypatch):
    usual = keys(tmp_path)
    assert keys(tmp_path) == usual
    changes = [
        {"seed": 1},
        {"split": "validation"},
        {"episodes": 4},
        {"suite": Suite("small", 2, SMALL.tracks)},
        {
            "suite": Suite(
                "small", 1, tuple(Track(t.name, t.scenario.replace(gain=19.0), t.change) for t in SMALL.tracks)
            )
        },
    ]
    for change in changes:
        assert not usual & keys(tmp_path, **change)
    other = PolicySpec("grounded", FactorySpec.of("ptne_env.laws:Grounded", kappa=3.0))
    assert len(usual & keys(tmp_path, policies=[other])) == 2 * len(ANCHORS)
    monkeypatch.setattr(benchmark, "versions", lambda: {"ptne_env": "another"})
    assert not usual & keys(tmp_path)


def test_a_cell_depends_on_the_source_of_a_policy_of_ones_own(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / "my_own_policy.py"
    module.write_text("from ptne_env.laws import Static as Mine\n\ndef make(layout):\n    return Mine(layout)\n")
    participant = get_participant("my_own_policy:make")
    before = benchmark.files(participant.runs[0])
    module.write_text(module.read_text() + "\n# changed\n")
    assert set(before) == {"my_own_policy.py"}
    assert benchmark.files(participant.runs[0]) != before


def test_a_cell_depends_on_the_sources_of_a_world_of_ones_own(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / "my_own_graph.py"
    module.write_text("from ptne_env import graphs\n\ndef ring():\n    return graphs.cycle(5)\n")
    mine = BASE.replace(topology=FactorySpec.of("ptne_env.switching:fixed", graph=FactorySpec.of("my_own_graph:ring")))
    suite = Suite("mine", 1, (Track("mine", mine, "My graph."), Track("ring", BASE, "The base.")))

    def found():
        run = run_suite(suite, [], tmp_path, episodes=1)
        return {cell.track.name: cell.key for cell in run.cells if cell.participant == "static"}

    before = found()
    module.write_text(module.read_text() + "\n# changed\n")
    assert {name for name, key in found().items() if key != before[name]} == {"mine"}


def test_a_policy_of_ones_own_gets_the_same_table(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_law.py").write_text(
        "import ptne_env\n\ndef make(layout):\n    return ptne_env.laws.Static(layout)\n"
    )
    board = leaderboard(run_suite(SMALL, ["my_law:make"], tmp_path))
    for track in ("ring", "complete"):
        mine, law = board.row(track, "my_law:make"), board.row(track, "static")
        assert mine.metrics["digits"] == law.metrics["digits"]
        assert mine.score.mean == pytest.approx(1)
        assert mine.improvement.mean == 0.5


def test_a_learned_policy_reads_not_applicable_where_its_layout_does_not_fit(tmp_path):
    board = leaderboard(run_suite(SMALL, ["ppo-random-energy", "grounded"], tmp_path))
    assert board.row("ring", "ppo-random-energy").not_applicable is None
    assert "neighbour slots: policy 2, environment 4" in board.row("complete", "ppo-random-energy").not_applicable
    assert board.row("complete", "ppo-random-energy").rank is None
    assert board.common == ("ring",)
    json.loads(board.to_json(), parse_constant=lambda name: pytest.fail(f"{name} in the file"))


def test_a_policy_that_plays_fewer_than_half_of_the_tracks_does_not_narrow_the_scores_of_the_others(tmp_path):
    complete = SMALL.track("complete")
    again = Track("again", complete.scenario, "the same under another name")
    suite = Suite("narrow", 1, (*SMALL.tracks, again), episodes=2)
    board = leaderboard(run_suite(suite, ["ppo-random-energy", "grounded"], tmp_path))
    assert board.common == ("ring", "complete", "again")
    assert {row.policy for row in board.overall} == {"grounded", *ANCHORS}
    assert board.row("ring", "ppo-random-energy").score is not None


def test_a_policy_that_fits_nowhere_is_an_error(tmp_path):
    suite = Suite("complete", 1, (SMALL.track("complete"),), episodes=2)
    with pytest.raises(ValueError, match="fits no track"):
        run_suite(suite, ["ppo-random-energy"], tmp_path)


def test_training_seeds_of_one_policy_share_a_row(tmp_path):
    source = Path(ptne_env.__file__).parent / "policies" / "ppo-random-energy.onnx"
    for seed in range(3):
        folder = tmp_path / f"seed-{seed}"
        folder.mkdir()
        (folder / "policy.onnx").write_bytes(source.read_bytes())
    run = run_suite(SMALL, [f"mine={tmp_path}/seed-*/policy.onnx"], tmp_path / "out", tracks=["ring"])
    assert len(run.participants["mine"].runs) == 3
    board = leaderboard(run)
    assert board.row("ring", "mine").metrics["digits"].mean > board.row("ring", "static").metrics["digits"].mean
    with pytest.raises(ValueError, match="pattern that matches files"):
        get_participant(f"mine={tmp_path}/none-*.onnx")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An untrained model, saved as Stable-Baselines3 does."""
    need_sb3()
    from stable_baselines3 import PPO

    from ptne_env.envs.sb3 import SlotVecEnv

    path = tmp_path_factory.mktemp("archive") / "model.zip"
    env = SlotVecEnv(BASE, 2, interface="local")
    PPO("MlpPolicy", env, n_steps=20, batch_size=20, device="cpu", seed=0).save(path)
    return str(path)


def test_an_archive_is_not_loaded_unless_it_is_trusted(archive, tmp_path):
    with pytest.raises(ValueError, match="executes code"):
        run_suite(SMALL, [archive], tmp_path)
    assert not (tmp_path / "cells").exists()


def test_an_archive_acts_as_its_model_does(archive, tmp_path):
    from stable_baselines3 import PPO

    participant = get_participant(archive, trust=True)
    (entry,) = participant.runs
    assert entry.interface == ptne_env.Interface("local")
    env = ptne_env.parallel_env(BASE, interface="local")
    observations, _ = env.reset(seed=0)
    rows = np.stack(list(observations.values()))
    ours, _ = entry.build(env.layout).predict(rows, deterministic=True)
    theirs, _ = PPO.load(archive, device="cpu").predict(rows, deterministic=True)
    np.testing.assert_array_equal(ours, theirs)
    board = leaderboard(run_suite(SMALL, [archive], tmp_path, trust=True))
    assert board.row("ring", "model").metrics is not None
    assert "observations of length 24" in board.row("complete", "model").not_applicable


def test_files_that_are_no_archives_are_refused(tmp_path):
    need_sb3()
    (tmp_path / "bad.zip").write_bytes(b"no archive")
    with pytest.raises(PolicyFileError, match="not an archive"):
        get_participant(str(tmp_path / "bad.zip"), trust=True)
    with pytest.raises(FileNotFoundError, match="no file"):
        get_participant(str(tmp_path / "none.zip"), trust=True)


def test_names_that_clash_and_objects_that_nobody_could_make_again_are_refused(tmp_path):
    with pytest.raises(ValueError, match="different names"):
        run_suite(SMALL, ["grounded", "grounded"], tmp_path)
    with pytest.raises(ValueError, match="anchor"):
        run_suite(SMALL, [PolicySpec("static", FactorySpec.of("ptne_env.laws:ZeroInput"))], tmp_path)
    with pytest.raises(ValueError, match="needs a FactorySpec"):
        run_suite(SMALL, [PolicySpec("mine", laws.Static)], tmp_path)


class Wrong:
    def __init__(self, layout):
        self.layout = layout

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.full((len(observation), self.layout.action_size), np.nan), state


def test_an_error_of_a_policy_says_where_it_happened(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    with pytest.raises(ValueError, match="not finite") as caught:
        run_suite(SMALL, [PolicySpec("wrong", FactorySpec.of("test_benchmark:Wrong"))], tmp_path)
    assert caught.value.__notes__ == ["in track 'ring', policy 'wrong'"]


def test_results_say_all_that_is_needed_to_repeat_them(tmp_path):
    data = json.loads(leaderboard(run_suite(SMALL, ["ppo-random-energy"], tmp_path)).to_json())
    assert data["suite"]["content_hash"] == SMALL.content_hash
    assert ptne_env.Scenario.from_dict(data["suite"]["tracks"][0]["scenario"]) == BASE
    assert {"ptne_env", "sources", "numpy", "scipy", "python"} <= set(data["versions"])
    policies = {one["name"]: one["runs"][0] for one in data["participants"]}
    assert policies["static"]["policy"]["arguments"] == {"kappa": 2.0}
    assert set(policies["ppo-random-energy"]["files"]) == {"ppo-random-energy.onnx"}
    assert (data["seed"], data["split"], data["episodes"]) == (0, "test", 5)
    assert {f"{cell['cell']}.json" for cell in data["cells"]} == set(cells(tmp_path))
    assert list(data)[-1] == "timings"


def test_check_repeats_cells_bit_for_bit(tmp_path):
    path = results_of(run_suite(SMALL, ["grounded", "ppo-random-energy"], tmp_path), tmp_path)
    repetitions = check(path, suite=SMALL, sample=100)
    assert len(repetitions) == 2 * 5
    assert {one.difference for one in repetitions} == {0.0}
    chosen = [[one.cell.key for one in check(tmp_path, suite=SMALL, sample=2, seed=seed)] for seed in range(6)]
    assert all(len(some) == 2 for some in chosen)
    assert len({tuple(some) for some in chosen}) > 1


def test_check_finds_numbers_that_do_not_reproduce(tmp_path):
    run = run_suite(SMALL, ["grounded"], tmp_path)
    path = results_of(run, tmp_path)
    cell, measured = run.cells[0], run.measured[0]
    measured.samples["digits"][1] += 0.25
    Store(tmp_path).keep(cell, measured)
    differences = {one.cell.key: one.difference for one in check(path, suite=SMALL, sample=100)}
    assert differences.pop(cell.key) == pytest.approx(0.25 / (1 + measured.samples["digits"][1]))
    assert set(differences.values()) == {0.0}


def test_check_finds_a_reason_that_does_not_reproduce(tmp_path):
    run = run_suite(SMALL, ["ppo-random-energy"], tmp_path)
    path = results_of(run, tmp_path)
    index = next(index for index, measured in enumerate(run.measured) if measured.reason is not None)
    Store(tmp_path).keep(run.cells[index], dataclasses.replace(run.measured[index], reason=None))
    differences = {one.cell.key: one.difference for one in check(path, suite=SMALL, sample=100)}
    assert differences.pop(run.cells[index].key) == float("inf")
    assert set(differences.values()) == {0.0}


def test_check_refuses_what_it_cannot_repeat(tmp_path):
    path = results_of(run_suite(SMALL, ["grounded"], tmp_path), tmp_path)
    other = Suite("small", 1, SMALL.tracks[:1], episodes=5)
    with pytest.raises(ValueError, match="content hash"):
        check(path, suite=other)
    with pytest.raises(ValueError, match="unknown suite 'small-v1'"):
        check(path)
    for cell in cells(tmp_path).values():
        cell.write_text(cell.read_text(encoding="utf-8").replace("digits", "digit"), encoding="utf-8")
    with pytest.raises(ValueError, match="is damaged"):
        check(path, suite=SMALL)
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match="not the results file"):
        check(path)
    with pytest.raises(FileNotFoundError):
        check(tmp_path / "none")


def test_ranks_of_a_saturated_track_go_by_the_time_to_1e_6(tmp_path):
    fast = PolicySpec("fast", FactorySpec.of("ptne_env.laws:Grounded", kappa=3.0))
    suite = get_suite("ptne-v1")
    board = leaderboard(
        run_suite(
            suite,
            ["grounded", fast, "aggregate-tracking"],
            tmp_path,
            tracks=["nominal", "short-deadline"],
            episodes=20,
        )
    )
    assert board.saturated == ("nominal",)
    rows = {name: board.row("nominal", name) for name in ("grounded", "fast", "static", "null")}
    times = {name: row.fine_time for name, row in rows.items()}
    assert sorted(("grounded", "fast"), key=times.get) == sorted(("grounded", "fast"), key=lambda name: rows[name].rank)
    assert times["null"] == pytest.approx(1.2)
    assert rows["null"].rank == 5
    # Its strategies settle early, but its estimates, which are scored, do not.
    aggregate = board.row("nominal", "aggregate-tracking")
    assert aggregate.fine_time < times["static"]
    assert aggregate.rank == 4
    assert board.row("nominal", "oracle").rank is None
    by_digits = [board.row("short-deadline", name) for name in rows]
    by_digits.sort(key=lambda row: row.rank)
    digits = [row.metrics["digits"].mean for row in by_digits]
    assert digits == sorted(digits, reverse=True)


def test_scores_are_0_for_nothing_and_1_for_the_law(tmp_path):
    board = leaderboard(run_suite(SMALL, ["grounded"], tmp_path))
    for track in ("ring", "complete"):
        assert board.row(track, "null").score.mean == pytest.approx(0, abs=1e-12)
        assert board.row(track, "static").score.mean == pytest.approx(1)
    overall = {row.policy: row for row in board.overall}
    assert overall["static"].improvement.mean == 0.5
    assert overall["null"].improvement.mean == 0
    assert overall["oracle"].mean_rank is None
    assert [row.score.mean for row in board.overall] == sorted((row.score.mean for row in board.overall), reverse=True)


def test_messages_and_bits_are_those_of_the_live_links(tmp_path):
    run = run_suite(get_suite("ptne-v1"), [], tmp_path, tracks=["nominal", "switching-physical"], episodes=2)
    for track, links in (("nominal", 10), ("switching-physical", 4)):
        (measured,) = run.of(track, "static")
        assert measured.samples["messages"].tolist() == [400 * links] * 2
        assert measured.samples["bits"].tolist() == [400 * links * 5 * 32] * 2


def test_regret_is_the_nikaido_isoda_gap_at_the_deadline(tmp_path):
    (measured,) = run_suite(SMALL, [], tmp_path, tracks=["ring"], episodes=3).of("ring", "null")
    env = ptne_env.parallel_env(BASE, reward="regret")
    for episode in range(3):
        env.reset(seed=SMALL.episode_seed("ring", episode))
        while env.agents:
            _, rewards, *_ = env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})
        assert measured.samples["regret"][episode] == pytest.approx(-sum(rewards.values()), rel=1e-12)


def test_log_error_area_of_doing_nothing_is_the_log_of_the_initial_error(tmp_path):
    (measured,) = run_suite(SMALL, [], tmp_path, tracks=["ring"], episodes=3).of("ring", "null")
    expected = np.log10(measured.samples["estimate_distance"])
    np.testing.assert_allclose(measured.samples["log_error_area"], expected, rtol=1e-12)


def test_the_files_of_a_part_are_the_same_before_and_after_it_ran():
    """networkx compiles its decorated functions when they are first called; workers may not have called them yet."""
    part = FactorySpec.of("networkx:dense_gnm_random_graph", n=4, m=3, seed=0)
    before = benchmark._hashes(part)
    part.build()
    assert benchmark._hashes(part) == before != {}
