"""Foreign policies in processes of their own: the answers, the errors, and the end of the process."""

import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import ptne_env
from ptne_env import FactorySpec, Interface, laws
from ptne_env.learn import process
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import PolicyError

MODULE = """
import os, sys, time
import numpy as np
from ptne_env import Interface, laws
from ptne_env.perception.observation import LayoutError

class Grounded(laws.Adaptive):
    pass

class Local:
    interface = Interface("local", action_scale=2.0)

class Strange:
    interface = 3

def answering(layout, answer):
    class Policy:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return eval(answer), state
    return Policy()

def refusing(layout):
    raise LayoutError("I need six players")

def without_predict(layout):
    return 3

def alone(layout):
    class Policy:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            return np.zeros((len(observation), 5))
    return Policy()
"""


@pytest.fixture
def layout(tmp_path, monkeypatch):
    (tmp_path / "foreign_policies.py").write_text(textwrap.dedent(MODULE), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return ptne_env.parallel_env("energy").layout


def answer(layout, text, rows=3):
    source = FactorySpec.of("foreign_policies:answering", answer=text)
    with process.separate(source, layout) as policy:
        return policy.predict(np.zeros((rows, layout.size), dtype=np.float32), None, np.ones(rows, dtype=bool))[0]


def test_a_policy_in_its_own_process_decides_the_same_and_is_not_imported_here(layout):
    generator = np.random.default_rng(0)
    here, memory, state = laws.Adaptive(layout), None, None
    starts = np.ones(10, dtype=bool)
    with process.separate(FactorySpec.of("foreign_policies:Grounded"), layout) as there:
        for step in range(5):
            rows = generator.normal(size=(10, layout.size)).astype(np.float32)
            rows[:, layout.slices["player"]] = np.tile(np.eye(5), (2, 1))
            expected, memory = here.predict(rows, memory, starts, deterministic=True)
            actions, state = there.predict(rows, state, starts, deterministic=True)
            np.testing.assert_array_equal(actions, expected)
            starts = np.zeros(10, dtype=bool) if step < 2 else np.arange(10) == 4  # one memory starts afresh
    assert "foreign_policies" not in sys.modules


def test_the_interface_of_a_foreign_policy_is_read_without_importing_it_here(layout):
    assert process.declared_interface(FactorySpec.of("foreign_policies:Local")) == Interface("local", action_scale=2.0)
    assert process.declared_interface(FactorySpec.of("foreign_policies:answering")) == Interface()
    with pytest.raises(PolicyError, match="cannot import"):
        process.declared_interface(FactorySpec.of("no_such_module:thing"))
    with pytest.raises(PolicyError, match="interface of foreign_policies:Strange is an Interface of ptne_env, got 3"):
        process.declared_interface(FactorySpec.of("foreign_policies:Strange"))
    assert "foreign_policies" not in sys.modules


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 / 0", r"ZeroDivisionError: division by zero \(<string>, line 1\)"),
        ("sys.exit(3)", "SystemExit: 3"),
        ("(_ for _ in ()).throw(KeyboardInterrupt)", "KeyboardInterrupt"),
        ("(_ for _ in ()).throw(ValueError('\\x1b[31m' + 2000 * 'x'))", r"ValueError:  \[31mx{400}"),
        ("os._exit(3)", "its process ended with exit status 3"),
        ("os.kill(os.getpid(), 9)", "its process ended with signal 9"),
        ("np.zeros((10_000_000, 5))", "actions of shape"),
        ("'text'", "ValueError: could not convert string to float"),
        (
            "[os.write(fd, b'no answer' * 99) for fd in range(3, 30) if os.path.exists(f'/proc/self/fd/{fd}')]",
            "process",
        ),
    ],
)
def test_a_policy_that_misbehaves_is_an_error_here(layout, text, message):
    with pytest.raises(PolicyError, match=message) as caught:
        answer(layout, text)
    assert str(caught.value).isprintable()


def test_an_answer_without_memory_is_refused_with_the_expected_pair(layout):
    observations = np.zeros((2, layout.size), dtype=np.float32)  # as many rows as the pair has values
    message = r"predict returns \(actions, state\), got a ndarray alone"
    with (
        process.separate(FactorySpec.of("foreign_policies:alone"), layout) as policy,
        pytest.raises(PolicyError, match=message),
    ):
        policy.predict(observations)


def test_a_policy_that_never_answers_is_an_error(layout, monkeypatch):
    monkeypatch.setattr(process, "PATIENCE", 2.0)
    with pytest.raises(PolicyError, match="it took longer than 2 s"):
        answer(layout, "time.sleep(60)")


def test_an_answer_byte_by_byte_is_an_error_in_time(layout, monkeypatch):
    monkeypatch.setattr(process, "PATIENCE", 2.0)
    text = (
        "[(os.write(fd, bytes([byte])), time.sleep(0.2)) for byte in bytes([0, 0, 0, 0, 0, 0, 1, 0]) + 256 * b' '"
        " for fd in range(3, 30) if os.path.exists(f'/proc/self/fd/{fd}')]"
    )
    started = time.monotonic()
    with pytest.raises(PolicyError, match="it took longer than 2 s"):
        answer(layout, text)
    assert time.monotonic() - started < 6


@pytest.mark.parametrize(
    ("target", "error", "message"),
    [
        ("foreign_policies:refusing", LayoutError, "I need six players"),
        ("foreign_policies:without_predict", PolicyError, "it is a int without predict"),
        ("foreign_policies:nothing", PolicyError, "it cannot be built: ValueError: .* has no 'nothing'"),
    ],
)
def test_a_policy_that_cannot_be_built_is_an_error_here(layout, target, error, message):
    with pytest.raises(error, match=message), process.separate(FactorySpec.of(target), layout):
        pass


def test_numbers_come_back_in_their_own_precision_and_others_as_float64(layout):
    assert answer(layout, "np.full((3, 5), 1/3)").dtype == np.float64
    assert answer(layout, "np.full((3, 5), 1/3, dtype=np.float32)").dtype == np.float32
    np.testing.assert_array_equal(answer(layout, "[[1, 2, 3, 4, 5]] * 3"), [[1.0, 2, 3, 4, 5]] * 3)


def test_the_process_ends_with_the_context(layout):
    with process.separate(FactorySpec.of("foreign_policies:Grounded"), layout) as policy:
        number = policy._process.pid
        assert Path(f"/proc/{number}").exists() or not Path("/proc").exists()
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def test_the_process_ends_when_its_caller_is_killed(layout, tmp_path):
    code = (
        "import sys, time, ptne_env\n"
        "from ptne_env import FactorySpec\n"
        "from ptne_env.learn.process import separate\n"
        f"sys.path.insert(0, {str(tmp_path)!r})\n"
        "with separate(FactorySpec.of('foreign_policies:answering', answer='time.sleep(60)'),\n"
        "              ptne_env.parallel_env('energy').layout) as policy:\n"
        "    print(policy._process.pid, flush=True)\n"
        "    import numpy as np\n"
        "    policy.predict(np.zeros((1, policy_size), dtype=np.float32))\n"
    ).replace("policy_size", str(layout.size))
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)  # noqa: S603 - ours
    number = int(parent.stdout.readline())
    time.sleep(0.3)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(50):
        try:
            os.kill(number, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("the process of the policy outlives its caller")
