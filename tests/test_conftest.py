"""The threads of test processes, and the values that these processes share."""

from pathlib import Path

import pytest
from processes import run_python

COUNT_THREADS = """
import os
import numpy
numpy.ones((500, 500)) @ numpy.ones((500, 500))
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads in /proc")
def test_numpy_has_one_thread_in_a_test_process():
    assert run_python("-c", COUNT_THREADS).stdout == "1\n"


def test_a_shared_value_is_built_once(build_once):
    built = [build_once("built_once", lambda: {"one": 1}), build_once("built_once", lambda: {"two": 2})]
    assert built == [{"one": 1}] * 2
