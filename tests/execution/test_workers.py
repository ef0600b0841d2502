"""Workers: the same results for any number of them, and clear errors when one is missing or dies."""

import importlib
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from affine_games import SOAK
from processes import KILLS, start_python
from small_suite import SMALL, stored, untimed

from ptne_env.evaluation import get_policy_spec
from ptne_env.evaluation.comparison import Job
from ptne_env.execution import Runner, Workers
from ptne_env.execution.runner import _run_job, key_of
from ptne_env.suites import run_suite


def square(number):
    if number < 0:
        raise ValueError(f"{number} is negative")
    return number**2


def die(number):
    if number == 1:
        os._exit(1)
    return number


def stay(number):
    return number, os.getpid()


def read_variable(name):
    return os.environ.get(name)


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_result_comes_with_the_index_of_its_task(jobs):
    assert dict(Workers(jobs).run(square, [(3,), (4,), (5,)])) == {0: 9, 1: 16, 2: 25}
    assert dict(Workers(jobs).run(square, [])) == {}


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_a_task_is_raised(jobs):
    with pytest.raises(ValueError, match="-1 is negative"):
        list(Workers(jobs).run(square, [(1,), (-1,), (2,)]))


def test_a_caller_that_needs_no_more_results_ends_the_tasks():
    results = Workers(2).run(time.sleep, [(0,), (60,), (60,)])
    began = time.monotonic()
    assert next(results) == (0, None)
    results.close()
    assert time.monotonic() - began < 50


def test_processes_compute_with_64_bit_numbers_of_jax_where_this_one_does(monkeypatch):
    config = SimpleNamespace(jax_enable_x64=True)
    monkeypatch.setitem(sys.modules, "jax", SimpleNamespace(config=config))
    assert dict(Workers(2).run(read_variable, [("JAX_ENABLE_X64",)])) == {0: "True"}
    config.jax_enable_x64 = False
    assert dict(Workers(2).run(read_variable, [("JAX_ENABLE_X64",)])) == {0: "False"}


def test_a_dead_process_is_an_error():
    with pytest.raises(ChildProcessError, match="a worker process died.*stored results are kept"):
        list(Workers(2).run(die, [(0,), (1,), (2,)]))
    assert dict(Workers(2).run(square, [(2,), (3,)])) == {0: 4, 1: 9}  # and the next run has new ones


def test_results_do_not_depend_on_the_number_of_processes_and_a_run_that_lost_one_goes_on(tmp_path):
    def kill_one(*_):
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="utf-8").split()
        workers = [child for child in children if b"popen_loky" in Path(f"/proc/{child}/cmdline").read_bytes()]
        for worker in workers[:1]:  # none is left when a result comes after the first kill
            os.kill(int(worker), signal.SIGKILL)

    policies = ["grounded", "random"]
    with pytest.raises(ChildProcessError, match="died"):
        run_suite(SMALL, policies, run=Runner(tmp_path, Workers(2), kill_one))
    assert 0 < len(stored(tmp_path)) < len(SMALL.tracks) * 5
    again = run_suite(SMALL, policies, run=Runner(tmp_path, Workers(2)))
    assert untimed(again) == untimed(run_suite(SMALL, policies))


SLEEPER = """
import time
from ptne_env.execution import Workers
list(Workers(2).run(time.sleep, [(60,), (60,)]))
"""


def working(program):
    """Wait until the workers of a program are there."""
    while not any("popen_loky" in command for command in program.alive().values()):
        assert program.process.poll() is None
        time.sleep(0.01)


@pytest.mark.parametrize(("number", "of_group"), KILLS if SOAK else [(signal.SIGKILL, False), (signal.SIGINT, True)])
@pytest.mark.parametrize("delay", [0, 1] if SOAK else [0])  # the workers are starting, or at work
def test_workers_end_with_a_program_that_is_killed_and_leave_no_folders(number, of_group, delay):
    program = start_python("-c", SLEEPER)
    working(program)
    time.sleep(delay)
    program.kill(number, of_group=of_group)
    assert program.printed.count("KeyboardInterrupt") == (number == signal.SIGINT and of_group)  # of the program alone
    for folder in ("/dev/shm", tempfile.gettempdir()):  # noqa: S108 - where joblib has its folders
        assert not list(Path(folder).glob(f"joblib_memmapping_folder_{program.process.pid}_*"))


def test_a_worker_with_other_files_is_refused():
    job = Job(SMALL.tracks[0], get_policy_spec("static"), 0, SMALL.episode_set("ring", 2))
    assert _run_job(job, key_of(job), {}).samples["digits"].shape == (2,)
    with pytest.raises(ValueError, match="another version of the library.*'static'.*install the same"):
        _run_job(job, "0" * 64, {})


def test_no_jobs_are_refused():
    with pytest.raises(ValueError, match="0 jobs"):
        Workers(0)


def test_without_ray_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"ptne-env\[ray\]"):
        list(Workers(2, "auto").run(square, [(1,), (2,)]))


@pytest.fixture
def fake_ray(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", importlib.import_module("fake_ray"))
    yield sys.modules["ray"]
    sys.modules["ray"].addresses.clear()


class Flaky:
    """Squares, but the machine dies under every task the given number of times."""

    def __init__(self, deaths):
        self.deaths, self.calls = deaths, {}

    def __call__(self, number):
        self.calls[number] = self.calls.get(number, 0) + 1
        if self.calls[number] <= self.deaths:
            raise SystemExit
        return square(number)


def test_tasks_of_dead_machines_run_again_and_errors_are_raised(fake_ray):
    flaky = Flaky(deaths=2)
    assert dict(Workers(-1, "auto").run(flaky, [(n,) for n in range(9)])) == {n: n**2 for n in range(9)}
    assert set(flaky.calls.values()) == {3}
    assert fake_ray.addresses == ["auto"]
    with pytest.raises(ChildProcessError, match="lost 4 times.*the node died"):
        list(Workers(-1, "auto").run(Flaky(deaths=9), [(1,), (2,)]))
    with pytest.raises(ValueError, match="-1 is negative"):
        list(Workers(4, "auto").run(square, [(1,), (-1,), (2,)]))
    fake_ray.addresses.clear()
    with pytest.raises(ConnectionError, match=r"no Ray cluster answers at 127.0.0.1:1: "):
        list(Workers(-1, "127.0.0.1:1").run(square, [(1,), (2,)]))
